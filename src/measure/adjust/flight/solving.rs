//! A flight's solutions, each the start of the next.

use super::flight_problem::FlightProblem;
use super::frames::Flight;
use crate::adjust::AdjustError;
use crate::adjust::snooping::ResidualSum;
use crate::estimation::{Fit, SolveOptions};

/// A flight's setting with its solution.
pub struct Solved {
    /// What was solved.
    pub setting: FlightProblem,
    /// Its solution.
    pub fit: Fit,
    /// What the global test judges instead of it, where much was removed.
    pub judged: Option<ResidualSum>,
}

impl Flight<'_> {
    /// A rough solution, near enough for the decisions that follow from it; what it shows is taken for granted from then on.
    pub fn solve(&mut self, from: Option<&Fit>) -> Result<Solved, AdjustError> {
        let solved = self.solve_by(&SolveOptions { rough: true, residuals: from })?;
        for (frame, layout) in solved.setting.layouts.iter().enumerate() {
            self.assumed.learn(frame, layout, &solved.fit);
        }
        Ok(solved)
    }

    /// The solution itself, from a rough one.
    pub fn finish(&self, rough: &Fit) -> Result<Solved, AdjustError> {
        self.solve_by(&SolveOptions { rough: false, residuals: Some(rough) })
    }

    fn solve_by(&self, course: &SolveOptions) -> Result<Solved, AdjustError> {
        let setting = FlightProblem::new(self, course.residuals);
        let fit = setting.solve(self.input.scene, course)?;
        Ok(Solved { setting, fit, judged: self.judged })
    }
}
