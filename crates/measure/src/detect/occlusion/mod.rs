//! Occlusions of a part of a marker: decals, glare, seams, paint.

pub mod decal;
pub mod glare;
pub mod options;
pub mod paint;
pub mod region;
pub mod seam;
