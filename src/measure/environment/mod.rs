//! What the air, the window and the cold do, one term per file (docs/model.md): refraction, the pane's shift,
//! its bow under pressure, thermal expansion.

mod bow;
mod conditions;
mod pane;
mod refraction;
mod thermal;

pub use conditions::FlightConditions;
pub use pane::Plate;
pub use refraction::{
    PAPER_INCIDENCE_RAD, RefractionReport, correct_observations, deflection_rad, refract_ray,
    refraction_shift_px, refractive_index,
};
pub use thermal::{length_change_m, scale_with_sigma};
