//! Repeated measurement with priors from the neighbours and from the orientation.

pub mod neighbours;
pub mod options;
pub mod orientation;
pub mod under_decal;
