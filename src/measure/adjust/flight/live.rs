//! Frames adjusted one by one, ten a second, each with all that those before it told (docs/live.md).
//!
//! The state is what a flight's frames share, with its full information matrix: errors that are common to all frames
//! are counted once, however many frames there are. A frame is one group beside it, whose own unknowns leave with it.
//! Between two frames the mounting's rotation and the shape's ratios walk. A frame that the state cannot explain is
//! tried with a mounting of its own: a jolt. One that this does not explain either teaches nothing, and a state that is
//! contradicted again and again is given up.

mod departure;
mod first;
mod known;
mod words;

use nalgebra::{DMatrix, DVector};

use self::departure::Departure;
use self::first::first;
use self::known::{fade, forget, walk};
use self::words::{contradiction, remarks};
use super::setting::{Progress, Setting};
use super::{FEWEST, Flight, SMALLEST_CURVATURE_PER_M, chi_square_limit, dress_frame};
use crate::measure::adjust::gauss_helmert::{Course, Fit, Known, Problem};
use crate::measure::adjust::layout::Layout;
use crate::measure::adjust::scene::Scene;
use crate::measure::adjust::shapes::{self, RATIOS};
use crate::measure::adjust::snooping::{self, Suspect};
use crate::measure::adjust::{AdjustError, GlobalTest, Observation, Options, Solution, quality, unknowns};
use crate::measure::setup::{Orientation, Setup};

/// `mount_drift_rad` is stated between two shots of a series, which are minutes apart: the mounting walks by it in this
/// time, s, and leaves its walk by it in any frame.
const WALK_S: f64 = 60.0;
/// No flight burns its fuel faster, s: in this time the shape's ratios walk by what burning all of it does.
const BURN_S: f64 = 3600.0;
/// What a frame told fades in this time, s. Errors of the model that repeat from gust to gust do not average out as
/// often as there are frames: a state that remembers all is too sure after some minutes.
const MEMORY_S: f64 = 30.0;
/// A gust that bends the wing by this, 1/m, as much as the usual flight does, may change the shape as much as burning
/// fuel: lift and the weights' inertia answer it in their own times and places.
const LOAD_CURVATURE_PER_M: f64 = 5e-3;
/// Frames that follow at once are taken to be apart by this, s: a walk needs a width.
const LEAST_ELAPSED_S: f64 = 1e-3;
/// What a jolt must gain, and what a marker that is left out must: quantiles of their chi-squares at this level.
const JOLT_ALPHA: f64 = 1e-6;
/// From one frame to the next the factor by which standard deviations are stated too small is taken to change by no more: one
/// frame is an exception, many are the rule.
const FACTOR_STEP: f64 = 1.25;
/// Frames in a row that contradict the state before it is given up.
const DOUBTS: usize = 3;
/// No more markers than one in so many are left out of a frame.
const LEFT_OUT: usize = 3;

/// Frames of one camera, adjusted as they come.
#[derive(Clone, Debug)]
pub struct Live {
    setup: Setup,
    orientation: Orientation,
    options: Options,
    scene: Scene,
    state: Option<State>,
    /// Frames that no state began with.
    unsound: usize,
    mountings: usize,
}

/// What the frames so far told.
#[derive(Clone, Debug)]
struct State {
    known: Known,
    /// The same with the first frame alone, with survey and ground frame: what does not fade.
    base: Known,
    layout: Layout,
    missing: Vec<&'static str>,
    shape: Shape,
    /// Own unknowns of the last frame: where the next one begins.
    local: DVector<f64>,
    departure: Departure,
    /// Markers whose surveyed position is wrong.
    wrong: Vec<Suspect>,
    /// Frames of this mounting.
    frames: usize,
    /// Frames that it rests on.
    learnt: usize,
    /// Frames that contradicted it since the last that it rests on, and the time that went by with them, s.
    doubts: usize,
    doubted_s: f64,
    /// Variance factor that frames have shown of late, not below 1.
    factor: f64,
}

/// A frame solved with what is known.
struct Step {
    attempt: Attempt,
    jolt: bool,
    /// What does not fade, after the time that went by.
    base: Known,
}

