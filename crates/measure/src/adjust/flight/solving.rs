//! Solutions of a flight, each the start of the next.

use super::flight_problem::FlightProblem;
use super::frames::Flight;
use super::usage::RemovedObservation;
use crate::adjust::AdjustResult;
use crate::adjust::input::AdjustmentInput;
use crate::adjust::outcome::FrameOutcome;
use crate::adjust::snooping::{ResidualSum, SolvedGroup};
use crate::adjust::stated_widths::{WIDENING_PASSES, widen_refuted_priors};
use crate::estimation::{Fit, SolveOptions};

/// Flight problem with its solution.
pub struct SolvedFlight {
    pub flight_problem: FlightProblem,
    /// Solution of the problem.
    pub fit: Fit,
    /// Sum of squares for the global test in place of that of `fit`, if many observations were removed.
    pub tested_sum: Option<ResidualSum>,
}

impl SolvedFlight {
    /// Returns the group of a frame or, after the last one, of survey and ground frame.
    pub fn group<'a>(&'a self, input: &'a AdjustmentInput, group: usize) -> SolvedGroup<'a> {
        let Self {
            flight_problem:
                FlightProblem {
                    problem,
                    members,
                    ground_members,
                    ..
                },
            fit,
            ..
        } = self;
        SolvedGroup {
            input,
            problem,
            fit,
            group,
            members: members.get(group).unwrap_or(ground_members),
        }
    }

    /// Evaluates a frame's part of the solution.
    pub fn frame_outcome<'a>(
        &'a self,
        input: &'a AdjustmentInput,
        frame: usize,
    ) -> FrameOutcome<'a> {
        FrameOutcome::new(
            self.group(input, frame),
            &self.flight_problem.layouts[frame],
        )
        .judged_before_removal(self.tested_sum)
    }
}

impl Flight<'_> {
    /// Computes a rough solution, accurate enough for the decisions based on it, and updates the hyperparameters from it.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn solve_rough(&mut self, from: Option<&Fit>) -> AdjustResult<SolvedFlight> {
        let solved = self.solve_from(from, true)?;
        for (frame, layout) in solved.flight_problem.layouts.iter().enumerate() {
            self.hyperparameters
                .update_from_frame(frame, layout, &solved.fit);
        }
        Ok(solved)
    }

    /// Widens the priors whose stated widths the frames refute, and then finds the outliers again, as long as there is a
    /// solution.
    pub fn widen_refuted_priors(
        &mut self,
        mut solved: SolvedFlight,
        removed: &mut Vec<RemovedObservation>,
    ) -> SolvedFlight {
        for _ in 0..WIDENING_PASSES {
            let widened =
                widen_refuted_priors(&solved.flight_problem.problem, &solved.fit, &self.widened);
            // Level 0: nothing is tested.
            if self.input.options.global_alpha <= 0.0 || !widened.differs_from(&self.widened) {
                break;
            }
            let mut wider = Self {
                widened,
                ..self.clone()
            };
            wider.usage.reset_except(&[]);
            let Ok((found, outliers)) = wider.remove_outliers() else {
                break;
            };
            if wider.solve_converged(&found.fit).is_err() {
                break;
            }
            (*self, solved, *removed) = (wider, found, outliers);
        }
        solved
    }

    /// Computes the converged solution, starting from a rough one.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn solve_converged(&self, rough: &Fit) -> AdjustResult<SolvedFlight> {
        self.solve_from(Some(rough), false)
    }

    fn solve_from(&self, earlier: Option<&Fit>, rough: bool) -> AdjustResult<SolvedFlight> {
        let flight_problem = FlightProblem::new(self, earlier);
        let solve_options = &SolveOptions {
            rough,
            residuals: earlier.map_or(vec![], Fit::residuals),
        };
        let fit = flight_problem.solve(self.input.scene, solve_options)?;
        Ok(SolvedFlight {
            flight_problem,
            fit,
            tested_sum: self.tested_sum,
        })
    }
}
