//! What a flight's residuals show of its own variances, and where the camera was remounted.

use nalgebra::{DMatrix, DVector, Vector3};

use super::frames::Flight;
use super::hyperparameters::own_rotation_column;
use super::solving::Solved;
use crate::adjust::AdjustError;
use crate::adjust::terms::{repeatability_rad, stated_drift_rad};
use crate::estimation::Gradient;
use crate::estimation::quality::chi_square_limit;
use crate::estimation::robust::median;

/// Bounds of a frame's departure from the shared shape, shares of the usual width of shapes.
const DEPARTURE_BOUNDS: (f64, f64) = (0.002, 1.0);
/// Change of a standard deviation's logarithm below which it is settled.
const SETTLED: f64 = 0.3;
/// Redundancy below which residuals show nothing of a variance.
const MIN_REDUNDANCY: f64 = 0.5;
/// Level of the test that finds a remounted camera, for a flight as a whole.
const REMOUNT_ALPHA: f64 = 1e-4;
/// A mounting moves by less than this between two shots, rad (0.1 px at 8000 px).
pub const STEADY_RAD: f64 = 1.2e-5;

/// Residuals' weighted square and their redundancy: what they show of their variance (Koch's estimate of one component).
#[derive(Clone, Copy, Debug)]
pub struct VarianceEvidence {
    /// Weighted square.
    pub square: f64,
    /// Redundancy.
    pub redundancy: f64,
}

/// A departure from the shared shape within its bounds.
pub fn bounded_departure(departure: f64) -> f64 {
    departure.clamp(DEPARTURE_BOUNDS.0, DEPARTURE_BOUNDS.1)
}

impl Solved {
    /// Covariance of a frame's departures from the shared shape.
    fn departures(&self, frame: usize) -> &DMatrix<f64> {
        let block = self.setting.members[frame].len();
        &self.setting.problem.groups[frame].blocks[block].covariance
    }

    /// What a frame's departures from the shared shape show of parts of their covariance (Förstner's estimate of variance
    /// components; of one part Koch's).
    pub fn departure_shown<const N: usize>(
        &self,
        frame: usize,
        parts: [&DMatrix<f64>; N],
    ) -> Option<[VarianceEvidence; N]> {
        let Self { setting, fit, .. } = self;
        let block = setting.members[frame].len();
        let covariance = self.departures(frame);
        let factor = covariance.clone().cholesky()?;
        let weighted = factor.solve(&fit.groups[frame].blocks[block].residuals);
        let of_residuals = covariance - fit.adjusted_covariance(frame, block);
        let weights = factor.solve(&factor.solve(&of_residuals).transpose());
        let shown = |part: &DMatrix<f64>| VarianceEvidence {
            square: weighted.dot(&(part * &weighted)),
            redundancy: part.component_mul(&weights).sum(),
        };
        Some(parts.map(shown))
    }

    /// A frame's rotation about what its mounting's frames have in common, and the gradient that picks it.
    fn own_rotation(&self, frame: usize) -> Option<(Gradient, Vector3<f64>)> {
        let layout = &self.setting.layouts[frame];
        let first = own_rotation_column(layout)?;
        let mut gradient = Gradient::empty(vec![], layout.local, 3);
        (0..3).for_each(|k| gradient.local[(first + k, k)] = 1.0);
        Some((gradient, self.fit.groups[frame].local.fixed_rows::<3>(first).into_owned()))
    }

    /// Squared difference of two frames' rotations in its standard deviations.
    fn rotation_distance(&self, a: usize, b: usize) -> f64 {
        let part = |frame: usize| {
            let (gradient, value) = self.own_rotation(frame)?;
            Some((self.fit.propagate(frame, &gradient), value))
        };
        let (Some((pa, va)), Some((pb, vb))) = (part(a), part(b)) else { return 0.0 };
        let total = &pa.total - &pb.total;
        let covariance = &total * &self.fit.covariance * total.transpose()
            + &pa.own
            + &pb.own
            + DMatrix::identity(3, 3) * STEADY_RAD.powi(2);
        let difference: Vector3<f64> = va - vb;
        let difference = DVector::from_column_slice(difference.as_slice());
        covariance.cholesky().map_or(0.0, |c| difference.dot(&c.solve(&difference)))
    }
}

