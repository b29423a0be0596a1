//! Appearance of a blurred marker: the image formula, its parameters and derivatives.

pub mod crossing;
pub mod disc;
pub mod formula;
pub mod overshoot;
pub mod parameters;
pub mod quadrants;
