//! What the frames so far told, and what a next one makes of it.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::attempt::{Attempt, DISTURBANCE_ALPHA, Model};
use super::departure::Departure;
use super::process_model::{add_process_noise, apply_forgetting, reset_parameters};
use crate::adjust::AdjustError;
use crate::adjust::flight::frames::Flight;
use crate::adjust::shapes::burning_covariance;
use crate::adjust::terms::rotation_of_mounting;
use crate::estimation::quality::chi_square_limit;
use crate::estimation::{AttributedInformation, InformationPrior};

/// `mount_drift_rad` is stated between two shots of a series, which are minutes apart: the mounting walks by it in this
/// time, s, and leaves its walk by it in any frame.
const WALK_S: f64 = 60.0;
/// No flight burns its fuel faster, s: in this time the shape's ratios walk by what burning all of it does.
const BURN_S: f64 = 3600.0;
/// What a frame told fades in this time, s. Errors of the model that repeat from gust to gust do not average out as
/// often as there are frames: a state that remembers all is too sure after some minutes.
const MEMORY_S: f64 = 30.0;
/// From one frame to the next the factor by which standard deviations are stated too small is taken to change by no more: one
/// frame is an exception, many are the rule.
const FACTOR_STEP: f64 = 1.25;

/// What the frames so far told.
#[derive(Clone, Debug)]
pub struct State {
    /// Of all that frames share.
    pub known: InformationPrior,
    /// The same with the first frame alone, with survey and ground frame: what does not fade.
    pub base: InformationPrior,
    /// What of it keeps its name in a budget of variance.
    pub told: Arc<AttributedInformation>,
    /// What all frames are set up with.
    pub model: Model,
    /// Own unknowns of the last frame: where the next one begins.
    pub local: DVector<f64>,
    /// From the shared shape.
    pub departure: Departure,
    /// Frames of this mounting.
    pub frames: usize,
    /// Frames that it rests on.
    pub accepted_frames: usize,
    /// Frames that contradicted it since the last that it rests on, and the time that went by with them, s.
    pub rejected_frames: usize,
    /// See there.
    pub rejected_s: f64,
    /// Variance factor that frames have shown of late, not below 1.
    pub factor: f64,
}

/// A frame solved with what is known.
pub struct Step {
    /// Under the hypothesis that explains it better.
    pub attempt: Attempt,
    /// Whether that is a mounting of its own.
    pub mount_disturbed: bool,
    /// What does not fade, after the time that went by.
    base: InformationPrior,
}

impl State {
    /// The next frame, as it is carried by the state, or after a mount disturbance where that explains it better.
    pub fn step(&self, flight: &Flight, elapsed_s: f64) -> Result<Step, AdjustError> {
        let mut base = self.base.clone();
        let walked = self.walked(flight, &mut base, elapsed_s)?;
        let carried = self.attempt(flight, &walked);
        let doubtful = carried.as_ref().map_or(true, |a| !a.passed);
        let restarted = doubtful.then(|| self.try_new_mounting(flight, &walked)).and_then(Result::ok);
        let (attempt, mount_disturbed) = match (carried, restarted) {
            (Ok(carried), Some(restarted)) => {
                let gain = chi_square_limit(self.model.layout.own.count as f64, DISTURBANCE_ALPHA);
                let mount_disturbed = restarted.cost() + gain < carried.cost();
                (if mount_disturbed { restarted } else { carried }, mount_disturbed)
            }
            (Ok(carried), None) => (carried, false),
            (Err(_), Some(restarted)) => (restarted, true),
            (Err(error), None) => return Err(error),
        };
        if mount_disturbed {
            self.remounted(flight, &mut base)?;
        }
        Ok(Step { attempt, mount_disturbed, base })
    }

    fn attempt(&self, flight: &Flight, known: &InformationPrior) -> Result<Attempt, AdjustError> {
        Attempt::new(&self.model, &self.local, flight, known)
    }

