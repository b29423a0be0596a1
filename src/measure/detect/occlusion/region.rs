//! Regions of the picture that may show something else than the marker.

use nalgebra::Vector2;

/// A strip of the picture across a marker's axis, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// Unit vector of the axis.
    pub axis: Vector2<f64>,
    /// Where it begins along the axis, counted from the picture's origin.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
}

impl Band {
    /// Whether it holds a point.
    pub fn holds(&self, at: &Vector2<f64>) -> bool {
        (self.from..=self.to).contains(&self.axis.dot(at))
    }
}
