//! Joint adjustment of the frames of a flight (docs/adjustment.md).
//!
//! The frames share the marker positions on the ground, the camera and its ground rotation, one rotation per mounting and
//! the ratios of the curvature coefficients. Each frame has its own curvature and twist coefficients, local to its group.
//! Until the mountings are determined, each frame may deviate from the common rotation. A frame's curvature may deviate
//! from the shared shape by a fraction of its amplitude; that fraction is estimated from the data. Frames are eliminated
//! from the normal equations by their Schur complement, so the cost is linear in the number of frames.
//!
//! | step | file |
//! |---|---|
//! | hyperparameters, assumed first and then estimated | `hyperparameters.rs`, `mountings.rs` |
//! | observations in use | `usage.rs` |
//! | observations, unknowns, conditions, solutions | `frames.rs`, `flight_problem.rs`, `shape.rs`, `solving.rs`, `joint.rs` |
//! | outliers | `outliers.rs` |
//! | departure, drift, remounts and default priors, estimated from the data | `tuning.rs`, `prior_scaling.rs` |
//! | result of a frame | `frame_solution.rs` |
//! | live mode, frame by frame | `live.rs` |
//! | information for later flights | `flight_information.rs` |
//! | joint covariance of the shapes | `joint_shape.rs` |

mod flight_information;
mod flight_problem;
mod frame_solution;
mod frames;
mod hyperparameters;
mod joint;
mod joint_shape;
mod live;
mod mountings;
mod outliers;
mod prior_scaling;
mod shape;
mod solving;
mod tuning;
mod usage;

pub use flight_information::learn_from_flight;
pub use live::LiveAdjustment;
pub use usage::FlightUsage;

use self::frames::Flight;
use self::hyperparameters::FlightHyperparameters;
use self::joint::JointSolution;
use self::mountings::FrameMountings;
use super::input::AdjustmentInput;
use super::outcome::{FrameOutcome, with_prior_if_consistent};
use super::scene::WingScene;
use super::terms::MIN_DRIFT_RAD;
use super::{AdjustResult, Observation, Options, Solution};
use crate::setup::{Orientation, Setup};

/// Adjusts all frames of a flight jointly with the rigid-section beam; returns one solution per frame.
///
/// # Errors
/// Returns an error if the input is invalid or the frames do not determine a solution.
pub fn solve_flight(
    setup: &Setup,
    orientation: &Orientation,
    frames: &[Vec<Observation>],
    options: &Options,
) -> AdjustResult<Vec<Solution>> {
    if frames.is_empty() {
        return Ok(vec![]);
    }
    solve_flight_with(setup, orientation, frames, options, |_| ()).map(|(solutions, ())| solutions)
}

/// Adjusts all frames of a flight, at least one, and derives something else from the joint solution.
pub fn solve_flight_with<T>(
    setup: &Setup,
    orientation: &Orientation,
    frames: &[Vec<Observation>],
    options: &Options,
    derive: impl Fn(&JointSolution) -> T,
) -> AdjustResult<(Vec<Solution>, T)> {
    let scene = WingScene::new(setup, orientation)?;
    let solve = |options: &Options| {
        let joint = JointSolution::new(
            AdjustmentInput {
                setup,
                orientation,
                scene: &scene,
                options,
            },
            frames,
        )?;
        Ok((joint.frame_solutions(), derive(&joint)))
    };
    with_prior_if_consistent(options, solve, |(solutions, _)| solutions)
}

/// Adjusts one frame with the prior from earlier flights, as a flight of one frame, and derives something else from the
/// outcome.
pub fn solve_frame_with_prior<T>(
    input: &AdjustmentInput,
    frame: &[Observation],
    derive: &dyn Fn(&FrameOutcome) -> T,
) -> AdjustResult<(Solution, T)> {
    let frames = [frame.to_vec()];
    let solve = |options: &Options| {
        let input = AdjustmentInput { options, ..*input };
        let mountings = FrameMountings::for_single_frame(options.mountings.as_deref());
        // The frame's rotation is that of its mounting, which has drifted since the ground frames if the camera was not
        // remounted.
        let mut hyperparameters = FlightHyperparameters::initial(&input, 1, mountings);
        hyperparameters.drift_rad = MIN_DRIFT_RAD;
        let joint = JointSolution::for_single_frame(Flight::new(input, &frames, hyperparameters)?)?;
        Ok((
            joint.first_solution(false),
            derive(&joint.solved.frame_outcome(&joint.flight.input, 0)),
        ))
    };
    with_prior_if_consistent(input.options, solve, |(solution, _)| {
        std::slice::from_mut(solution)
    })
}

#[cfg(test)]
mod tests;
