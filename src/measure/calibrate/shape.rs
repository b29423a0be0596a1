//! The board's shape: flat boards exist on paper; real ones bow along and across.
//!
//! `z = a (1 - u^2) + b (1 - v^2)`, with `u`, `v` from -1 to 1 over the points seen (the model of mrcal's
//! `calobject_warp`). What is linear in `u` and `v` belongs to the pose, so that the same `a`, `b` hold
//! wherever on the board the counting of its rows and columns began. By how much a bow of some
//! millimetres shortens the board's rows is of second order and below a hundredth of a millimetre.

use nalgebra::{RowVector2, Vector2, Vector3};

use super::View;
use super::bundle::Prior;

/// Height of the board's middle over the chord between two of its sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bow {
    /// m; positive away from the camera for a checkerboard, towards it for an AprilGrid, whose rows run upwards.
    pub value_m: f64,
    /// Standard deviation, scaled by the residuals, m.
    pub sigma_m: f64,
}

impl Bow {
    /// Whether it differs from 0 at 95 %; some hundred points leave Student's t at the normal's 1.96.
    pub fn significant(&self) -> bool {
        self.value_m.abs() > 1.96 * self.sigma_m
    }
}

/// Standard deviation of a bow beforehand, m per m of the side: an assumption, over three times the
/// 1.5 mm per metre that boards are expected to bow. It matters only where the pictures tell nothing about the bow.
const SIGMA_M_PER_M: f64 = 0.005;

/// Where the board's points lie: middle and half the sides.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    middle_m: Vector2<f64>,
    half_m: Vector2<f64>,
}

impl Shape {
    /// Of all points seen.
    pub(super) fn of(views: &[&View]) -> Self {
        let mut points = views.iter().flat_map(|v| v.iter()).map(|p| p.board_m);
        let first = points.next().unwrap_or_default();
        let (low, high) = points.fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
        // A single row has no bow across; its half side must only not be 0.
        let half_m = (0.5 * (high - low)).map(|h| if h > 0.0 { h } else { 1.0 });
        Self { middle_m: 0.5 * (low + high), half_m }
    }

    /// Corners of the rectangle in which the points lie, m.
    pub(super) fn bounds_m(&self) -> (Vector2<f64>, Vector2<f64>) {
        (self.middle_m - self.half_m, self.middle_m + self.half_m)
    }

    /// Its sides, m.
    pub(super) fn sides_m(&self) -> [f64; 2] {
        [2.0 * self.half_m.x, 2.0 * self.half_m.y]
    }

    /// Priors on the two bows, which are the parameters from `first` on.
    pub(super) fn priors(&self, first: usize) -> Vec<Prior> {
        let sigma = |k: usize| SIGMA_M_PER_M * 2.0 * self.half_m[k];
        (0..2).map(|k| Prior { index: first + k, mean: 0.0, sigma: sigma(k) }).collect()
    }

    /// d height / d bow.
    pub(super) fn by_bow(&self, board_m: &Vector2<f64>) -> RowVector2<f64> {
        let uv = (board_m - self.middle_m).component_div(&self.half_m);
        RowVector2::new(1.0 - uv.x * uv.x, 1.0 - uv.y * uv.y)
    }

    /// The point in space, board frame, m.
    pub(super) fn point(&self, board_m: &Vector2<f64>, bow_m: &[f64; 2]) -> Vector3<f64> {
        let by = self.by_bow(board_m);
        Vector3::new(board_m.x, board_m.y, by.x * bow_m[0] + by.y * bow_m[1])
    }
}
