//! Whether a fit is a marker, and with what accuracy; what a frame's markers tell of one another.

pub mod better;
pub mod consistency;
pub mod correlated;
pub mod dirt;
pub mod found;
pub mod lost_contrast;
pub mod misfit;
pub mod options;
pub mod pattern;
pub mod verdict;
