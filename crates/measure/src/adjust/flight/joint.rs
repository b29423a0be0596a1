//! Joint adjustment of all frames of a flight, from start to end.

use super::frame_solution::{flight_remarks, frame_solution, prior_remarks, with_flight_sources};
use super::frames::Flight;
use super::hyperparameters::FlightHyperparameters;
use super::mountings::FrameMountings;
use super::solving::SolvedFlight;
use super::usage::RemovedObservation;
use crate::adjust::causes::{WidenedPriors, find_spread};
use crate::adjust::input::AdjustmentInput;
use crate::adjust::snooping::ResidualSum;
use crate::adjust::{AdjustResult, GlobalTest, Observation, Solution};
use crate::estimation::{quality, robust};

/// Number of rounds in which departure and drift settle after the mountings are determined.
const DEPARTURE_ROUNDS: usize = 3;

/// Level at which a flight's frames are tested against the joint solution.
const MISFIT_ALPHA: f64 = 1e-3;
/// Ratio of a frame's variance factor to the median of its flight's from which on the frame, and not the flight, is wrong.
const MISFIT_RATIO: f64 = 3.0;

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
        let mut flight = Flight::new(
            input,
            frames,
            FlightHyperparameters::initial(&input, frames.len(), mountings),
        )?;
        let (solved, mut removed) = flight.remove_or_explain_outliers()?;
        let solved = flight.tune_variances(solved, 1)?;
        flight.find_mountings(&solved);
        let solved = flight.solve_rough(Some(&solved.fit))?;
        let solved = flight.free_causes(solved, &mut removed);
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
        let (solved, mut removed) = flight.remove_or_explain_outliers()?;
        let solved = flight.free_causes(solved, &mut removed);
        let rough = flight.readmit_observations(solved, &mut removed)?;
        let solved = flight.solve_converged(&rough.fit)?;
        Ok(Self {
            flight,
            solved,
            removed,
        })
    }

    /// Frames that do not fit the others, in order, each with its variance factor; those with less than half of the largest may
    /// be consequences. Empty if the global test passes.
    pub fn misfitting_frames(&self) -> Vec<(usize, f64)> {
        let (fit, frames) = (&self.solved.fit, self.flight.frames.len());
        let sum = self.solved.tested_sum.unwrap_or(ResidualSum::from_fit(fit));
        let alpha = self.flight.input.options.global_alpha;
        if quality::global_test(sum.omega, sum.redundancy, alpha) != Some(GlobalTest::Rejected) {
            return vec![];
        }
        let sums: Vec<ResidualSum> = (0..frames).map(|frame| self.frame_sum(frame)).collect();
        let factors: Vec<f64> = sums.iter().map(ResidualSum::factor).collect();
        let usual = MISFIT_RATIO * robust::median(factors.clone()).unwrap_or(1.0).max(1.0);
        let most = factors
            .iter()
            .fold(0.0, |most: f64, factor| most.max(*factor));
        let is_off = |frame: &usize| {
            let ResidualSum { omega, redundancy } = sums[*frame];
            factors[*frame] > usual.max(0.5 * most)
                && quality::global_test(omega, redundancy, MISFIT_ALPHA / frames as f64)
                    == Some(GlobalTest::Rejected)
        };
        (0..frames)
            .filter(is_off)
            .map(|frame| (frame, factors[frame]))
            .collect()
    }

    /// Sum of squares of a frame's images, with those that were removed from it.
    fn frame_sum(&self, frame: usize) -> ResidualSum {
        let group = self.solved.group(&self.flight.input, frame);
        let (mut omega, mut redundancy) = (0.0, 0.0);
        for block in 0..group.members.len() {
            let residuals = &group.fit.groups[frame].blocks[block].residuals;
            let covariance = group.problem.groups[frame].blocks[block].covariance.clone();
            omega += covariance
                .cholesky()
                .map_or(0.0, |factor| residuals.dot(&factor.solve(residuals)));
            redundancy += group
                .reliability(block)
                .iter()
                .map(|r| r.redundancy)
                .sum::<f64>();
        }
        for removed in self.removed.iter().filter(|removed| removed.group == frame) {
            omega += removed.suspect.w.powi(2);
            redundancy += 1.0;
        }
        ResidualSum {
            omega,
            redundancy: redundancy.round() as usize,
        }
    }

    /// Results of all frames.
    pub fn frame_solutions(&self) -> Vec<Solution> {
        let Self {
            flight,
            solved,
            removed,
        } = self;
        let mut solutions: Vec<Solution> = with_flight_sources(solved, None, |sources| {
            let one = |frame: usize| {
                let remarks =
                    [prior_remarks(flight, solved), flight_remarks(flight, frame)].concat();
                frame_solution(flight, solved, removed, frame, true, remarks, sources)
            };
            (0..flight.frames.len()).map(one).collect()
        });
        for causes in &flight.widened.alternatives {
            self.compare_with(causes, &mut solutions);
        }
        solutions
    }

    /// Sets the doubt of the results that other causes, which explain the frames equally well, leave open.
    fn compare_with(&self, causes: &WidenedPriors, solutions: &mut [Solution]) {
        let flight = &self.flight;
        let other = flight.with_causes(causes.clone());
        let Ok((wider, rough, _)) = other else { return };
        let Ok(other) = wider.solve_converged(&rough.fit) else {
            return;
        };
        for (frame, solution) in solutions.iter_mut().enumerate() {
            if let (None, Some(budget)) = (&solution.doubt, &solution.budget) {
                let own = self.solved.frame_outcome(&flight.input, frame);
                let (value, _) = other
                    .frame_outcome(&flight.input, frame)
                    .tip_deflection(budget);
                let free = (&flight.widened, causes);
                solution.doubt = find_spread(free, own.tip_deflection(budget), value);
            }
        }
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
