//! All frames of a flight with their joint solution, from start to end.

use super::frame_solution::{beside, flight_remarks, frame_solution, single_frame_solution, with_sources};
use super::frames::Flight;
use super::hyperparameters::FlightHyperparameters;
use super::mountings::Mountings;
use super::solving::Solved;
use super::usage::Removed;
use crate::adjust::input::Input;
use crate::adjust::{AdjustError, Method, Observation, Solution};

/// Rounds in which departure and drift settle once the mountings are found.
const DEPARTURE_ROUNDS: usize = 3;

/// A flight that was solved.
pub struct Joint<'a> {
    /// What it is.
    pub flight: Flight<'a>,
    /// With what is left of it.
    pub solved: Solved,
    /// What is not.
    pub removed: Vec<Removed>,
}

impl<'a> Joint<'a> {
    /// Of frames whose mountings, drift and departures from the shared shape are to be found.
    pub fn new(input: Input<'a>, frames: &'a [Vec<Observation>]) -> Result<Self, AdjustError> {
        let stated = Mountings::unknown(input.options.mountings.as_deref());
        let mut flight =
            Flight::new(input, frames, FlightHyperparameters::at_first(&input, frames.len(), stated))?;
        let (solved, mut removed) = flight.without_blunders_or_cause()?;
        let solved = flight.tune(solved, 1)?;
        flight.find_mountings(&solved);
        let solved = flight.solve(Some(&solved.fit))?;
        let solved = flight.readmit(solved, &mut removed)?;
        let rough = flight.tune(solved, DEPARTURE_ROUNDS)?;
        let solved = flight.finish(&rough.fit)?;
        Ok(Self { flight, solved, removed })
    }

    /// Of one frame, which tells nothing of these.
    pub fn alone(mut flight: Flight<'a>) -> Result<Self, AdjustError> {
        let (solved, mut removed) = flight.without_blunders_or_cause()?;
        let rough = flight.readmit(solved, &mut removed)?;
        let solved = flight.finish(&rough.fit)?;
        Ok(Self { flight, solved, removed })
    }

    /// Of each frame.
    pub fn solutions(&self) -> Vec<Solution> {
        let Self { flight, solved, removed } = self;
        with_sources(solved, None, |sources| {
            let one = |frame: usize| {
                let remarks = [beside(flight, solved), flight_remarks(flight, frame)].concat();
                frame_solution(flight, solved, removed, frame, remarks, sources)
            };
            (0..flight.frames.len()).map(one).collect()
        })
    }

    /// Of a single frame.
    pub fn solution(&self, method: Method) -> Solution {
        let Self { flight, solved, removed } = self;
        with_sources(solved, None, |sources| match method {
            Method::Flight => frame_solution(flight, solved, removed, 0, beside(flight, solved), sources),
            _ => single_frame_solution(flight, solved, removed, (0, method), beside(flight, solved), sources),
        })
    }
}