/// Where the shared shape stands, and the amplitude that its shortening counts from: fixed at the first frame, so that
/// its unknowns keep their meaning.
#[derive(Clone, Copy, Debug)]
struct Shape {
    ratios: usize,
    changes: usize,
    lever: usize,
    shortening: [f64; RATIOS],
    middle: f64,
}

/// A frame solved under one hypothesis.
struct Attempt {
    setting: Setting,
    fit: Fit,
    removed: Vec<(usize, Suspect)>,
    /// Whether all markers together passed the global test.
    passed: bool,
}

impl Live {
    /// Begins without a frame. Of `options.mountings` the first counts, for the first frame; variance components are
    /// not estimated. Errors: an installation that cannot be prepared.
    pub fn begin(setup: Setup, orientation: Orientation, options: Options) -> Result<Self, AdjustError> {
        let scene = Scene::new(&setup, &orientation)?;
        let first = options.mountings.as_ref().map(|list| list.iter().take(1).copied().collect());
        let options = Options { mountings: first, variance_components: false, ..options };
        Ok(Self { setup, orientation, options, scene, state: None, unsound: 0, mountings: 0 })
    }

    /// The next frame, `elapsed_s` after the last one. On an error the state stays as it was; the time does not count.
    ///
    /// A frame that contradicts the state, jolted or not, is adjusted by itself. Nothing is learnt from it; after three of
    /// them in a row the state begins anew, since its first frame may have been a wrong one. A state of fewer frames begins
    /// anew after as many of them with a sound one, of which nothing is left out. With others it begins at the third only.
    pub fn frame(&mut self, observations: &[Observation], elapsed_s: f64) -> Result<Solution, AdjustError> {
        let frames = [observations.to_vec()];
        let (state, solution) = match &self.state {
            None => {
                let (state, solution, sound) = first(&mut self.flight(&frames)?)?;
                if !sound && self.unsound + 1 < DOUBTS {
                    self.unsound += 1;
                    return Ok(solution);
                }
                (state, solution)
            }
            Some(state) => self.next(state, &frames, elapsed_s.max(LEAST_ELAPSED_S))?,
        };
        self.mountings += usize::from(state.frames == 1 && state.doubts == 0);
        self.state = Some(state);
        Ok(solution)
    }

    fn flight<'a>(&'a self, frames: &'a [Vec<Observation>]) -> Result<Flight<'a>, AdjustError> {
        let mut flight = Flight::new(&self.setup, &self.orientation, &self.scene, frames, &self.options)?;
        flight.mountings = Some(vec![0]);
        Ok(flight)
    }

    fn next(
        &self,
        state: &State,
        frames: &[Vec<Observation>],
        elapsed_s: f64,
    ) -> Result<(State, Solution), AdjustError> {
        let mut flight = self.flight(frames)?;
        let elapsed_s = state.doubted_s + elapsed_s;
        let step = state.step(&mut flight, elapsed_s);
        let learn = |step: Step| {
            let next = state.learn(&step, &flight, elapsed_s)?;
            let remarks = remarks(next.frames, self.mountings + usize::from(step.jolt), step.jolt);
            let Attempt { setting, fit, removed, .. } = &step.attempt;
            let solution = dress_frame(&flight, setting, fit, removed, 0, remarks);
            Ok((next, solution))
        };
        let step = match step {
            Ok(step) if step.attempt.explained(state.factor) => return learn(step),
            doubtful => doubtful.ok(),
        };
        let factor = state.next_factor(step.and_then(|step| step.attempt.fit.variance_factor()));
        let doubts = state.doubts + 1;
        let (begun, mut alone, sound) = first(&mut self.flight(frames)?)?;
        let given_up = doubts >= DOUBTS || doubts >= state.learnt && sound;
        alone.remarks.insert(0, contradiction(given_up, self.mountings + 1));
        let next = match given_up {
            true => State { factor, ..begun },
            false => State { doubts, doubted_s: elapsed_s, factor, ..state.clone() },
        };
        Ok((next, alone))
    }

    /// How many mountings there were: the first, and one after each jolt.
    pub fn mountings(&self) -> usize {
        self.mountings
    }
}

