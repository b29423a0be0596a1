//! Frames adjusted one by one, ten a second, each with all that those before it told (docs/live/method.md).
//!
//! The state is what a flight's frames share, with its full information matrix: errors that are common to all frames
//! are counted once, however many frames there are. A frame is one group beside it, whose own unknowns leave with it.
//! Between two frames the mounting's rotation and the shape's ratios walk. A frame that the state cannot explain is
//! tried with a mounting of its own: a mount disturbance. One that this does not explain either teaches nothing, and a state that is
//! contradicted again and again is given up.

mod attempt;
mod departure;
mod first;
mod process_model;
mod remarks;
mod state;

use self::attempt::Attempt;
use self::departure::Departure;
use self::first::{InitialState, first};
use self::remarks::{contradiction, remarks};
use self::state::{State, Step};
use super::frame_solution::{frame_solution, with_sources};
use super::frames::Flight;
use super::hyperparameters::FlightHyperparameters;
use super::mountings::Mountings;
use crate::adjust::input::Input;
use crate::adjust::scene::Scene;
use crate::adjust::{AdjustError, Observation, Options, Solution};
use crate::setup::{Orientation, Setup};

/// Frames that follow at once are taken to be apart by this, s: a walk needs a width.
const MIN_ELAPSED_S: f64 = 1e-3;
/// Frames in a row that contradict the state before it is given up.
const DOUBTS: usize = 3;

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
    /// A frame that contradicts the state, disturbed or not, is adjusted by itself. Nothing is learnt from it; after three of
    /// them in a row the state begins anew, since its first frame may have been a wrong one. A state of fewer frames begins
    /// anew after as many of them with a sound one, of which nothing is left out. With others it begins at the third only.
    pub fn frame(&mut self, observations: &[Observation], elapsed_s: f64) -> Result<Solution, AdjustError> {
        let frames = [observations.to_vec()];
        let (state, solution) = match &self.state {
            None => {
                let InitialState { state, solution, sound } = first(&self.flight(&frames, None)?)?;
                if !sound && self.unsound + 1 < DOUBTS {
                    self.unsound += 1;
                    return Ok(solution);
                }
                (state, solution)
            }
            Some(state) => self.next(state, &frames, elapsed_s.max(MIN_ELAPSED_S))?,
        };
        self.mountings += usize::from(state.frames == 1 && state.rejected_frames == 0);
        self.state = Some(state);
        Ok(solution)
    }

    /// A flight of one frame, after others or by itself.
    fn flight<'a>(
        &'a self,
        frames: &'a [Vec<Observation>],
        after: Option<&State>,
    ) -> Result<Flight<'a>, AdjustError> {
        let Self { setup, orientation, scene, options, .. } = self;
        let input = Input { setup, orientation, scene, options };
        let mountings = Mountings::of_one(options.mountings.as_deref());
        let assumed = FlightHyperparameters::at_first(&input, frames.len(), mountings);
        let assumed = match after {
            Some(state) => state.departure.taken(assumed.bent(state.local[0])),
            None => Departure::assumed().taken(assumed),
        };
        Flight::new(input, frames, assumed)
    }

    fn next(
        &self,
        state: &State,
        frames: &[Vec<Observation>],
        elapsed_s: f64,
    ) -> Result<(State, Solution), AdjustError> {
        let flight = self.flight(frames, Some(state))?;
        let elapsed_s = state.rejected_s + elapsed_s;
        let step = state.step(&flight, elapsed_s);
        let step = match step {
            Ok(step) if step.attempt.is_explained(state.factor) => {
                let next = state.learn(&step, &flight, elapsed_s)?;
                let Step { attempt: Attempt { solved, removed, .. }, mount_disturbed, .. } = &step;
                let remarks =
                    remarks(next.frames, self.mountings + usize::from(*mount_disturbed), *mount_disturbed);
                let solution = with_sources(solved, Some(&state.told), |sources| {
                    frame_solution(&flight, solved, removed, 0, remarks, sources)
                });
                return Ok((next, solution));
            }
            doubtful => doubtful.ok(),
        };
        let factor = state.next_factor(step.and_then(|step| step.attempt.solved.fit.variance_factor()));
        let doubts = state.rejected_frames + 1;
        let InitialState { state: begun, solution: mut alone, sound } = first(&self.flight(frames, None)?)?;
        let given_up = doubts >= DOUBTS || doubts >= state.accepted_frames && sound;
        alone.remarks.insert(0, contradiction(given_up, self.mountings + 1));
        let next = match given_up {
            true => State { factor, ..begun },
            false => State { rejected_frames: doubts, rejected_s: elapsed_s, factor, ..state.clone() },
        };
        Ok((next, alone))
    }

    /// How many mountings there were: the first, and one after each mount_disturbed.
    pub fn mountings(&self) -> usize {
        self.mountings
    }
}
