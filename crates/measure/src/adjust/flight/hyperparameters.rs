//! Hyperparameters of a flight: assumed first, then taken from the last solution.

use nalgebra::{DVector, Matrix3, Vector3};

use super::mountings::FrameMountings;
use crate::adjust::input::AdjustmentInput;
use crate::adjust::layout::ParameterLayout;
use crate::adjust::shapes::{TYPICAL_CURVATURE_PER_M, bounded_amplitude};
use crate::adjust::term::ParameterScope;
use crate::adjust::terms::mount_drift_rad;
use crate::adjust::values::UnknownValues;
use crate::estimation::Fit;

/// Initial departure of a frame's shape from the shared shape, as a fraction of the prior spread of shapes.
pub const INITIAL_DEPARTURE: f64 = 0.03;

/// Ratio of pitch drift to the drift about the other axes, which determine it. With f degrees of freedom the expected
/// variance is f / (f - 2) times the estimate; a random walk of ten frames has about five in yaw and roll together.
const PITCH_DRIFT_FACTOR: f64 = 1.3;

/// Hyperparameters of a flight's frames.
#[derive(Clone, Debug)]
pub struct FlightHyperparameters<'a> {
    /// Leading curvature coefficient of each frame, 1/m.
    pub amplitudes_per_m: Vec<f64>,
    /// Departure of a frame from the shared shape, as a fraction of the prior spread of shapes.
    pub departure: f64,
    /// Vibration of a frame in shapes of its own, such as the second mode, as a fraction of the spread that the fleet does
    /// not explain at typical bending; it does not grow with the deflection. 0: no vibration.
    pub oscillation: f64,
    /// Mounting of each frame.
    pub mountings: FrameMountings<'a>,
    /// Standard deviation of a frame's rotation about its mounting's, rad.
    pub drift_rad: f64,
    /// Increase of the variance of the pitch's drift that the frames show, in units of `drift_rad` squared: a mount sags.
    pub pitch_drift_increase: f64,
    /// Whether its trend through the flight is significant.
    pub sags: bool,
    /// Unknowns of the mounting for each frame; the first three are the rotation including the frame's own part.
    mounting_values: Vec<DVector<f64>>,
    /// Bending and twist of each frame.
    bendings: Vec<FrameBending>,
}

/// Bending and twist of a frame; empty if they are not known.
#[derive(Clone, Debug, Default)]
pub struct FrameBending {
    pub curvature_per_m: Vec<f64>,
    /// Coefficients of the twist basis, rad.
    pub twist_rad: Vec<f64>,
}

impl<'a> FlightHyperparameters<'a> {
    /// Values before the first solution.
    pub fn initial(input: &AdjustmentInput, frames: usize, mountings: FrameMountings<'a>) -> Self {
        Self {
            amplitudes_per_m: vec![TYPICAL_CURVATURE_PER_M; frames],
            departure: INITIAL_DEPARTURE,
            oscillation: 0.0,
            mountings,
            drift_rad: mount_drift_rad(input.setup),
            pitch_drift_increase: 0.0,
            sags: false,
            mounting_values: vec![DVector::zeros(3); frames],
            bendings: vec![FrameBending::default(); frames],
        }
    }

    /// Values of a single frame, which has the rotation of its mounting, and a typical bending before the first solution.
    pub fn for_single_frame(input: &AdjustmentInput<'a>) -> Self {
        let mountings = FrameMountings::for_single_frame(input.options.mountings.as_deref());
        let typical = FrameBending {
            curvature_per_m: vec![TYPICAL_CURVATURE_PER_M],
            twist_rad: vec![],
        };
        Self {
            drift_rad: 0.0,
            bendings: vec![typical],
            ..Self::initial(input, 1, mountings)
        }
    }

    /// Updates a frame's values from a solution.
    pub fn update_from_frame(&mut self, frame: usize, layout: &ParameterLayout, fit: &Fit) {
        let local = &fit.groups[frame].local;
        self.amplitudes_per_m[frame] = bounded_amplitude(local[0]);
        let mut own = fit
            .global
            .rows(layout.mounting.first, layout.mounting.count)
            .into_owned();
        if let Some(first) = frame_rotation_column(layout) {
            let mut rotation = own.rows_mut(0, 3);
            rotation += local.rows(first, 3);
        }
        self.mounting_values[frame] = own;
        let UnknownValues {
            curvature_per_m,
            twist_rad,
            ..
        } = layout.values(&fit.global, local);
        self.bendings[frame] = FrameBending {
            curvature_per_m,
            twist_rad,
        };
    }