    /// After a frame with this variance factor; `None`: it could not be solved.
    pub fn next_factor(&self, shown: Option<f64>) -> f64 {
        let (least, most) = (self.factor / FACTOR_STEP, self.factor * FACTOR_STEP);
        shown.unwrap_or(most).clamp(least, most).max(1.0)
    }

    /// The state with a frame. One that chance does not explain teaches as much less as its variance factor says.
    pub fn learn(&self, step: &Step, flight: &Flight, elapsed_s: f64) -> Result<Self, AdjustError> {
        let Step { attempt, mount_disturbed, base } = step;
        let fit = &attempt.solved.fit;
        let frames = if *mount_disturbed { 1 } else { self.frames + 1 };
        let mut next = State {
            known: fit.information_prior(),
            base: base.clone(),
            local: fit.groups[0].local.clone(),
            frames,
            accepted_frames: self.accepted_frames.saturating_add(1),
            rejected_frames: 0,
            rejected_s: 0.0,
            factor: self.next_factor(fit.variance_factor()),
            ..self.clone()
        };
        let factor = fit.variance_factor().unwrap_or(1.0).max(1.0);
        let share = if attempt.is_explained(1.0) { 1.0 } else { 1.0 / factor };
        let before = attempt.solved.setting.problem.known.as_ref();
        if let Some(before) = before.filter(|_| share < 1.0) {
            apply_forgetting(&mut next.known, before, share)?;
        }
        next.departure.learn(&attempt.solved, &flight.assumed, elapsed_s, share);
        Ok(next)
    }

    /// What is known when the next frame comes: rotation and ratios have walked, of the base too, and all beside that
    /// has faded.
    fn walked(
        &self,
        flight: &Flight,
        base: &mut InformationPrior,
        elapsed_s: f64,
    ) -> Result<InformationPrior, AdjustError> {
        let terms = self.model.layout.curvature_terms;
        let n = terms.saturating_sub(1);
        let drift = flight.assumed.drift_covariance(&flight.input.scene.camera_from_wing);
        let mut noise = DMatrix::zeros(3 + n, 3 + n);
        noise.view_mut((0, 0), (3, 3)).copy_from(&(drift * (elapsed_s / WALK_S)));
        noise.view_mut((3, 3), (n, n)).copy_from(&(burning_covariance(terms) * (elapsed_s / BURN_S)));
        let (mounting, ratios) = (self.model.layout.own.first, self.model.shape.columns.ratios);
        let columns: Vec<_> = (mounting..mounting + 3).chain(ratios..ratios + n).collect();
        let mut known = self.known.clone();
        add_process_noise(&mut known, &columns, noise.clone())?;
        add_process_noise(base, &columns, noise)?;
        apply_forgetting(&mut known, base, (-elapsed_s / MEMORY_S).exp())?;
        Ok(known)
    }

    /// The frame in a mounting of its own.
    fn try_new_mounting(&self, flight: &Flight, walked: &InformationPrior) -> Result<Attempt, AdjustError> {
        let mut known = walked.clone();
        self.remounted(flight, &mut known)?;
        self.attempt(flight, &known)
    }

    /// Of rotation and shift only the mount's repeatability is left.
    fn remounted(&self, flight: &Flight, known: &mut InformationPrior) -> Result<(), AdjustError> {
        let own = self.model.layout.own;
        let rotation = rotation_of_mounting(&flight.input);
        let shift = flight.input.setup.uncertainty.mount_shift_m;
        let mut covariance = DMatrix::identity(own.count, own.count) * (shift * shift);
        covariance.view_mut((0, 0), (3, 3)).copy_from(&rotation.covariance);
        let mut mean = DVector::zeros(own.count);
        mean.rows_mut(0, 3).copy_from(&rotation.mean);
        reset_parameters(known, own.first, &mean, covariance)
    }
}
