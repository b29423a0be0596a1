//! Measured once more with what is known by then: from the neighbours, from the orientation.

pub mod neighbours;
pub mod options;
pub mod orientation;
pub mod under_decal;
