//! Optional terms of the image formula.

pub mod glare_spline;
pub mod knot_field;
pub mod light_field;
pub mod veiling_glare;
