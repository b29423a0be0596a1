//! One hypothesis measured, in the ways that there are.

pub mod discs;
pub mod ladder;
pub mod measure;
pub mod options;
pub mod sharpening;
pub mod suspects;
pub mod whole;
