//! Variance budget of the tip deflection with the paper's method, whose only error sources are images and survey.

use std::borrow::Cow;

use super::{ProfileAdjustment, ProfileMarker};
use crate::adjust::budget::{IMAGE, SURVEY};
use crate::adjust::{DeflectionReference, VarianceBudget, VarianceShare};

impl ProfileAdjustment<'_> {
    /// Computes the budget for the outermost marker; `None` without markers.
    pub(super) fn variance_budget(&self, placed: &[ProfileMarker]) -> Option<VarianceBudget> {
        let ground = |index: &usize| self.geometry.ground_coordinates(self.observations[*index].marker);
        let span = |index: &usize| ground(index).map_or(f64::MIN, |(arc_m, _)| arc_m);
        let tip = (0..self.observations.len()).max_by(|a, b| span(a).total_cmp(&span(b)))?;
        let parts = self.response.variance_parts(&placed.get(tip)?.deflection);
        let total: f64 = parts.iter().sum();
        let share =
            |(source, part)| VarianceShare { source: Cow::from(source), share: part / total, sigma_if_known_m: None };
        let mut shares: Vec<_> = [SURVEY, IMAGE].into_iter().zip(parts).map(share).collect();
        shares.sort_by(|a, b| b.share.total_cmp(&a.share));
        let marker = self.observations[tip].marker;
        (total > 0.0).then_some(VarianceBudget { marker, reference: DeflectionReference::Survey, shares })
    }
}
