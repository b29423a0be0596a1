//! State of the live adjustment, and its update by the next frame.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::attempt::{DISTURBANCE_ALPHA, FrameAttempt};
use super::departure::ShapeDeparture;
use super::process_model::{add_process_noise, apply_forgetting, reset_parameters};
use crate::adjust::AdjustResult;
use crate::adjust::flight::frames::Flight;
use crate::adjust::flight::knowledge::{EarlierFrames, LiveModel};
use crate::adjust::flight::load_twist::LoadTwist;
use crate::adjust::shapes::burning_covariance;
use crate::adjust::terms;
use crate::estimation::quality::chi_square_limit;
use crate::estimation::{AttributedInformation, InformationPrior};

/// Time constant of the mounting's drift, s. `mount_drift_rad` is the drift between two shots of a series, which are
/// minutes apart: the mounting drifts by this amount in this time, and each frame deviates from its random walk by the same
/// amount.
const DRIFT_TIME_S: f64 = 60.0;
/// Shortest time in which a flight burns its fuel, s: the shape ratios drift in this time by the effect of burning all of
/// it.
const FUEL_BURN_TIME_S: f64 = 3600.0;
/// Time constant with which the information of earlier frames decays, s. Model errors that repeat from gust to gust do not
/// average out with the number of frames; without forgetting, the state would be overconfident after some minutes.
const FORGETTING_TIME_S: f64 = 30.0;
/// Largest change of the variance factor from one frame to the next. A single frame is an exception, several frames are a
/// trend.
const MAX_FACTOR_STEP: f64 = 1.25;

/// Information of the frames so far.
#[derive(Clone, Debug)]
pub struct LiveState {
    /// Estimate of all parameters that the frames share.
    pub known: InformationPrior,
    /// Estimate from the first frame with survey and ground frame only, which does not decay.
    pub base: InformationPrior,
    /// Information in the state that keeps its source names in the uncertainty budget.
    pub attributed: Arc<AttributedInformation>,
    /// Model of all frames.
    pub model: LiveModel,
    /// Local unknowns of the last frame, from which the next one starts.
    pub local: DVector<f64>,
    /// Twist in proportion to the bending.
    pub twist: LoadTwist,
    /// Departures from the shared shape.
    pub departure: ShapeDeparture,
    /// Number of frames in the current mounting.
    pub frames: usize,
    /// Number of frames that updated the state.
    pub accepted_frames: usize,
    /// Number of frames rejected since the last accepted one.
    pub rejected_frames: usize,
    /// Time since the last accepted frame, s.
    pub rejected_s: f64,
    /// Variance factor of the recent frames, at least 1.
    pub factor: f64,
}

/// A frame solved with the state.
pub struct LiveStep {
    /// Solution under the hypothesis that explains the frame better.
    pub attempt: FrameAttempt,
    /// True if that hypothesis is a new mounting.
    pub mount_disturbed: bool,
    /// Estimate that does not decay, after the elapsed time.
    base: InformationPrior,
}

impl LiveState {
    /// Solves the next frame with the state, and after a mount disturbance if that explains it better.
    ///
    /// # Errors
    /// Returns an error if the frame has no solution under either hypothesis.
    pub fn step(&self, flight: &Flight, elapsed_s: f64) -> AdjustResult<LiveStep> {
        let mut base = self.base.clone();
        let predicted = self.predict_prior(flight, &mut base, elapsed_s)?;
        let carried = self.attempt_frame(flight, &predicted);
        let is_suspect = carried.as_ref().map_or(true, |a| !a.passed);
        let remounted = is_suspect
            .then(|| self.try_new_mounting(flight, &predicted))
            .and_then(Result::ok);
        let (attempt, mount_disturbed) = match (carried, remounted) {
            (Ok(carried), Some(remounted)) => {
                let gain =
                    chi_square_limit(self.model.layout.mounting.count as f64, DISTURBANCE_ALPHA);
                let mount_disturbed =
                    remounted.penalized_misfit() + gain < carried.penalized_misfit();
                (
                    if mount_disturbed { remounted } else { carried },
                    mount_disturbed,
                )
            }
            (Ok(carried), None) => (carried, false),
            (Err(_), Some(remounted)) => (remounted, true),
            (Err(error), None) => return Err(error),
        };
        if mount_disturbed {
            self.reset_mounting(flight, &mut base)?;
        }
        Ok(LiveStep {
            attempt,
            mount_disturbed,
            base,
        })
    }

