//! What the global test judges, and what follows from its verdict.

use super::Outcome;
use crate::adjust::snooping::ResidualSum;
use crate::estimation::quality;

impl Outcome<'_> {
    /// Judged by what there was before much was removed, if anything was: removal cannot buy a passed test.
    pub fn judged(self, before: Option<ResidualSum>) -> Self {
        match before {
            Some(judged) => Self { judged, before_removal: true, ..self }.tested(),
            None => self,
        }
    }

    pub(super) fn tested(mut self) -> Self {
        let ResidualSum { omega, redundancy } = self.judged;
        let options = self.input.options;
        self.global_test = quality::global_test(omega, redundancy, options.global_alpha);
        self.posterior = quality::is_posterior(options.sigma, self.global_test);
        self.scale = self.variance_factor().filter(|_| self.posterior).map_or(1.0, f64::sqrt);
        self
    }

    pub(super) fn variance_factor(&self) -> Option<f64> {
        let ResidualSum { omega, redundancy } = self.judged;
        (redundancy > 0).then(|| omega / redundancy as f64)
    }

    /// Said where much was removed.
    pub(super) fn removal_remark(&self) -> Option<String> {
        self.before_removal.then(|| {
            "so many markers are out that one cause is likelier than as many blunders: the global test judges all of \
             them, and standard deviations follow it"
                .into()
        })
    }
}
