//! What a flight's setting rests on beside observations: assumed at first, then as the last solution shows it.

use nalgebra::{DVector, Matrix3, Vector3};

use super::mountings::Mountings;
use crate::adjust::input::Input;
use crate::adjust::layout::Layout;
use crate::adjust::term::ParameterScope;
use crate::adjust::terms::stated_drift_rad;
use crate::adjust::values::Values;
use crate::estimation::Fit;

/// Departure of a frame's shape from the shared one to begin with, a share of the usual width of shapes.
pub const DEPARTURE: f64 = 0.03;
/// Bending to begin with, and what a swing is a share of, 1/m.
pub const USUAL_CURVATURE_PER_M: f64 = 0.005;
/// Bending below this counts as unbent, 1/m.
const MIN_CURVATURE_PER_M: f64 = 2e-4;

/// Drift in pitch over that about the other axes, which tell it: the mean of a variance that some f degrees of freedom tell
/// is f / (f - 2) times what they show. A random walk of ten frames leaves about five in yaw and roll together.
const PITCH_DRIFT: f64 = 1.3;

/// What is taken for granted of a flight's frames.
#[derive(Clone, Debug)]
pub struct FlightHyperparameters<'a> {
    /// Leading coefficient of each frame's curvature, 1/m.
    pub amplitudes_per_m: Vec<f64>,
    /// A frame's departure from the shared shape, a share of the usual width of shapes.
    pub departure: f64,
    /// A frame's swing in shapes of its own, such as the second mode's, a share of what no fleet explains at the usual bending, for it
    /// does not grow with the deflection; 0: frames do not swing.
    pub swing: f64,
    /// Which mounting each frame belongs to.
    pub mountings: Mountings<'a>,
    /// Standard deviation of a frame's rotation about its mounting's, rad.
    pub drift_rad: f64,
    /// Per frame what its mounting's unknowns are with its own part of the rotation, which is the first three.
    of_mounting: Vec<DVector<f64>>,
    /// How each frame bends and twists.
    bendings: Vec<OfFrame>,
}

/// How a frame bends and twists; empty before the first solution.
#[derive(Clone, Debug, Default)]
pub struct OfFrame {
    /// 1/m.
    pub curvature_per_m: Vec<f64>,
    /// Of the twist's basis, rad.
    pub twist_rad: Vec<f64>,
}

impl<'a> FlightHyperparameters<'a> {
    /// Before the first solution.
    pub fn at_first(input: &Input, frames: usize, mountings: Mountings<'a>) -> Self {
        Self {
            amplitudes_per_m: vec![USUAL_CURVATURE_PER_M; frames],
            departure: DEPARTURE,
            swing: 0.0,
            mountings,
            drift_rad: stated_drift_rad(input.setup),
            of_mounting: vec![DVector::zeros(3); frames],
            bendings: vec![OfFrame::default(); frames],
        }
    }

    /// With another frame's bending.
    pub fn bent(self, curvature_per_m: f64) -> Self {
        Self { amplitudes_per_m: vec![amplitude(curvature_per_m)], ..self }
    }

    /// With how far frames depart from the shared shape, by other loads and by swings.
    pub fn departing(self, departure: f64, swing: f64) -> Self {
        Self { departure, swing, ..self }
    }

    /// Takes over what a solution says of a frame.
    pub fn learn(&mut self, frame: usize, layout: &Layout, fit: &Fit) {
        let local = &fit.groups[frame].local;
        self.amplitudes_per_m[frame] = amplitude(local[0]);
        let mut own = fit.global.rows(layout.own.first, layout.own.count).into_owned();
        if let Some(first) = own_rotation_column(layout) {
            let mut rotation = own.rows_mut(0, 3);
            rotation += local.rows(first, 3);
        }
        self.of_mounting[frame] = own;
        let Values { curvature_per_m, twist_rad, .. } = layout.values(&fit.global, local);
        self.bendings[frame] = OfFrame { curvature_per_m, twist_rad };
    }

    /// How a frame bends, with the twist that all frames show together at its amplitude; `None` before the first solution and
    /// of a frame alone. What all frames tell of the places of root and axis has an answer to each frame's twist in it, whose
    /// noise passes for knowledge where frames are many.
    pub fn usual_bending(&self, frame: usize) -> Option<OfFrame> {
        let of = self.bendings.get(frame).filter(|of| self.bendings.len() > 1 && !of.twist_rad.is_empty())?;
        let at = self.amplitudes_per_m[frame];
        let one = |k: usize| {
            let all = self.amplitudes_per_m.iter().zip(&self.bendings);
            on_a_line(all.map(|(a, of)| (*a, of.twist_rad.get(k).copied().unwrap_or(0.0))), at)
        };
        let twist_rad = (0..of.twist_rad.len()).map(one).collect();
        Some(OfFrame { twist_rad, ..of.clone() })
    }

    /// Mean of a mounting's unknowns over its frames.
    pub fn mean(&self, mounting: usize) -> DVector<f64> {
        let frames = (0..self.of_mounting.len()).filter(|f| self.mountings.of(*f) == mounting);
        let own: Vec<_> = frames.map(|f| &self.of_mounting[f]).collect();
        let mut sum = DVector::zeros(own.first().map_or(0, |o| o.len()));
        own.iter().for_each(|o| sum += *o);
        sum / own.len().max(1) as f64
    }

    /// A frame's rotation about its mounting's, camera frame, rad.
    pub fn own_rotation_rad(&self, frame: usize) -> Vector3<f64> {
        let mean = self.mean(self.mountings.of(frame));
        (self.of_mounting[frame].rows(0, 3) - mean.rows(0, 3)).fixed_rows::<3>(0).into_owned()
    }

    /// Root mean square of the rotations about their mountings' means, each axis, rad.
    pub fn rotations_rms_rad(&self) -> f64 {
        let frames = self.of_mounting.len();
        let sum: f64 = (0..frames).map(|f| self.own_rotation_rad(f).norm_squared()).sum();
        (sum / (3 * frames.max(1)) as f64).sqrt()
    }

    /// Of a frame's rotation about its mounting's, camera frame, rad^2.
    pub fn drift_covariance(&self, camera_from_wing: &Matrix3<f64>) -> Matrix3<f64> {
        let pitch = camera_from_wing * Vector3::z();
        let more = pitch * pitch.transpose() * (PITCH_DRIFT * PITCH_DRIFT - 1.0);
        (Matrix3::identity() + more) * (self.drift_rad * self.drift_rad)
    }
}

/// Value at a place of the straight line nearest to these.
fn on_a_line(points: impl Iterator<Item = (f64, f64)> + Clone, at: f64) -> f64 {
    let count = points.clone().count().max(1) as f64;
    let (x, y) = points.clone().fold((0.0, 0.0), |(sx, sy), (x, y)| (sx + x, sy + y));
    let (x, y) = (x / count, y / count);
    let (square, both) =
        points.fold((0.0, 0.0), |(xx, xy), (px, py)| (xx + (px - x).powi(2), xy + (px - x) * (py - y)));
    y + if square > 0.0 { both / square * (at - x) } else { 0.0 }
}

fn amplitude(curvature_per_m: f64) -> f64 {
    curvature_per_m.abs().max(MIN_CURVATURE_PER_M)
}

/// First local column of a frame's rotation about its mounting's.
pub fn own_rotation_column(layout: &Layout) -> Option<usize> {
    layout.rotation.iter().find_map(|place| match place {
        ParameterScope::Local(first) => Some(*first),
        ParameterScope::Global(_) => None,
    })
}
