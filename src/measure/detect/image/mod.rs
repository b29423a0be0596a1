//! Geometry and statistics of the picture: ellipses, lines, histograms, noise.

pub mod ellipse;
pub mod histogram;
pub mod line;
pub mod noise;
pub mod scanline;
