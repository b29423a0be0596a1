//! Where the camera is, where it looks, and what it looks through.

use nalgebra::{DMatrix, Matrix3, SMatrix, Vector2, Vector3};

use crate::measure::adjust::gauss_helmert::Prior;
use crate::measure::adjust::input::Input;
use crate::measure::adjust::scene::Predicted;
use crate::measure::adjust::term::{Sight, Term};
use crate::measure::adjust::values::Values;
use crate::measure::geometry::BROWN;
use crate::measure::setup::Setup;

/// A mounting that is stated not to drift is taken to do so by this, rad: a prior needs a width (0.001 px at 8000 px).
const LEAST_DRIFT_RAD: f64 = 1e-7;
/// A mounting that is stated to repeat itself exactly, px: the same.
const LEAST_REPEATABILITY_PX: f64 = 1e-3;
/// A pane that is stated without error is taken at this, m: a thousandth of a pixel at 8 m, and a regular prior.
const LEAST_WINDOW_SIGMA_M: f64 = 1e-6;
/// Variance of an interior parameter that the calibration held, in its own unit squared: none that shows.
const HELD_LENS_VARIANCE: f64 = 1e-16;

fn vector(x: &[f64]) -> Vector3<f64> {
    Vector3::from_column_slice(x)
}

fn matrix(of: &Matrix3<f64>) -> DMatrix<f64> {
    DMatrix::from_column_slice(3, 3, of.as_slice())
}

/// Drift of one mounting as stated, each axis, rad; not 0.
pub fn stated_drift_rad(setup: &Setup) -> f64 {
    setup.uncertainty.mount_drift_rad.max(LEAST_DRIFT_RAD)
}

/// How well a mounting's rotation repeats, each axis, rad; not 0.
pub fn repeatability_rad(setup: &Setup) -> f64 {
    setup.mount_repeatability_px.max(LEAST_REPEATABILITY_PX) / setup.lens.focal_px()
}

/// Small rotation of the camera in flight against the ground frame's, camera frame, rad: a mounting's, or a frame's own
/// about its mounting's.
#[derive(Debug)]
pub struct Rotation {
    mean_rad: Vector3<f64>,
    /// Of what is known beforehand, camera frame, rad^2.
    pub covariance_rad2: Matrix3<f64>,
}

impl Rotation {
    /// Before a frame is seen.
    pub fn of_mounting(input: &Input) -> Self {
        let repeatability = repeatability_rad(input.setup);
        let stated = input.orientation.covariance_rad2.filter(|_| !input.scene.has_ground_sights());
        let own =
            Matrix3::identity() * (repeatability * repeatability) + stated.unwrap_or_else(Matrix3::zeros);
        let (mean_rad, covariance_rad2) = input.options.mount_prior.unwrap_or((Vector3::zeros(), own));
        Self { mean_rad, covariance_rad2 }
    }

    /// Where the camera stayed since the ground frames: it drifts.
    pub fn stayed(setup: &Setup) -> Self {
        Self::about_mounting(Matrix3::identity() * stated_drift_rad(setup).powi(2))
    }

    /// A frame's own about its mounting's.
    pub fn about_mounting(covariance_rad2: Matrix3<f64>) -> Self {
        Self { mean_rad: Vector3::zeros(), covariance_rad2 }
    }

    /// What is known of it, its columns counted from 0.
    pub fn prior(&self) -> Prior {
        let mean = nalgebra::DVector::from_column_slice(self.mean_rad.as_slice());
        Prior { mean, ..Prior::centred(self.name(), 0, matrix(&self.covariance_rad2)) }
    }
}

impl Term for Rotation {
    fn name(&self) -> &'static str {
        "rotation of the mounting"
    }

    fn missing(&self) -> &'static str {
        "the mounting's rotation cannot be determined; give camera.mount_repeatability_px or more markers near the root"
    }

    fn size(&self) -> usize {
        3
    }

    fn priors(&self) -> Vec<Prior> {
        vec![self.prior()]
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.pose.mount_rad += vector(x);
    }

    fn in_flight(&self, k: usize, sight: &Sight) -> Vector2<f64> {
        sight.predicted.by_mount.column(k).into_owned()
    }
}

/// Correction of the ground frame's rotation, camera frame, rad.
#[derive(Debug)]
pub struct GroundRotation;

impl Term for GroundRotation {
    fn name(&self) -> &'static str {
        "rotation on ground"
    }

    fn missing(&self) -> &'static str {
        "the rotation on ground cannot be determined; more markers in the ground frame are needed"
    }

    fn size(&self) -> usize {
        3
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.pose.ground_rad += vector(x);
    }

    fn in_flight(&self, k: usize, sight: &Sight) -> Vector2<f64> {
        self.on_ground(k, sight.predicted)
    }

    fn on_ground(&self, k: usize, predicted: &Predicted) -> Vector2<f64> {
        predicted.by_ground_rotation.column(k).into_owned()
    }
}

