//! Acceptance of fits as markers with their accuracy, and comparison of a frame's markers with each other.

pub mod consistency;
pub mod correlated;
pub mod dirt;
pub mod found;
pub mod lost_contrast;
pub mod misfit;
pub mod options;
pub mod pattern;
pub mod preference;
pub mod verdict;
