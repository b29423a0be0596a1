//! The paper's method (MODEL.md section 2).

mod parabola;

pub use parabola::arc_length;
