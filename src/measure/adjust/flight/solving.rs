//! A flight's solutions, each the start of the next.

use super::frames::Flight;
use super::setting::Setting;
use crate::adjust::AdjustError;
use crate::adjust::snooping::Judged;
use crate::estimation::{Course, Fit};

/// A flight's setting with its solution.
pub struct Solved {
    /// What was solved.
    pub setting: Setting,
    /// Its solution.
    pub fit: Fit,
    /// What the global test judges instead of it, where much was removed.
    pub judged: Option<Judged>,
}

impl Flight<'_> {
    /// A rough solution, near enough for the decisions that follow from it; what it shows is taken for granted from then on.
    pub fn solve(&mut self, from: Option<&Fit>) -> Result<Solved, AdjustError> {
        let solved = self.solve_by(&Course { rough: true, residuals: from })?;
        for (frame, layout) in solved.setting.layouts.iter().enumerate() {
            self.assumed.learn(frame, layout, &solved.fit);
        }
        Ok(solved)
    }

    /// The solution itself, from a rough one.
    pub fn finish(&self, rough: &Fit) -> Result<Solved, AdjustError> {
        self.solve_by(&Course { rough: false, residuals: Some(rough) })
    }

    fn solve_by(&self, course: &Course) -> Result<Solved, AdjustError> {
        let setting = Setting::new(self, course.residuals);
        let fit = setting.solve(self.input.scene, course)?;
        Ok(Solved { setting, fit, judged: self.judged })
    }
}
