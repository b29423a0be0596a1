//! Geometry and statistics of the image: ellipses, lines, histograms, noise.

pub mod ellipse;
pub mod histogram;
pub mod noise;
pub mod scanline;