impl State {
    /// The next frame, as it is carried by the state, or after a jolt where that explains it better.
    fn step(&self, flight: &mut Flight, elapsed_s: f64) -> Result<Step, AdjustError> {
        flight.departure = self.departure.value();
        flight.amplitudes = vec![self.local[0].abs().max(SMALLEST_CURVATURE_PER_M)];
        let mut base = self.base.clone();
        let walked = self.walked(flight, &mut base, elapsed_s)?;
        let carried = self.attempt(flight, &walked);
        let doubtful = carried.as_ref().map_or(true, |a| !a.passed);
        let restarted = doubtful.then(|| self.jolted(flight, &walked)).and_then(Result::ok);
        let (attempt, jolt) = match (carried, restarted) {
            (Ok(carried), Some(restarted)) => {
                let gain = chi_square_limit(self.layout.own.1 as f64, JOLT_ALPHA);
                let jolt = restarted.cost() + gain < carried.cost();
                (if jolt { restarted } else { carried }, jolt)
            }
            (Ok(carried), None) => (carried, false),
            (Err(_), Some(restarted)) => (restarted, true),
            (Err(error), None) => return Err(error),
        };
        if jolt {
            self.remounted(flight, &mut base)?;
        }
        Ok(Step { attempt, jolt, base })
    }

    /// After a frame with this variance factor; `None`: it could not be solved.
    fn next_factor(&self, shown: Option<f64>) -> f64 {
        let (least, most) = (self.factor / FACTOR_STEP, self.factor * FACTOR_STEP);
        shown.unwrap_or(most).clamp(least, most).max(1.0)
    }

    /// The state with a frame. One that chance does not explain teaches as much less as its variance factor says.
    fn learn(&self, step: &Step, flight: &Flight, elapsed_s: f64) -> Result<Self, AdjustError> {
        let Step { attempt, jolt, base } = step;
        let frames = if *jolt { 1 } else { self.frames + 1 };
        let mut next = State {
            known: known_of(&attempt.fit),
            base: base.clone(),
            local: attempt.fit.groups[0].local.clone(),
            frames,
            learnt: self.learnt.saturating_add(1),
            doubts: 0,
            doubted_s: 0.0,
            factor: self.next_factor(attempt.fit.variance_factor()),
            ..self.clone()
        };
        let factor = attempt.fit.variance_factor().unwrap_or(1.0).max(1.0);
        let share = if attempt.explained(1.0) { 1.0 } else { 1.0 / factor };
        if let Some(before) = attempt.setting.problem.known.as_ref().filter(|_| share < 1.0) {
            fade(&mut next.known, before, share)?;
        }
        next.departure.learn(attempt, flight.departure, elapsed_s, share);
        Ok(next)
    }

    /// What is known when the next frame comes: rotation and ratios have walked, of the base too, and all beside that
    /// has faded.
    fn walked(&self, flight: &Flight, base: &mut Known, elapsed_s: f64) -> Result<Known, AdjustError> {
        let terms = self.layout.curvature_terms;
        let n = terms.saturating_sub(1);
        let mount = flight.drift_covariance() * (elapsed_s / WALK_S);
        let shape = DMatrix::from_fn(n, n, |i, j| shapes::burning()[(i, j)]) * (elapsed_s / BURN_S);
        let mut noise = DMatrix::zeros(3 + n, 3 + n);
        noise.view_mut((0, 0), (3, 3)).copy_from(&mount);
        noise.view_mut((3, 3), (n, n)).copy_from(&shape);
        let columns: Vec<_> = (self.layout.own.0..self.layout.own.0 + 3)
            .chain(self.shape.ratios..self.shape.ratios + n)
            .collect();
        let mut known = self.known.clone();
        walk(&mut known, &columns, noise.clone())?;
        walk(base, &columns, noise)?;
        fade(&mut known, base, (-elapsed_s / MEMORY_S).exp())?;
        Ok(known)
    }

    /// The frame in a mounting of its own.
    fn jolted(&self, flight: &mut Flight, walked: &Known) -> Result<Attempt, AdjustError> {
        let mut known = walked.clone();
        self.remounted(flight, &mut known)?;
        self.attempt(flight, &known)
    }

