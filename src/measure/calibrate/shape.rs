//! The board's shape: flat boards exist on paper; real ones bow along and across.
//!
//! `z = a (1 - u^2) + b (1 - v^2)`, with `u`, `v` from -1 to 1 over the points seen (the model of mrcal's
//! `calobject_warp`). What is linear in `u` and `v` belongs to the pose, so that the same `a`, `b` hold
//! wherever on the board the counting of its rows and columns began. By how much a bow of some
//! millimetres shortens the board's rows is of second order and below a hundredth of a millimetre.
//!
//! Paper shrinks, and printers feed it, by another share along than across: the **stretch**, `x (1 - s/2)` and
//! `y (1 + s/2)`. What both directions have in common is a scale, which moves the boards in depth and leaves the
//! camera as it is: no unknown.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::model::{DISTANCES_M, BoardForm};
use super::{SIGNIFICANT, BoardView};
use crate::estimation::arrow::ScalarPrior;

/// Height of the board's middle over the chord between two of its sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardBow {
    /// m; positive away from the camera for a checkerboard, towards it for an AprilGrid, whose rows run upwards.
    pub value_m: f64,
    /// Standard deviation, scaled by the residuals, m.
    pub sigma_m: f64,
}

impl BoardBow {
    /// Whether it differs from 0 at 95 %.
    pub fn is_significant(&self) -> bool {
        self.value_m.abs() > SIGNIFICANT * self.sigma_m
    }
}

/// Standard deviation of a bow beforehand, m per m of the side: an assumption, over three times the
/// 1.5 mm per metre that boards are expected to bow. It matters only where the pictures tell nothing about the bow.
const SIGMA_M_PER_M: f64 = 0.005;

/// By how much the board is longer across its rows than along them, as a share, against its description.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardStretch {
    /// Its share.
    pub value: f64,
    /// Standard deviation, scaled by the residuals.
    pub sigma: f64,
    /// By how much the projection changes with it at 15 m, root mean square over the image, px.
    pub worth_px: f64,
    /// Its standard deviation as the board's description states it: the camera then allows for it.
    pub stated: Option<f64>,
}

impl BoardStretch {
    /// Of the points by which its worth is told, m: in the middle of those at which markers lie.
    pub(super) const DISTANCE_M: f64 = DISTANCES_M[1];

    /// Whether it differs from 0 at 95 %.
    pub fn is_significant(&self) -> bool {
        self.value.abs() > SIGNIFICANT * self.sigma
    }
}

/// Where the board's points lie: middle and half the sides.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoardShape {
    middle_m: Vector2<f64>,
    half_m: Vector2<f64>,
}

impl BoardShape {
    /// Of all points seen.
    pub(super) fn from_views(views: &[&BoardView]) -> Self {
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

    /// Priors on bows and stretch, which are the parameters from `first` on.
    pub(super) fn priors(&self, first: usize, stretch_sigma: f64) -> Vec<ScalarPrior> {
        let bow = |k: usize| SIGMA_M_PER_M * 2.0 * self.half_m[k];
        let sigmas = [bow(0), bow(1), stretch_sigma];
        let prior = |(k, sigma)| ScalarPrior { index: first + k, mean: 0.0, sigma };
        sigmas.into_iter().enumerate().map(prior).collect()
    }

    /// d point / d form, board frame.
    pub(super) fn form_jacobian(&self, board_m: &Vector2<f64>) -> Matrix3<f64> {
        let off = board_m - self.middle_m;
        let uv = off.component_div(&self.half_m);
        Matrix3::new(0.0, 0.0, -0.5 * off.x, 0.0, 0.0, 0.5 * off.y, 1.0 - uv.x * uv.x, 1.0 - uv.y * uv.y, 0.0)
    }

    /// The point in space, board frame, m: linear in the form.
    pub(super) fn surface_point(&self, board_m: &Vector2<f64>, form: &BoardForm) -> Vector3<f64> {
        Vector3::new(board_m.x, board_m.y, 0.0) + self.form_jacobian(board_m) * form
    }
}
