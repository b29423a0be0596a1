//! Estimates a flight's variances from its residuals, and detects remounts of the camera.

use nalgebra::{DMatrix, DVector, Vector3};

use super::frames::Flight;
use super::hyperparameters::frame_rotation_column;
use super::solving::SolvedFlight;
use super::usage::{FlightUsage, RemovedObservation};
use crate::adjust::AdjustResult;
use crate::adjust::causes::WidthEvidence;
use crate::adjust::terms::{mount_drift_rad, mount_repeatability_rad};
use crate::estimation::Gradient;
use crate::estimation::quality::chi_square_limit;
use crate::estimation::robust::median;
use crate::widths::Width;

/// Bounds of a frame's departure from the shared shape, as fractions of the prior spread of shapes.
const DEPARTURE_BOUNDS: (f64, f64) = (0.002, 1.0);
/// Change of a standard deviation's logarithm below which it has settled.
const SETTLED_LOG_CHANGE: f64 = 0.3;
/// Redundancy below which residuals do not determine a variance.
const MIN_REDUNDANCY: f64 = 0.5;
/// Significance level of the test for remounts, for the flight as a whole.
const REMOUNT_ALPHA: f64 = 1e-4;
/// Rotation of a mounting between two frames that is negligible, rad (0.1 px at 8000 px).
pub const STEADY_ROTATION_RAD: f64 = 1.2e-5;

/// Significance level of the remark on a mount that sags.
const SAG_ALPHA: f64 = 5e-3;

/// Ratio of the drift to the configured one from which shifts of the image are tried as its cause.
const SUSPECT_DRIFT_RATIO: f64 = 3.0;
/// Standard deviation of the image's shift by stabilisation, px: lenses and sensors are moved by 0.1 mm and more.
const STABILISED_PX: f64 = 50.0;
/// Number of rounds in which the variances settle if images are shifted.
const SHIFT_ROUNDS: usize = 2;

/// Weighted square of residuals and their redundancy: the evidence for their variance (Koch's estimate of one component).
#[derive(Clone, Copy, Debug)]
pub struct VarianceEvidence {
    /// Weighted square of the residuals.
    pub square: f64,
    pub redundancy: f64,
}

/// Limits a departure from the shared shape to its bounds.
pub fn bounded_departure(departure: f64) -> f64 {
    departure.clamp(DEPARTURE_BOUNDS.0, DEPARTURE_BOUNDS.1)
}

impl SolvedFlight {
    /// Covariance of a frame's departures from the shared shape.
    fn departure_covariance(&self, frame: usize) -> &DMatrix<f64> {
        let block = self.flight_problem.members[frame].len();
        &self.flight_problem.problem.groups[frame].blocks[block].covariance
    }

    /// Evidence of a frame's departures from the shared shape for parts of their covariance (Förstner's estimate of
    /// variance components; Koch's for a single part).
    pub fn departure_evidence<const N: usize>(
        &self,
        frame: usize,
        parts: [&DMatrix<f64>; N],
    ) -> Option<[VarianceEvidence; N]> {
        let Self {
            flight_problem,
            fit,
            ..
        } = self;
        let block = flight_problem.members[frame].len();
        let covariance = self.departure_covariance(frame);
        let factor = covariance.clone().cholesky()?;
        let weighted = factor.solve(&fit.groups[frame].blocks[block].residuals);
        let of_residuals = covariance - fit.adjusted_covariance(frame, block);
        let weights = factor.solve(&factor.solve(&of_residuals).transpose());
        let evidence = |part: &DMatrix<f64>| VarianceEvidence {
            square: weighted.dot(&(part * &weighted)),
            redundancy: part.component_mul(&weights).sum(),
        };
        Some(parts.map(evidence))
    }

    /// Rotation of a frame about its mounting's, and the gradient that selects it.
    fn frame_rotation(&self, frame: usize) -> Option<(Gradient, Vector3<f64>)> {
        let layout = &self.flight_problem.layouts[frame];
        let first = frame_rotation_column(layout)?;
        let mut gradient = Gradient::empty(vec![], layout.local, 3);
        (0..3).for_each(|k| gradient.local[(first + k, k)] = 1.0);
        Some((
            gradient,
            self.fit.groups[frame]
                .local
                .fixed_rows::<3>(first)
                .into_owned(),
        ))
    }