    /// Of rotation and shift only the mount's repeatability is left.
    fn remounted(&self, flight: &Flight, known: &mut Known) -> Result<(), AdjustError> {
        let (first, count) = self.layout.own;
        let rotation = unknowns::mount_prior(&flight.input, first);
        let shift = flight.input.setup.uncertainty.mount_shift_m;
        let mut covariance = DMatrix::identity(count, count) * (shift * shift);
        covariance.view_mut((0, 0), (3, 3)).copy_from(&rotation.covariance);
        let mut mean = DVector::zeros(count);
        mean.rows_mut(0, 3).copy_from(&rotation.mean);
        forget(known, first, &mean, covariance)
    }

    /// Solves the frame, its worst marker left out as long as there is one beyond the limit; one that fits later comes
    /// back.
    fn attempt(&self, flight: &mut Flight, known: &Known) -> Result<Attempt, AdjustError> {
        let options = flight.input.options;
        let everywhere: Vec<_> = self.wrong.iter().map(|s| (0, *s)).collect();
        flight.use_all_but(&everywhere);
        let (mut setting, mut fit) = self.solve(flight, known, None, true)?;
        let passed =
            quality::global_test(fit.omega, fit.redundancy, options.global_alpha) != GlobalTest::Rejected;
        let mut out = vec![];
        let allowed = setting.members[0].len() / LEFT_OUT;
        while out.len() < allowed && setting.members[0].len() > FEWEST + 1 {
            let Some(suspect) = snooping::worst(&setting.problem, &fit, 0, &setting.members[0], options)
            else {
                break;
            };
            flight.remove(0, &suspect);
            out.push(suspect);
            (setting, fit) = self.solve(flight, known, Some(&fit), true)?;
        }
        if out.len() > 1 {
            for suspect in std::mem::take(&mut out) {
                flight.used[0][suspect.marker] = true;
                let with = self.solve(flight, known, Some(&fit), true)?;
                if snooping::worst(&with.0.problem, &with.1, 0, &with.0.members[0], options).is_none() {
                    fit = with.1;
                } else {
                    flight.used[0][suspect.marker] = false;
                    out.push(suspect);
                }
            }
        }
        let (setting, fit) = self.solve(flight, known, Some(&fit), false)?;
        let removed = everywhere.into_iter().chain(out.into_iter().map(|s| (0, s))).collect();
        Ok(Attempt { setting, fit, removed, passed })
    }

    /// The frame with the markers that are in use.
    fn solve(
        &self,
        flight: &Flight,
        known: &Known,
        before: Option<&Fit>,
        rough: bool,
    ) -> Result<(Setting, Fit), AdjustError> {
        let (mut group, members) = flight.frame_group(0, &self.layout, None);
        let mut start = known.mean.clone();
        group.local.copy_from(&self.local);
        if let Some(before) = before {
            group.local.copy_from(&before.groups[0].local);
            start.copy_from(&before.global);
        }
        let setting = Setting {
            layouts: vec![self.layout],
            members: vec![members],
            ground_members: vec![],
            problem: Problem {
                start,
                missing: self.missing.clone(),
                priors: vec![],
                known: Some(known.clone()),
                groups: vec![group],
            },
            ratios: self.shape.ratios,
            changes: self.shape.changes,
            lever: self.shape.lever,
            shortening: self.shape.shortening,
            middle: self.shape.middle,
            progress: Progress::OfAmplitude(LOAD_CURVATURE_PER_M),
        };
        let fit = setting.solve(flight.input.scene, &Course { rough, residuals: before })?;
        Ok((setting, fit))
    }
}

impl Attempt {
    /// Whether chance explains what is left, where standard deviations are stated too small by the root of a factor.
    fn explained(&self, factor: f64) -> bool {
        quality::global_test(self.fit.omega / factor, self.fit.redundancy, JOLT_ALPHA) != GlobalTest::Rejected
    }

    /// Sum of squares, and for each marker left out what a marker must gain to be left out.
    fn cost(&self) -> f64 {
        self.fit.omega + self.removed.len() as f64 * chi_square_limit(2.0, JOLT_ALPHA)
    }
}

/// What a solution tells of all that frames share.
fn known_of(fit: &Fit) -> Known {
    Known { mean: fit.global.clone(), information: fit.information.clone() }
}
