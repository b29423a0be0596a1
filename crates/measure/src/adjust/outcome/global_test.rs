//! Global test of a frame's solution, and its consequences.

use super::FrameOutcome;
use crate::adjust::snooping::ResidualSum;
use crate::estimation::quality;

impl FrameOutcome<'_> {
    /// Uses the sum of squares from before the removal of many observations, if any, for the global test. A test that
    /// passes only because observations were removed is not valid.
    pub fn judged_before_removal(self, before: Option<ResidualSum>) -> Self {
        match before {
            Some(tested_sum) => Self {
                tested_sum,
                before_removal: true,
                ..self
            }
            .apply_global_test(),
            None => self,
        }
    }

    pub(super) fn apply_global_test(mut self) -> Self {
        let ResidualSum { omega, redundancy } = self.tested_sum;
        let options = self.solved.input.options;
        self.global_test = quality::global_test(omega, redundancy, options.global_alpha);
        self.posterior = quality::is_posterior(options.sigma, self.global_test);
        self.scale = self
            .variance_factor()
            .filter(|_| self.posterior)
            .map_or(1.0, f64::sqrt);
        self
    }

    pub(super) fn variance_factor(&self) -> Option<f64> {
        let ResidualSum { omega, redundancy } = self.tested_sum;
        (redundancy > 0).then(|| omega / redundancy as f64)
    }

    /// Remark for a result from which many observations were removed.
    pub(super) fn removal_remark(&self) -> Option<String> {
        self.before_removal.then(|| {
            "many markers were removed, so one common cause is more likely than independent outliers: the global test and \
             the standard deviations include the removed markers. Check for a moved camera, part or panel"
                .into()
        })
    }
}
