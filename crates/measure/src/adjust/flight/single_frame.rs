//! Adjustment of a single frame: a flight of one.

use super::frames::Flight;
use super::hyperparameters::FlightHyperparameters;
use super::joint::JointSolution;
use super::knowledge::Knowledge;
use crate::adjust::input::AdjustmentInput;
use crate::adjust::outcome::{FrameOutcome, with_prior_if_consistent};
use crate::adjust::scene::WingScene;
use crate::adjust::{AdjustResult, Observation, Options, Solution};
use crate::setup::{Orientation, Setup};

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
