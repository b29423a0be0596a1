//! Occlusions of a part of a marker: covering objects, glare, seams, paint.

pub mod glare;
pub mod mask;
pub mod options;
pub mod paint;
pub mod region;
pub mod seam;
