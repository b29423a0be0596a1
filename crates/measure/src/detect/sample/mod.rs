//! Selection and weights of the pixels of a fit.

pub mod bands;
pub mod foreign;
pub mod pixels;
pub mod select;
pub mod weight;
