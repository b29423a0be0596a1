//! Environment: effects of air, window and temperature, one per file (docs/model.md): refraction, shift by the pane, its
//! bow under pressure, thermal expansion.

mod bowed_pane;
mod conditions;
mod pane;
mod refraction;
mod thermal;

pub use conditions::FlightConditions;
pub use pane::{Plate, apparent_point};
pub use refraction::{
    PAPER_INCIDENCE_RAD, RefractionReport, correct_observations, deflection_rad, refract_ray,
    refraction_shift_px, refractive_index,
};
pub use thermal::{length_change_m, scale_with_sigma};
