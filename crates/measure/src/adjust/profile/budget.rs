//! Uncertainty budget of the tip deflection with the paper's method, whose only error sources are images and survey.

use std::borrow::Cow;

use super::response::LinearResponse;
use super::{ProfileAdjustment, ProfileMarker};
use crate::adjust::budget::{IMAGE, SURVEY};
use crate::adjust::{DeflectionReference, MarkerSolution, VarianceBudget, VarianceShare};
use crate::ordering::sort_by_value;

impl ProfileAdjustment<'_> {
    /// Computes the budget for the outermost marker of `markers` with a deflection; `None` without one.
    pub(super) fn variance_budget(
        &self,
        markers: &[MarkerSolution],
        placed: &[ProfileMarker],
    ) -> Option<VarianceBudget> {
        let ground = |m: &MarkerSolution| {
            self.geometry
                .ground_coordinates(m.marker)
                .map_or(f64::MIN, |(arc_m, _)| arc_m)
        };
        let deflected = markers.iter().filter(|m| m.deflection_m.is_some());
        let marker = deflected
            .max_by(|a, b| ground(a).total_cmp(&ground(b)))?
            .marker;
        let measured = self
            .observations
            .iter()
            .position(|o| o.marker == marker)
            .and_then(|index| placed.get(index));
        let (arc_m, _) = self.geometry.ground_coordinates(marker)?;
        let predicted = LinearResponse::bending_function(self.deflection_by_a(arc_m));
        let parts = self
            .response
            .variance_parts(measured.map_or(&predicted, |placed| &placed.deflection));
        let total: f64 = parts.iter().sum();
        let share = |(source, part)| VarianceShare {
            source: Cow::from(source),
            share: part / total,
            sigma_if_known_m: None,
        };
        let mut shares: Vec<_> = [SURVEY, IMAGE].into_iter().zip(parts).map(share).collect();
        sort_by_value(&mut shares, |one| -one.share);
        (total > 0.0).then_some(VarianceBudget {
            marker,
            reference: DeflectionReference::Survey,
            shares,
        })
    }
}