    /// Bending of a frame, with the twist that all frames together show at its amplitude; `None` if it is not known. Derivatives
    /// with respect to the estimated dimensions, which hardly change in a solution, depend on the twist. With each frame's own
    /// twist, its noise would be counted as information if there are many frames.
    pub fn smoothed_bending(&self, frame: usize) -> Option<FrameBending> {
        let bending = self
            .bendings
            .get(frame)
            .filter(|bending| !bending.curvature_per_m.is_empty())?;
        let at = self.amplitudes_per_m[frame];
        let one = |k: usize| {
            let all = self.amplitudes_per_m.iter().zip(&self.bendings);
            value_on_line(
                all.map(|(a, other)| (*a, other.twist_rad.get(k).copied().unwrap_or(0.0))),
                at,
            )
        };
        let twist_rad = (0..bending.twist_rad.len()).map(one).collect();
        Some(FrameBending {
            twist_rad,
            ..bending.clone()
        })
    }

    /// Mean of a mounting's unknowns over its frames.
    pub fn mounting_mean(&self, mounting: usize) -> DVector<f64> {
        let frames = (0..self.mounting_values.len())
            .filter(|f| self.mountings.mounting_of_frame(*f) == mounting);
        let own: Vec<_> = frames.map(|f| &self.mounting_values[f]).collect();
        let mut sum = DVector::zeros(own.first().map_or(0, |o| o.len()));
        own.iter().for_each(|o| sum += *o);
        sum / own.len().max(1) as f64
    }

    /// Rotation of a frame about its mounting's, camera frame, rad.
    pub fn frame_rotation_rad(&self, frame: usize) -> Vector3<f64> {
        let mean = self.mounting_mean(self.mountings.mounting_of_frame(frame));
        (self.mounting_values[frame].rows(0, 3) - mean.rows(0, 3))
            .fixed_rows::<3>(0)
            .into_owned()
    }

    /// Root mean square of the frames' rotations about their mountings' means, per axis, rad.
    pub fn rotations_rms_rad(&self) -> f64 {
        let frames = self.mounting_values.len();
        let sum: f64 = (0..frames)
            .map(|f| self.frame_rotation_rad(f).norm_squared())
            .sum();
        (sum / (3 * frames.max(1)) as f64).sqrt()
    }

    /// Size of the pitch's trend from the first frame to the last, rad.
    pub fn pitch_trend_rad(&self) -> f64 {
        self.drift_rad * self.pitch_drift_increase.sqrt()
    }

    /// Covariance of a frame's rotation about its mounting's, camera frame, rad^2.
    pub fn drift_covariance(&self, camera_from_wing: &Matrix3<f64>) -> Matrix3<f64> {
        let pitch = camera_from_wing * Vector3::z();
        let increase = PITCH_DRIFT_FACTOR * PITCH_DRIFT_FACTOR - 1.0 + self.pitch_drift_increase;
        let more = pitch * pitch.transpose() * increase;
        (Matrix3::identity() + more) * (self.drift_rad * self.drift_rad)
    }
}

/// Value at a position on the least-squares line through the points.
fn value_on_line(points: impl Iterator<Item = (f64, f64)> + Clone, at: f64) -> f64 {
    let count = points.clone().count().max(1) as f64;
    let (x, y) = points
        .clone()
        .fold((0.0, 0.0), |(sx, sy), (x, y)| (sx + x, sy + y));
    let (x, y) = (x / count, y / count);
    let (square, both) = points.fold((0.0, 0.0), |(xx, xy), (px, py)| {
        (xx + (px - x).powi(2), xy + (px - x) * (py - y))
    });
    y + if square > 0.0 {
        both / square * (at - x)
    } else {
        0.0
    }
}

/// First local column of a frame's rotation about its mounting's.
pub fn frame_rotation_column(layout: &ParameterLayout) -> Option<usize> {
    layout.rotation.iter().find_map(|scope| match scope {
        ParameterScope::Local(first) => Some(*first),
        ParameterScope::Global(_) => None,
    })
}
