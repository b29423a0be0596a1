//! Adjustment of the frames of a flight, or of one frame, with the rigid-section beam (docs/adjustment.md).
//!
//! A single frame is a flight of one: its problem has the same unknowns and observations, and differs by what is known
//! besides its images (`knowledge.rs`). The frames of a flight share the marker positions on the ground, the camera and its
//! ground rotation, one rotation per mounting and the ratios of the curvature coefficients. Each frame has its own curvature and twist coefficients, local to its group.
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
//! | a frame alone, frames that contradict the others | `single_frame.rs`, `contradicting_frames.rs` |
//! | departure, drift, remounts and default priors, estimated from the data | `tuning.rs`, `prior_scaling.rs` |
//! | result of a frame | `frame_solution.rs` |
//! | live mode, frame by frame | `live.rs` |
//! | information for later flights | `flight_information.rs` |
//! | joint covariance of the shapes | `joint_shape.rs` |

mod contradicting_frames;
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
mod single_frame;
mod solving;
mod tuning;
mod usage;

pub use flight_information::learn_from_flight;
pub use live::LiveAdjustment;
pub use single_frame::{solve_frame_with, solve_spatial};

use self::contradicting_frames::{LEAVING_PASSES, find_sound_frames, solve_contradicting_frame};
use self::joint::JointSolution;
use super::input::AdjustmentInput;
use super::outcome::with_prior_if_consistent;
use super::scene::WingScene;
use super::{AdjustError, AdjustResult, Observation, Options, Solution};
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
    Ok(solve_flight_with(setup, orientation, frames, options, |_| ())?.solutions)
}

/// Result of a flight.
pub struct FlightResult<T> {
    /// One result per frame.
    pub solutions: Vec<Solution>,
    /// Indices of the frames that were adjusted jointly.
    pub joint_frames: Vec<usize>,
    /// What was derived from the joint solution.
    pub derived: T,
}

/// Adjusts all frames of a flight, at least one, and derives something else from the joint solution. Frames that contradict
/// the others are adjusted alone.
///
/// # Errors
/// Returns an error if the input is invalid or the frames do not determine a solution.
pub fn solve_flight_with<T>(
    setup: &Setup,
    orientation: &Orientation,
    frames: &[Vec<Observation>],
    options: &Options,
    derive: impl Fn(&JointSolution) -> T,
) -> AdjustResult<FlightResult<T>> {
    let scene = WingScene::new(setup, orientation)?;
    let solve_some = |options: &Options, joint_frames: Vec<usize>| -> AdjustResult<_> {
        let chosen: Vec<_> = joint_frames.iter().map(|k| frames[*k].clone()).collect();
        let input = AdjustmentInput {
            setup,
            orientation,
            scene: &scene,
            options: &match joint_frames.len() == frames.len() {
                true => options.clone(),
                false => options.for_frames(&joint_frames),
            },
        };
        let joint = JointSolution::new(input, &chosen)?;
        let left_out = joint.contradicting_frames();
        let result = FlightResult {
            solutions: joint.frame_solutions(),
            derived: derive(&joint),
            joint_frames,
        };
        Ok((result, left_out))
    };
    let solve = |options: &Options| {
        let all = solve_some(options, (0..frames.len()).collect());
        let (mut result, mut left_out) = match all {
            Err(error @ AdjustError::Estimation(_)) => {
                let sound = find_sound_frames(setup, orientation, frames, options);
                solve_some(options, sound.ok_or(error)?)?
            }
            all => all?,
        };
        for _ in 0..LEAVING_PASSES {
            if left_out.is_empty() {
                break;
            }
            let kept = result.joint_frames.iter().enumerate();
            let kept = kept.filter(|(at, _)| !left_out.contains(at));
            let Ok(without) = solve_some(options, kept.map(|(_, frame)| *frame).collect()) else {
                break;
            };
            (result, left_out) = without;
        }
        Ok(result)
    };
    let mut result = with_prior_if_consistent(options, solve, |result| &mut result.solutions)?;
    for (frame, observations) in frames.iter().enumerate() {
        if !result.joint_frames.contains(&frame) {
            let options = &options.for_frames(&[frame]);
            let alone = solve_contradicting_frame(setup, orientation, observations, options);
            result.solutions.insert(frame, alone);
        }
    }
    Ok(result)
}

#[cfg(test)]
mod tests;
