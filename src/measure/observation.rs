//! What is observed of a marker, and what is estimated of a quantity: the plain data that adjustment and environment share.

use nalgebra::{Matrix2, Vector2};

/// One marker seen in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Index in [`Setup::markers`](super::setup::Setup::markers).
    pub marker: usize,
    /// Image of the marker's centre, px.
    pub pixel: Vector2<f64>,
    /// Its covariance, px^2.
    pub covariance_px2: Matrix2<f64>,
}

/// A number with its standard deviation; `None` for one that was held fixed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value, in the unit that the field's name bears.
    pub value: f64,
    /// Its standard deviation, same unit.
    pub sigma: Option<f64>,
}
