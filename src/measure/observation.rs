//! Observations of markers, and estimates of quantities: plain data shared by adjustment and environment.

use nalgebra::{Matrix2, Vector2};

/// Observation of one marker in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Index in [`Setup::markers`](super::setup::Setup::markers).
    pub marker: usize,
    /// Image of the marker's centre, px.
    pub pixel: Vector2<f64>,
    /// Covariance of the image, px^2.
    pub covariance_px2: Matrix2<f64>,
}

/// An estimated number with its standard deviation; `None` for a fixed one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Value, in the unit of the field's name.
    pub value: f64,
    /// Standard deviation, in the unit of the value.
    pub sigma: Option<f64>,
}
