//! What the variance of the tip's deflection comes from: the paper's method knows images and survey alone.

use super::{Adjusted, Placed};
use crate::adjust::budget::{IMAGE, SURVEY};
use crate::adjust::{Budget, BudgetShare, Reference};

impl Adjusted<'_> {
    /// Of the outermost marker; `None` without one.
    pub(super) fn budget(&self, placed: &[Placed]) -> Option<Budget> {
        let ground = |index: &usize| self.geometry.ground(self.observations[*index].marker);
        let span = |index: &usize| ground(index).map_or(f64::MIN, |(arc_m, _)| arc_m);
        let tip = (0..self.observations.len()).max_by(|a, b| span(a).total_cmp(&span(b)))?;
        let parts = self.response.parts(&placed.get(tip)?.deflection);
        let total: f64 = parts.iter().sum();
        let share = |(source, part)| BudgetShare { source, share: part / total, sigma_if_known_m: None };
        let mut shares: Vec<_> = [SURVEY, IMAGE].into_iter().zip(parts).map(share).collect();
        shares.sort_by(|a, b| b.share.total_cmp(&a.share));
        let marker = self.observations[tip].marker;
        (total > 0.0).then_some(Budget { marker, reference: Reference::Survey, shares })
    }
}