/// Correction of the projection centre, wing frame, m.
#[derive(Debug)]
pub struct Centre {
    /// Each axis.
    pub sigma_m: f64,
}

impl Term for Centre {
    fn name(&self) -> &'static str {
        "projection centre"
    }

    fn missing(&self) -> &'static str {
        "the projection centre cannot be determined; give camera.projection_centre_sigma_m"
    }

    fn size(&self) -> usize {
        3
    }

    fn priors(&self) -> Vec<Prior> {
        (0..3).map(|k| Prior::scalar(self.name(), k, 0.0, self.sigma_m)).collect()
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.pose.centre_m += vector(x);
    }

    fn in_flight(&self, k: usize, sight: &Sight) -> Vector2<f64> {
        self.on_ground(k, sight.predicted)
    }

    fn on_ground(&self, k: usize, predicted: &Predicted) -> Vector2<f64> {
        -predicted.by_point.column(k)
    }
}

/// Shift of the projection centre since the ground frame, of one mounting, wing frame, m.
#[derive(Debug)]
pub struct Shift {
    /// Each axis.
    pub sigma_m: f64,
}

impl Term for Shift {
    fn name(&self) -> &'static str {
        "shift of the mounting"
    }

    fn missing(&self) -> &'static str {
        "the mounting's shift cannot be determined; give camera.mount_shift_m"
    }

    fn size(&self) -> usize {
        3
    }

    fn priors(&self) -> Vec<Prior> {
        (0..3).map(|k| Prior::scalar(self.name(), k, 0.0, self.sigma_m)).collect()
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.pose.shift_m += vector(x);
    }

    fn in_flight(&self, k: usize, sight: &Sight) -> Vector2<f64> {
        -sight.predicted.by_point.column(k)
    }
}

/// What is left of the panes' shift where only the flight is seen through them: a shift of the projection
/// centre that all frames share, wing frame, m. Where ground and flight are seen alike it is a part of the centre's.
#[derive(Debug)]
pub struct PaneShift {
    /// What the description of the panes leaves unknown of it.
    pub covariance_m2: Matrix3<f64>,
}

const PANES_MISSING: &str =
    "the panes' shift or bow cannot be determined; give the standard deviations in [window]";

impl Term for PaneShift {
    fn name(&self) -> &'static str {
        "panes' shift"
    }

    fn missing(&self) -> &'static str {
        PANES_MISSING
    }

    fn size(&self) -> usize {
        3
    }

    fn priors(&self) -> Vec<Prior> {
        let least = DMatrix::identity(3, 3) * (LEAST_WINDOW_SIGMA_M * LEAST_WINDOW_SIGMA_M);
        vec![Prior::centred(self.name(), 0, matrix(&self.covariance_m2) + least)]
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.pose.window_m += vector(x);
    }

    fn in_flight(&self, k: usize, sight: &Sight) -> Vector2<f64> {
        -sight.predicted.by_point.column(k)
    }
}

/// Correction of the panes' bow in flight, a share of its curvature.
#[derive(Debug)]
pub struct PaneBow {
    /// A share, too.
    pub sigma: f64,
}

impl Term for PaneBow {
    fn name(&self) -> &'static str {
        "panes' bow"
    }

    fn missing(&self) -> &'static str {
        PANES_MISSING
    }

    fn size(&self) -> usize {
        1
    }

    fn priors(&self) -> Vec<Prior> {
        vec![Prior::scalar(self.name(), 0, 0.0, self.sigma)]
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.pose.bow += x[0];
    }

    fn in_flight(&self, _k: usize, sight: &Sight) -> Vector2<f64> {
        sight.predicted.by_bow
    }
}

/// Correction of the interior orientation, in the order of [`crate::measure::geometry::Lens::PARAMETERS`].
#[derive(Debug)]
pub struct Interior {
    /// As calibrated.
    pub covariance: SMatrix<f64, BROWN, BROWN>,
}

impl Term for Interior {
    fn name(&self) -> &'static str {
        "interior orientation"
    }

    fn missing(&self) -> &'static str {
        "the interior orientation cannot be determined; give its covariance in camera.toml"
    }

    fn size(&self) -> usize {
        BROWN
    }

    /// A thousand-millionth more of each variance keeps a covariance that rounding left without an inverse regular.
    fn priors(&self) -> Vec<Prior> {
        let mut covariance = DMatrix::from_column_slice(BROWN, BROWN, self.covariance.as_slice());
        for k in 0..BROWN {
            covariance[(k, k)] = (covariance[(k, k)] * (1.0 + 1e-9)).max(HELD_LENS_VARIANCE);
        }
        vec![Prior::centred(self.name(), 0, covariance)]
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        values.pose.lens.iter_mut().zip(x).for_each(|(lens, x)| *lens += x);
    }

    fn in_flight(&self, k: usize, sight: &Sight) -> Vector2<f64> {
        self.on_ground(k, sight.predicted)
    }

    fn on_ground(&self, k: usize, predicted: &Predicted) -> Vector2<f64> {
        predicted.by_lens.column(k).into_owned()
    }
}
