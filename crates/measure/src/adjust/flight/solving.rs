//! Solutions of a flight, each the start of the next.

use super::flight_problem::FlightProblem;
use super::frames::Flight;
use super::knowledge::Knowledge;
use crate::adjust::input::AdjustmentInput;
use crate::adjust::outcome::FrameOutcome;
use crate::adjust::scene::WingScene;
use crate::adjust::snooping::{ResidualSum, SolvedGroup};
use crate::adjust::{AdjustResult, VarianceComponent};
use crate::estimation::{Fit, SolveOptions, VarianceGroup, variance_components};

/// Maximum number of passes for the amplitude with which the shape of a frame alone is weighted.
const AMPLITUDE_PASSES: usize = 3;
/// Change of the logarithm of the amplitude below which it has settled.
const AMPLITUDE_SETTLED: f64 = 0.05;

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

    /// Estimates variance components of images and survey of a frame alone, with remarks; updates the solution.
    ///
    /// # Errors
    /// Returns an error if the problem with other variances has no solution.
    pub fn estimate_variance_components(
        &mut self,
        scene: &WingScene,
    ) -> AdjustResult<(Vec<VarianceComponent>, Vec<String>)> {
        let flight_problem = &self.flight_problem;
        let mut problem = flight_problem.problem.clone();
        let blocks = &flight_problem.problem.groups[0].blocks;
        let image = |_: usize, block: usize| (3..blocks[block].observed.len()).collect();
        let survey = |_: usize, _: usize| vec![0, 1, 2];
        let group = |name, members| VarianceGroup { name, members };
        let groups = [group("image", &image as _), group("survey", &survey)];
        let found = variance_components(&mut problem, &groups, |at, blocks| {
            flight_problem.linearise(scene, at, blocks)
        })?;
        (self.fit, self.flight_problem.problem) = (found.fit, problem);
        Ok((found.components, found.remarks))
    }
}

impl Flight<'_> {
    /// Computes a rough solution, accurate enough for the decisions based on it, and updates the hyperparameters from it;
    /// those after earlier frames follow from these. For a frame alone there are several passes, in which the amplitude
    /// settles with which the prior of its shape is weighted.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn solve_rough(&mut self, from: Option<&Fit>) -> AdjustResult<SolvedFlight> {
        let mut solved = self.solve_from(from, true)?;
        if let Knowledge::After(_) = self.knowledge {
            return Ok(solved);
        }
        for pass in 1.. {
            let weighted = self.hyperparameters.amplitudes_per_m[0];
            for (frame, layout) in solved.flight_problem.layouts.iter().enumerate() {
                self.hyperparameters
                    .update_from_frame(frame, layout, &solved.fit);
            }
            let found = self.hyperparameters.amplitudes_per_m[0];
            let has_settled = (found / weighted).ln().abs() < AMPLITUDE_SETTLED;
            if !self.knowledge.is_alone() || has_settled || pass == AMPLITUDE_PASSES {
                break;
            }
            solved = self.solve_from(Some(&solved.fit), true)?;
        }
        Ok(solved)
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