    /// Squared difference of two frames' rotations, in units of its standard deviations.
    fn rotation_distance(&self, a: usize, b: usize) -> f64 {
        let part = |frame: usize| {
            let (gradient, value) = self.frame_rotation(frame)?;
            Some((self.fit.propagate(frame, &gradient), value))
        };
        let (Some((pa, va)), Some((pb, vb))) = (part(a), part(b)) else {
            return 0.0;
        };
        let total = &pa.total - &pb.total;
        let covariance = &total * &self.fit.covariance * total.transpose()
            + &pa.own
            + &pb.own
            + DMatrix::identity(3, 3) * STEADY_ROTATION_RAD.powi(2);
        let difference: Vector3<f64> = va - vb;
        let difference = DVector::from_column_slice(difference.as_slice());
        covariance
            .cholesky()
            .map_or(0.0, |c| difference.dot(&c.solve(&difference)))
    }
}

/// Returns whether a standard deviation changed only little.
pub fn is_settled(before: f64, after: f64) -> bool {
    (after / before).ln().abs() < SETTLED_LOG_CHANGE
}

impl Flight<'_> {
    /// Sets the departure from the shared shape, the drift and the default priors to what their residuals show (Koch's
    /// estimate of one variance component). The caller's next solution uses the last change.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn tune_variances(
        &mut self,
        mut last: SolvedFlight,
        rounds: usize,
    ) -> AdjustResult<SolvedFlight> {
        for round in 1..=rounds {
            let (mut omega, mut redundancy) = (0.0, 0.0);
            let evidence =
                |frame: usize| last.departure_evidence(frame, [last.departure_covariance(frame)]);
            for [evidence] in (0..self.frames.len()).filter_map(evidence) {
                omega += evidence.square;
                redundancy += evidence.redundancy;
            }
            if redundancy < MIN_REDUNDANCY {
                break;
            }
            let before = self.hyperparameters.departure;
            self.hyperparameters.departure =
                bounded_departure(before * (omega / redundancy).sqrt());
            let others = [self.tune_drift(&last), self.tune_prior_scales(&last)];
            let settled = others == [true; 2] && is_settled(before, self.hyperparameters.departure);
            if settled || round == rounds {
                break;
            }
            last = self.solve_rough(Some(&last.fit))?;
        }
        Ok(last)
    }

    /// Sets the drift to what the rotations within each mounting show, but not below the configured value. Yaw and roll
    /// determine it; pitch is poorly separable from bending in a single frame, and its drift is taken to be somewhat
    /// larger. The configured drift counts as one observation. Returns whether the drift changed only little.
    fn tune_drift(&mut self, solved: &SolvedFlight) -> bool {
        if !self.hyperparameters.mountings.are_assigned() {
            return true;
        }
        let (configured, before) = (
            mount_drift_rad(self.input.setup),
            self.hyperparameters.drift_rad,
        );
        let (mut omega, mut redundancy) = ((configured / before).powi(2), 1.0);
        for frame in 0..self.frames.len() {
            let Some((gradient, value)) = solved.frame_rotation(frame) else {
                continue;
            };
            let covariance = solved.fit.function_covariance(frame, &gradient);
            let drift = self
                .hyperparameters
                .drift_covariance(&self.input.scene.camera_from_wing);
            let Some(weight) = drift.try_inverse() else {
                continue;
            };
            omega += value.dot(&(weight * value));
            redundancy += 3.0 - (weight * covariance.fixed_view::<3, 3>(0, 0)).trace();
        }
        let next = before * (omega / redundancy.max(MIN_REDUNDANCY)).sqrt();
        let loosest = mount_repeatability_rad(self.input.setup).max(configured);
        let pitch_before = 1.0 + self.hyperparameters.pitch_drift_increase;
        if let Some((increase, probability)) = self.pitch_trend(solved) {
            self.hyperparameters.pitch_drift_increase = pitch_before * (1.0 + increase) - 1.0;
            self.hyperparameters.sags |= probability < SAG_ALPHA;
        }
        self.hyperparameters.drift_rad = next.clamp(configured, loosest);
        is_settled(before, self.hyperparameters.drift_rad)
            && is_settled(
                pitch_before,
                1.0 + self.hyperparameters.pitch_drift_increase,
            )
    }

    /// Relative increase of the pitch's drift variance that a trend through the flight makes likely, and the probability of so
    /// large a trend with the stated drift: a mount sags. Single frames hardly separate pitch from bending, their trend does.
    fn pitch_trend(&self, solved: &SolvedFlight) -> Option<(f64, f64)> {
        let frames = self.frames.len();
        let pitch = self.input.scene.camera_from_wing * Vector3::z();
        let drift = self
            .hyperparameters
            .drift_covariance(&self.input.scene.camera_from_wing);
        let variance = pitch.dot(&(drift * pitch));
        let (mut total, mut own, mut value, mut square) =
            (DMatrix::zeros(1, solved.fit.global.len()), 0.0, 0.0, 0.0);
        for frame in 0..frames {
            let (gradient, rotation) = solved.frame_rotation(frame)?;
            let part = solved.fit.propagate(frame, &gradient);
            let weight = frame as f64 / (frames.max(2) - 1) as f64 - 0.5;
            let along = DMatrix::from_row_slice(1, 3, (pitch * weight).as_slice());
            total += &along * &part.total;
            own += (&along * &part.own * along.transpose())[0];
            value += weight * pitch.dot(&rotation);
            square += weight * weight;
        }
        let posterior = own + (&total * &solved.fit.covariance * total.transpose())[0];
        let (score, information) = (value * value / variance, square - posterior / variance);
        // The square of the whole trend: then the frames at both ends are off by half a standard deviation at most.
        let increase = WidthEvidence::new(vec![(score, information)], 0.0).likely_increase();
        let share = mount_drift_rad(self.input.setup).powi(2) / variance;
        let stated = WidthEvidence::new(
            vec![(score * share, information * share)],
            (1.0 / share - 1.0) / square,
        );
        Some((increase, stated.probability(1.0)))
    }

    /// Takes shifts of the image from frame to frame for the cause of a large drift if no rotation explains the frames as
    /// well: a rotation moves the edges of an image by more than its middle, stabilisation does not. Then outliers are found
    /// again.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn explain_by_image_shifts(
        &mut self,
        solved: SolvedFlight,
        removed: &mut Vec<RemovedObservation>,
    ) -> AdjustResult<SolvedFlight> {
        let configured = mount_drift_rad(self.input.setup);
        let is_known = self.input.setup.uncertainty[Width::Stabilisation] > 0.0;
        if is_known
            || self.hyperparameters.drift_rad
                < SUSPECT_DRIFT_RATIO * configured.max(STEADY_ROTATION_RAD)
        {
            return Ok(solved);
        }
        let mut shifted = self.clone();
        shifted.prior_scales.stabilised_px = STABILISED_PX;
        (
            shifted.hyperparameters.drift_rad,
            shifted.hyperparameters.pitch_drift_increase,
        ) = (configured, 0.0);
        shifted.hyperparameters.sags = false;
        (shifted.usage, shifted.tested_sum) = (
            FlightUsage::all_used(self.frames.len(), self.input.setup.markers.len()),
            None,
        );
        let Ok(again) = shifted.solve_rough(None) else {
            return Ok(solved);
        };
        let omega = solved.tested_sum.map_or(solved.fit.omega, |sum| sum.omega);
        let gain = chi_square_limit(2.0 * self.frames.len() as f64, REMOUNT_ALPHA);
        if again.fit.omega + gain > omega {
            return Ok(solved);
        }
        *self = shifted;
        let (clean, outliers) = self.remove_outliers(again)?;
        *removed = outliers;
        self.tune_variances(clean, SHIFT_ROUNDS)
    }

    /// Determines the mountings: a remount is a step in rotation that is statistically significant **and** larger than the
    /// other steps between frames. If all steps are similar, large or small, the frames belong to one mounting that rotates
    /// by that much; taking two nearly equal rotations for one costs more than it gains. Specified mountings take
    /// precedence.
    pub fn find_mountings(&mut self, solved: &SolvedFlight) {
        let frames = self.frames.len();
        self.hyperparameters.mountings = self.hyperparameters.mountings.with_numbers(|| {
            let steps: Vec<f64> = (1..frames)
                .map(|f| solved.rotation_distance(f - 1, f))
                .collect();
            let typical =
                (median(steps.clone()).unwrap_or(0.0) / chi_square_limit(3.0, 0.5)).max(1.0);
            let limit = typical * chi_square_limit(3.0, REMOUNT_ALPHA / frames as f64);
            let mut numbers = vec![0; frames];
            for frame in 1..frames {
                numbers[frame] = numbers[frame - 1] + usize::from(steps[frame - 1] > limit);
            }
            numbers
        });
        self.hyperparameters.drift_rad = self
            .hyperparameters
            .drift_rad
            .max(self.hyperparameters.rotations_rms_rad());
    }
}
