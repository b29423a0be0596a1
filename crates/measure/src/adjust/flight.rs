//! Adjustment of the frames of a flight, or of one frame, with the rigid-section beam (docs/adjustment.md).
//!
//! A single frame is a flight of one: its problem has the same unknowns and observations, and differs by what is known
//! besides its images (`knowledge.rs`). The frames of a flight share the marker positions on the ground, the camera and its ground rotation, one rotation per mounting and
//! the ratios of the curvature coefficients. Each frame has its own curvature and twist coefficients, local to its group.
//! Until the mountings are determined, each frame may deviate from the common rotation. A frame's curvature may deviate
//! from the shared shape by a fraction of its amplitude; that fraction is estimated from the data. Frames are eliminated
//! from the normal equations by their Schur complement, so the cost is linear in the number of frames.
//!
//! | step | file |
//! |---|---|
//! | knowledge besides the frames' images | `knowledge.rs` |
//! | hyperparameters, assumed first and then estimated | `hyperparameters.rs`, `mountings.rs` |
//! | observations in use | `usage.rs` |
//! | observations, unknowns, conditions, solutions | `frames.rs`, `flight_problem.rs`, `shape.rs`, `solving.rs`, `joint.rs` |
//! | outliers, causes | `outliers.rs`, `free_causes.rs` |
//! | departure, drift, remounts and default priors, estimated from the data | `tuning.rs`, `prior_scaling.rs` |
//! | result of a frame | `frame_solution.rs` |
//! | live mode, frame by frame | `live.rs` |
//! | information for later flights | `flight_information.rs` |
//! | joint covariance of the shapes | `joint_shape.rs` |

mod flight_information;
mod flight_problem;
mod frame_solution;
mod frames;
mod free_causes;
mod hyperparameters;
mod joint;
mod joint_shape;
mod knowledge;
mod live;
mod load_twist;
mod mountings;
mod outliers;
mod prior_scaling;
mod shape;
mod solving;
mod tuning;
mod usage;

pub use flight_information::learn_from_flight;
pub use live::LiveAdjustment;

use self::frames::Flight;
use self::hyperparameters::FlightHyperparameters;
use self::joint::JointSolution;
use self::knowledge::Knowledge;
use super::input::AdjustmentInput;
use super::outcome::{FrameOutcome, with_prior_if_consistent};
use super::scene::WingScene;
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

/// Adjusts one frame.
///
/// # Errors
/// Returns an error if the input is invalid or the observations do not determine a solution.
pub fn solve_spatial(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    options: &Options,
) -> AdjustResult<Solution> {
    solve_frame_with(setup, orientation, observations, options, |_| ())
        .map(|(solution, ())| solution)
}

/// Adjusts one frame, with the prior from earlier flights unless variance components are estimated, and derives something
/// else from the outcome.
pub fn solve_frame_with<T>(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    options: &Options,
    derive: impl Fn(&FrameOutcome) -> T,
) -> AdjustResult<(Solution, T)> {
    let scene = WingScene::new(setup, orientation)?;
    let frames = [observations.to_vec()];
    let mut options = options.clone();
    options
        .flight_prior
        .take_if(|_| options.variance_components);
    let solve = |options: &Options| {
        let input = AdjustmentInput {
            setup,
            orientation,
            scene: &scene,
            options,
        };
        let knowledge = match options.flight_prior {
            Some(_) => Knowledge::Shared,
            None => Knowledge::Alone,
        };
        let hyperparameters = FlightHyperparameters::for_single_frame(&input);
        let flight = Flight::new(input, &frames, hyperparameters, knowledge)?;
        let mut joint = JointSolution::for_single_frame(flight)?;
        let (variance_components, remarks) = match options.variance_components {
            true => joint.solved.estimate_variance_components(&scene)?,
            false => Default::default(),
        };
        let solution = joint.first_solution(false);
        let solution = Solution {
            variance_components,
            remarks: [remarks, solution.remarks].concat(),
            ..solution
        };
        Ok((solution, derive(&joint.outcome(0))))
    };
    with_prior_if_consistent(&options, solve, |(solution, _)| {
        std::slice::from_mut(solution)
    })
}

#[cfg(test)]
mod tests;
