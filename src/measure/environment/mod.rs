//! What the air and the cold do: refraction at the window, thermal expansion (docs/model.md).

mod refraction;
mod thermal;

pub use refraction::{
    PAPER_INCIDENCE_RAD, RefractionReport, correct_observations, deflection_rad, refract,
    refraction_shift_px, refractive_index,
};
pub use thermal::{length_change_m, scale_with_sigma};
