//! Joint adjustment of all frames of a flight, from start to end.

use super::frame_solution::{flight_remarks, frame_solution, prior_remarks, with_flight_sources};
use super::frames::Flight;
use super::free_causes::free_causes;
use super::hyperparameters::FlightHyperparameters;
use super::knowledge::Knowledge;
use super::mountings::FrameMountings;
use super::solving::SolvedFlight;
use super::usage::RemovedObservation;
use crate::adjust::input::AdjustmentInput;
use crate::adjust::outcome::FrameOutcome;
use crate::adjust::{AdjustResult, Observation, Solution};

/// Number of rounds in which departure and drift settle after the mountings are determined.
const DEPARTURE_ROUNDS: usize = 3;

/// A solved flight.
pub struct JointSolution<'a> {
    pub flight: Flight<'a>,
    /// Solution with the remaining observations.
    pub solved: SolvedFlight,
    /// Observations removed by data snooping.
    pub removed: Vec<RemovedObservation>,
}

impl<'a> JointSolution<'a> {
    /// Solves frames and determines their mountings, drift and departures from the shared shape.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn new(input: AdjustmentInput<'a>, frames: &'a [Vec<Observation>]) -> AdjustResult<Self> {
        let mountings = FrameMountings::undetermined(input.options.mountings.as_deref());
        let hyperparameters = FlightHyperparameters::initial(&input, frames.len(), mountings);
        let flight = Flight::new(input, frames, hyperparameters, Knowledge::Shared)?;
        let (mut flight, solved, removed) = flight.remove_or_explain_outliers()?;
        let solved = flight.tune_variances(solved, 1)?;
        flight.find_mountings(&solved);
        let solved = flight.solve_rough(Some(&solved.fit))?;
        let (mut flight, solved, mut removed) = free_causes((flight, solved, removed));
        let solved = flight.readmit_observations(solved, &mut removed)?;
        let rough = flight.tune_variances(solved, DEPARTURE_ROUNDS)?;
        let rough = flight.explain_by_image_shifts(rough, &mut removed)?;
        let solved = flight.solve_converged(&rough.fit)?;
        Ok(Self {
            flight,
            solved,
            removed,
        })
    }

    /// Solves one frame, which does not determine mountings, drift or departures.
    ///
    /// # Errors
    /// Returns an error if the frame has no solution.
    pub fn for_single_frame(mut flight: Flight<'a>) -> AdjustResult<Self> {
        let all = flight.clone();
        let rough = flight.solve_with_image_causes()?;
        let (solved, removed) = flight.remove_outliers(rough)?;
        let found = free_causes((flight, solved, removed));
        let (flight, rough, removed) = all.explain_many_outliers(found);
        let solved = flight.solve_converged(&rough.fit)?;
        Ok(Self {
            flight,
            solved,
            removed,
        })
    }

    /// Evaluates a frame's part of the solution.
    pub fn outcome(&self, frame: usize) -> FrameOutcome<'_> {
        self.solved.frame_outcome(&self.flight.input, frame)
    }

    /// Results of all frames.
    pub fn frame_solutions(&self) -> Vec<Solution> {
        let Self {
            flight,
            solved,
            removed,
        } = self;
        with_flight_sources(solved, None, |sources| {
            let one = |frame: usize| {
                let remarks =
                    [prior_remarks(flight, solved), flight_remarks(flight, frame)].concat();
                frame_solution(flight, solved, removed, frame, true, remarks, sources)
            };
            (0..flight.frames.len()).map(one).collect()
        })
    }

    /// Result of the first frame. `of_flight` adds the parameters that only several frames determine.
    pub fn first_solution(&self, of_flight: bool) -> Solution {
        let Self {
            flight,
            solved,
            removed,
        } = self;
        with_flight_sources(solved, None, |sources| {
            frame_solution(
                flight,
                solved,
                removed,
                0,
                of_flight,
                prior_remarks(flight, solved),
                sources,
            )
        })
    }
}
