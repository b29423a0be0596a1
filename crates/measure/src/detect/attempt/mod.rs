//! Measurement of one hypothesis, with fallback strategies.

pub mod discs;
pub mod measure;
pub mod options;
pub mod sharpening;
pub mod sharpening_candidates;
pub mod start;
pub mod strategies;
pub mod whole;