    /// Adjusts the next frame with the prior `known`, from this state's parameters.
    fn attempt_frame(
        &self,
        flight: &Flight,
        known: &InformationPrior,
    ) -> AdjustResult<FrameAttempt> {
        let earlier = EarlierFrames {
            model: &self.model,
            layout: self
                .model
                .layout
                .with_row_times(&flight.input, &flight.frames[0]),
            local: &self.local,
            twist: &self.twist,
            known,
        };
        FrameAttempt::new(flight, &earlier)
    }

    /// Variance factor after a frame; `None`: the frame could not be solved.
    pub fn next_factor(&self, variance_factor: Option<f64>) -> f64 {
        let (least, most) = (self.factor / MAX_FACTOR_STEP, self.factor * MAX_FACTOR_STEP);
        variance_factor.unwrap_or(most).clamp(least, most).max(1.0)
    }

    /// Returns the state updated by a frame. If the residuals are not consistent with the standard deviations, the frame's
    /// information is divided by its variance factor.
    ///
    /// # Errors
    /// Returns an error if the information matrix is not positive definite.
    pub fn updated(&self, step: &LiveStep, flight: &Flight, elapsed_s: f64) -> AdjustResult<Self> {
        let LiveStep {
            attempt,
            mount_disturbed,
            base,
        } = step;
        let fit = &attempt.solved.fit;
        let frames = if *mount_disturbed { 1 } else { self.frames + 1 };
        let mut next = LiveState {
            known: fit.information_prior(),
            base: base.clone(),
            local: fit.groups[0].local.clone(),
            twist: self
                .twist
                .clone()
                .with_frame(&attempt.solved.flight_problem.layouts[0], fit),
            frames,
            accepted_frames: self.accepted_frames.saturating_add(1),
            rejected_frames: 0,
            rejected_s: 0.0,
            factor: self.next_factor(fit.variance_factor()),
            ..self.clone()
        };
        let factor = fit.variance_factor().unwrap_or(1.0).max(1.0);
        let share = if attempt.is_explained(1.0) {
            1.0
        } else {
            1.0 / factor
        };
        let before = attempt.solved.flight_problem.problem.known.as_ref();
        if let Some(before) = before.filter(|_| share < 1.0) {
            apply_forgetting(&mut next.known, before, share)?;
        }
        next.departure
            .update(&attempt.solved, &flight.hyperparameters, elapsed_s, share);
        Ok(next)
    }

    /// Predicts the prior for the next frame: adds process noise to rotation and ratios, also in `base`, and lets the
    /// remaining information decay.
    fn predict_prior(
        &self,
        flight: &Flight,
        base: &mut InformationPrior,
        elapsed_s: f64,
    ) -> AdjustResult<InformationPrior> {
        let terms = self.model.layout.curvature_terms;
        let shape = self.model.shape.as_ref();
        let ratios = shape.map_or(0..0, |shape| shape.columns.ratio_columns());
        let n = ratios.len();
        let drift = flight
            .hyperparameters
            .drift_covariance(&flight.input.scene.camera_from_wing);
        let mut noise = DMatrix::zeros(3 + n, 3 + n);
        noise
            .view_mut((0, 0), (3, 3))
            .copy_from(&(drift * (elapsed_s / DRIFT_TIME_S)));
        noise
            .view_mut((3, 3), (n, n))
            .copy_from(&(burning_covariance(terms) * (elapsed_s / FUEL_BURN_TIME_S)));
        let mounting = self.model.layout.mounting.first;
        let columns: Vec<_> = (mounting..mounting + 3).chain(ratios).collect();
        let mut known = self.known.clone();
        add_process_noise(&mut known, &columns, noise.clone())?;
        add_process_noise(base, &columns, noise)?;
        apply_forgetting(&mut known, base, (-elapsed_s / FORGETTING_TIME_S).exp())?;
        Ok(known)
    }

    /// Solves the frame with a new mounting.
    fn try_new_mounting(
        &self,
        flight: &Flight,
        predicted: &InformationPrior,
    ) -> AdjustResult<FrameAttempt> {
        let mut known = predicted.clone();
        self.reset_mounting(flight, &mut known)?;
        self.attempt_frame(flight, &known)
    }

    /// Resets the mounting to its priors.
    fn reset_mounting(&self, flight: &Flight, known: &mut InformationPrior) -> AdjustResult<()> {
        let own = self.model.layout.mounting;
        let input = &flight.input;
        let mut terms = vec![terms::mounting_rotation(input, false)];
        terms.extend(terms::mounting_terms(input, false));
        let mut covariance = DMatrix::zeros(own.count, own.count);
        let mut first = 0;
        for prior in terms.iter().flat_map(|term| &term.priors) {
            let size = prior.covariance.shape();
            covariance
                .view_mut((first, first), size)
                .copy_from(&prior.covariance);
            first += size.0;
        }
        reset_parameters(known, own.first, &DVector::zeros(own.count), covariance)
    }
}
