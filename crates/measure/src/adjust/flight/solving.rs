//! Solutions of a flight, each the start of the next.

use super::flight_problem::FlightProblem;
use super::frames::Flight;
use super::usage::RemovedObservation;
use crate::adjust::AdjustResult;
use crate::adjust::causes::{FREEING_PASSES, WidenedPriors, asked_causes};
use crate::adjust::input::AdjustmentInput;
use crate::adjust::outcome::FrameOutcome;
use crate::adjust::snooping::{ResidualSum, SolvedGroup};
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
        let solved = self.solve_with_options(&SolveOptions {
            rough: true,
            residuals: from,
        })?;
        for (frame, layout) in solved.flight_problem.layouts.iter().enumerate() {
            self.hyperparameters
                .update_from_frame(frame, layout, &solved.fit);
        }
        Ok(solved)
    }

    /// Frees the causes that the frames ask for, and then finds the outliers again, as long as there is a solution.
    pub fn free_causes(
        &mut self,
        mut solved: SolvedFlight,
        removed: &mut Vec<RemovedObservation>,
    ) -> SolvedFlight {
        // Level 0: nothing is tested.
        if self.input.options.global_alpha <= 0.0 {
            return solved;
        }
        for _ in 0..FREEING_PASSES {
            let problem = &solved.flight_problem.problem;
            let widened = asked_causes(problem, &solved.fit, &self.widened, 1.0);
            if !widened.differs_from(&self.widened) {
                break;
            }
            let Ok((wider, found, outliers)) = self.with_causes(widened) else {
                break;
            };
            if wider.solve_converged(&found.fit).is_err() {
                break;
            }
            (*self, solved, *removed) = (wider, found, outliers);
        }
        solved
    }

    /// Computes a rough solution with these causes free, and finds the outliers again.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn with_causes(
        &self,
        widened: WidenedPriors,
    ) -> AdjustResult<(Self, SolvedFlight, Vec<RemovedObservation>)> {
        let mut wider = Self {
            widened,
            ..self.clone()
        };
        wider.usage.reset_except(&[]);
        let (found, outliers) = wider.remove_outliers()?;
        Ok((wider, found, outliers))
    }

    /// Computes the converged solution, starting from a rough one.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn solve_converged(&self, rough: &Fit) -> AdjustResult<SolvedFlight> {
        self.solve_with_options(&SolveOptions {
            rough: false,
            residuals: Some(rough),
        })
    }

    fn solve_with_options(&self, solve_options: &SolveOptions) -> AdjustResult<SolvedFlight> {
        let flight_problem = FlightProblem::new(self, solve_options.residuals);
        let fit = flight_problem.solve(self.input.scene, solve_options)?;
        Ok(SolvedFlight {
            flight_problem,
            fit,
            tested_sum: self.tested_sum,
        })
    }
}
