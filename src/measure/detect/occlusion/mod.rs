//! What may hide a part of a marker: decals, glare, seams.

pub mod decal;
pub mod glare;
pub mod options;
pub mod paint;
pub mod region;
pub mod seam;
