//! Live mode: adjusts frames one by one, about ten per second, each with the information of the frames before it
//! (docs/live/method.md).
//!
//! The state consists of the parameters that the frames of a flight share, with their full information matrix, so that
//! common errors count once for any number of frames. A frame is one group in addition to the state; its own unknowns are
//! eliminated with it. Between frames, the mounting's rotation and the shape ratios follow a random walk. If the state does
//! not explain a frame, the frame is tried with a mounting of its own (mount disturbance). If that does not explain it
//! either, the frame does not update the state. A state that is contradicted repeatedly is discarded.

mod attempt;
mod departure;
mod initial_state;
mod process_model;
mod remarks;
mod state;

use self::attempt::FrameAttempt;
use self::departure::ShapeDeparture;
use self::initial_state::{InitialState, start_state};
use self::remarks::{accepted_remarks, rejection_remark};
use self::state::{LiveState, LiveStep};
use super::frame_solution::{frame_solution, with_flight_sources};
use super::frames::Flight;
use super::hyperparameters::FlightHyperparameters;
use super::knowledge::Knowledge;
use super::mountings::FrameMountings;
use crate::adjust::input::AdjustmentInput;
use crate::adjust::scene::WingScene;
use crate::adjust::shapes::bounded_amplitude;
use crate::adjust::{AdjustResult, Observation, Options, Solution};
use crate::setup::{Orientation, Setup};

/// Minimum time between frames, s; process noise must not be 0.
const MIN_ELAPSED_S: f64 = 1e-3;
/// Number of consecutive rejected frames after which the state is discarded.
const MAX_REJECTED_FRAMES: usize = 3;

/// Live adjustment of the frames of one camera.
#[derive(Clone, Debug)]
pub struct LiveAdjustment {
    setup: Setup,
    orientation: Orientation,
    options: Options,
    scene: WingScene,
    state: Option<LiveState>,
    /// Number of first frames from which no state was started.
    unsound_starts: usize,
    mounting_count: usize,
}

impl LiveAdjustment {
    /// Creates an adjustment without frames. The first of `options.mountings` applies to the first frame; variance
    /// components are not estimated.
    ///
    /// # Errors
    /// Returns an error if the installation cannot be prepared.
    pub fn new(setup: Setup, orientation: Orientation, options: Options) -> AdjustResult<Self> {
        let scene = WingScene::new(&setup, &orientation)?;
        let first = options
            .mountings
            .as_ref()
            .map(|list| list.iter().take(1).copied().collect());
        let options = Options {
            mountings: first,
            variance_components: false,
            ..options
        };
        Ok(Self {
            setup,
            orientation,
            options,
            scene,
            state: None,
            unsound_starts: 0,
            mounting_count: 0,
        })
    }

    /// Adjusts the next frame, `elapsed_s` after the last one. On an error the state is unchanged, and the time does not
    /// count.
    ///
    /// A frame that contradicts the state, with or without a mount disturbance, is adjusted on its own and does not update
    /// the state. After three of them in a row the state is started again, because its first frame may have been wrong. A
    /// state of fewer frames is started again after an equal number of contradicting frames if the last one is sound
    /// (nothing removed from it); otherwise at the third.
    ///
    /// # Errors
    /// Returns an error if the frame cannot be adjusted.
    pub fn adjust_frame(
        &mut self,
        observations: &[Observation],
        elapsed_s: f64,
    ) -> AdjustResult<Solution> {
        let frames = [observations.to_vec()];
        let (state, solution) = match &self.state {
            None => {
                let InitialState {
                    state,
                    solution,
                    is_sound,
                } = start_state(&self.single_frame_flight(&frames, None)?)?;
                if !is_sound && self.unsound_starts + 1 < MAX_REJECTED_FRAMES {
                    self.unsound_starts += 1;
                    return Ok(solution);
                }
                (state, solution)
            }
            Some(state) => {
                self.adjust_frame_with_state(state, &frames, elapsed_s.max(MIN_ELAPSED_S))?
            }
        };
        self.mounting_count += usize::from(state.frames == 1 && state.rejected_frames == 0);
        self.state = Some(state);
        Ok(solution)
    }

    /// Prepares a flight of one frame, after other frames or alone.
    fn single_frame_flight<'a>(
        &'a self,
        frames: &'a [Vec<Observation>],
        after: Option<&LiveState>,
    ) -> AdjustResult<Flight<'a>> {
        let Self {
            setup,
            orientation,
            scene,
            options,
            ..
        } = self;
        let input = AdjustmentInput {
            setup,
            orientation,
            scene,
            options,
        };
        let mountings = FrameMountings::for_single_frame(options.mountings.as_deref());
        let mut hyperparameters = FlightHyperparameters::initial(&input, frames.len(), mountings);
        if let Some(state) = after {
            hyperparameters.amplitudes_per_m[0] = bounded_amplitude(state.local[0]);
        }
        let departure = after.map_or_else(ShapeDeparture::initial, |state| state.departure);
        departure.apply_to(&mut hyperparameters);
        Flight::new(input, frames, hyperparameters, Knowledge::Shared)
    }

    fn adjust_frame_with_state(
        &self,
        state: &LiveState,
        frames: &[Vec<Observation>],
        elapsed_s: f64,
    ) -> AdjustResult<(LiveState, Solution)> {
        let flight = self.single_frame_flight(frames, Some(state))?;
        let elapsed_s = state.rejected_s + elapsed_s;
        let step = state.step(&flight, elapsed_s);
        let step = match step {
            Ok(step) if step.attempt.is_explained(state.factor) => {
                let next = state.updated(&step, &flight, elapsed_s)?;
                let LiveStep {
                    attempt:
                        FrameAttempt {
                            solved, removed, ..
                        },
                    mount_disturbed,
                    ..
                } = &step;
                let remarks = accepted_remarks(
                    next.frames,
                    self.mounting_count + usize::from(*mount_disturbed),
                    *mount_disturbed,
                );
                let solution = with_flight_sources(solved, Some(&state.attributed), |sources| {
                    frame_solution(&flight, solved, removed, 0, true, remarks, sources)
                });
                return Ok((next, solution));
            }
            other => other.ok(),
        };
        let factor =
            state.next_factor(step.and_then(|step| step.attempt.solved.fit.variance_factor()));
        let rejected_frames = state.rejected_frames + 1;
        let InitialState {
            state: new_state,
            mut solution,
            is_sound,
        } = start_state(&self.single_frame_flight(frames, None)?)?;
        let is_restarted = rejected_frames >= MAX_REJECTED_FRAMES
            || rejected_frames >= state.accepted_frames && is_sound;
        solution
            .remarks
            .insert(0, rejection_remark(is_restarted, self.mounting_count + 1));
        let next = match is_restarted {
            true => LiveState {
                factor,
                ..new_state
            },
            false => LiveState {
                rejected_frames,
                rejected_s: elapsed_s,
                factor,
                ..state.clone()
            },
        };
        Ok((next, solution))
    }

    /// Number of mountings so far: the first, and one after each mount disturbance.
    pub fn mounting_count(&self) -> usize {
        self.mounting_count
    }
}
