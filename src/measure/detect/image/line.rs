//! Straight lines, row by row.

use nalgebra::Vector2;

/// A straight edge between quadrants: a point, and the direction across it.
#[derive(Clone, Copy)]
pub struct Line {
    pub at: Vector2<f64>,
    pub across: Vector2<f64>,
}

impl Line {
    /// The part of a row that is within `reach`.
    pub fn row(&self, y: f64, reach: f64) -> (f64, f64) {
        let steep = self.across.x.abs().max(1e-6);
        let middle = self.at.x - (y - self.at.y) * self.across.y * self.across.x.signum() / steep;
        (middle - reach / steep, middle + reach / steep)
    }
}
