//! Shape of the board: real boards bow along and across.
//!
//! `z = a (1 - u^2) + b (1 - v^2)`, with `u`, `v` from -1 to 1 over the points seen (the model of mrcal's
//! `calobject_warp`). Terms linear in `u` and `v` belong to the pose, so that `a` and `b` do not depend on the corner from
//! which rows and columns are counted. The shortening of the rows by a bow of some millimetres is of second order and below
//! a hundredth of a millimetre.
//!
//! Paper shrinks, and printers scale it, differently along and across: the **stretch**, `x (1 - s/2)` and `y (1 + s/2)`. A
//! scale common to both directions moves the boards in depth and leaves the camera unchanged: it is no unknown.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::model::{BoardForm, DISTANCES_M, ScalarPrior};
use super::{BoardView, T_LIMIT_95};

/// Height of the board's middle over the chord between two of its sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardBow {
    /// Bow, m; positive away from the camera for a checkerboard, towards it for an AprilGrid, whose rows run upwards.
    pub value_m: f64,
    /// Standard deviation, scaled by the residuals, m.
    pub sigma_m: f64,
}

impl BoardBow {
    /// Returns true if the bow differs from 0 at 95 %.
    pub fn is_significant(&self) -> bool {
        self.value_m.abs() > T_LIMIT_95 * self.sigma_m
    }
}

/// Prior standard deviation of a bow, m per m of the side: an assumption, over three times the 1.5 mm per metre expected of
/// boards. It matters only if the images do not determine the bow.
const BOW_SIGMA_M_PER_M: f64 = 0.005;

/// Extra length of the board across its rows against along them, compared with its description.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardStretch {
    /// Stretch, relative.
    pub value: f64,
    /// Standard deviation, scaled by the residuals.
    pub sigma: f64,
    /// Change of the projection caused by the stretch at 15 m, root mean square over the image, px.
    pub projection_change_px: f64,
    /// Standard deviation given by the board's description; the camera then allows for the stretch.
    pub prior_sigma: Option<f64>,
}

impl BoardStretch {
    /// Distance at which the effect of the stretch is given, m: the middle of the distances of markers.
    pub(super) const DISTANCE_M: f64 = DISTANCES_M[1];

    /// Returns true if the stretch differs from 0 at 95 %.
    pub fn is_significant(&self) -> bool {
        self.value.abs() > T_LIMIT_95 * self.sigma
    }
}

/// Rectangle of the board's points: centre and half sides.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoardShape {
    middle_m: Vector2<f64>,
    half_m: Vector2<f64>,
}

impl BoardShape {
    /// Returns the rectangle that contains all points seen.
    pub(super) fn from_views(views: &[&BoardView]) -> Self {
        let mut points = views.iter().flat_map(|v| v.iter()).map(|p| p.board_m);
        let first = points.next().unwrap_or_default();
        let (low, high) = points.fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
        // A single row has no bow across; any half side but 0 is right.
        let half_m = (0.5 * (high - low)).map(|h| if h > 0.0 { h } else { 1.0 });
        Self {
            middle_m: 0.5 * (low + high),
            half_m,
        }
    }

    /// Returns two opposite corners of the rectangle, m.
    pub(super) fn bounds_m(&self) -> (Vector2<f64>, Vector2<f64>) {
        (self.middle_m - self.half_m, self.middle_m + self.half_m)
    }

    /// Returns the sides of the rectangle, m.
    pub(super) fn sides_m(&self) -> [f64; 2] {
        [2.0 * self.half_m.x, 2.0 * self.half_m.y]
    }

    /// Returns priors on bows and stretch, which are the parameters from `first` on.
    pub(super) fn priors(&self, first: usize, stretch_sigma: f64) -> Vec<ScalarPrior> {
        let bow = |k: usize| BOW_SIGMA_M_PER_M * 2.0 * self.half_m[k];
        let sigmas = [bow(0), bow(1), stretch_sigma];
        let prior = |(k, sigma)| ScalarPrior {
            index: first + k,
            mean: 0.0,
            sigma,
        };
        sigmas.into_iter().enumerate().map(prior).collect()
    }

    /// Returns d point / d form, board frame.
    pub(super) fn form_jacobian(&self, board_m: &Vector2<f64>) -> Matrix3<f64> {
        let off = board_m - self.middle_m;
        let uv = off.component_div(&self.half_m);
        Matrix3::new(
            0.0,
            0.0,
            -0.5 * off.x,
            0.0,
            0.0,
            0.5 * off.y,
            1.0 - uv.x * uv.x,
            1.0 - uv.y * uv.y,
            0.0,
        )
    }

    /// Returns the position in space of a board point on the bent board, board frame, m: linear in the form.
    pub(super) fn surface_point(&self, board_m: &Vector2<f64>, form: &BoardForm) -> Vector3<f64> {
        Vector3::new(board_m.x, board_m.y, 0.0) + self.form_jacobian(board_m) * form
    }
}