/// Whether a standard deviation changed little.
pub fn is_settled(before: f64, after: f64) -> bool {
    (after / before).ln().abs() < SETTLED
}

impl Flight<'_> {
    /// Sets the departure from the shared shape, the drift, and widths that nobody stated, to what their own residuals show (Koch's estimate of
    /// one variance component). The last change waits for the caller's next solution.
    pub fn tune(&mut self, mut last: Solved, rounds: usize) -> Result<Solved, AdjustError> {
        for round in 1..=rounds {
            let (mut omega, mut redundancy) = (0.0, 0.0);
            let shown = |frame: usize| last.departure_shown(frame, [last.departures(frame)]);
            for [shown] in (0..self.frames.len()).filter_map(shown) {
                omega += shown.square;
                redundancy += shown.redundancy;
            }
            if redundancy < MIN_REDUNDANCY {
                break;
            }
            let before = self.assumed.departure;
            self.assumed.departure = bounded_departure(before * (omega / redundancy).sqrt());
            let others = [self.tune_drift(&last), self.tune_widths(&last)];
            let settled = others == [true; 2] && is_settled(before, self.assumed.departure);
            if settled || round == rounds {
                break;
            }
            last = self.solve(Some(&last.fit))?;
        }
        Ok(last)
    }

    /// Sets the drift to what the rotations within each mounting show, not below what is stated. Yaw and roll
    /// tell it well; pitch, which one frame hardly tells from bending, is taken to creep somewhat more. The stated
    /// drift counts as one observation. Whether it changed little.
    fn tune_drift(&mut self, solved: &Solved) -> bool {
        if !self.assumed.mountings.are_found() {
            return true;
        }
        let (stated, before) = (stated_drift_rad(self.input.setup), self.assumed.drift_rad);
        let (mut omega, mut redundancy) = ((stated / before).powi(2), 1.0);
        for frame in 0..self.frames.len() {
            let Some((gradient, value)) = solved.own_rotation(frame) else { continue };
            let covariance = solved.fit.function_covariance(frame, &gradient);
            let drift = self.assumed.drift_covariance(&self.input.scene.camera_from_wing);
            let Some(weight) = drift.try_inverse() else { continue };
            omega += value.dot(&(weight * value));
            redundancy += 3.0 - (weight * covariance.fixed_view::<3, 3>(0, 0)).trace();
        }
        let next = before * (omega / redundancy.max(MIN_REDUNDANCY)).sqrt();
        let loosest = repeatability_rad(self.input.setup).max(stated);
        self.assumed.drift_rad = next.clamp(stated, loosest);
        is_settled(before, self.assumed.drift_rad)
    }

    /// Splits the flight where the rotation changes by more than chance **and** by more than it does elsewhere: a remount
    /// stands out among the steps from frame to frame. Where all steps are alike, large or small, the frames are of one
    /// mounting that turns by as much as they show: to take two that hardly differ for equal costs more than it gains.
    /// Where the mountings are known, they are what counts.
    pub fn find_mountings(&mut self, solved: &Solved) {
        let frames = self.frames.len();
        self.assumed.mountings = self.assumed.mountings.found(|| {
            let steps: Vec<f64> = (1..frames).map(|f| solved.rotation_distance(f - 1, f)).collect();
            let usual = (median(steps.clone()).unwrap_or(0.0) / chi_square_limit(3.0, 0.5)).max(1.0);
            let limit = usual * chi_square_limit(3.0, REMOUNT_ALPHA / frames as f64);
            let mut numbers = vec![0; frames];
            for frame in 1..frames {
                numbers[frame] = numbers[frame - 1] + usize::from(steps[frame - 1] > limit);
            }
            numbers
        });
        self.assumed.drift_rad = self.assumed.drift_rad.max(self.assumed.rotations_rms_rad());
    }
}
