//! The pixels of a fit, and how much each counts.

pub mod bands;
pub mod foreign;
pub mod pixels;
pub mod select;
pub mod weight;
