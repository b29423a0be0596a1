//! The adjustments that a calibration consists of: without what does not fit, of the model that the pictures tell.

use nalgebra::Vector2;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::adjust::{Adjusted, Start, adjust, adjust_views, first};
use super::check;
use super::model::{GLOBAL, INTERIOR, STRETCH, Size, lens_of};
use super::outcome::outcome;
use super::outliers::Selection;
use super::{CalibrateError, Calibration, Options, SIGNIFICANT, View};
use crate::estimation::robust::coordinate_px;
use crate::geometry::BROWN;

/// Rounds in which the points' common variance settles.
const MODEL_ROUNDS: usize = 8;
/// A change of the common standard deviation that no longer matters: its share, and px.
const MODEL_SETTLED: (f64, f64) = (0.05, 1e-3);

/// What is calibrated.
pub(super) struct Set<'a> {
    pub views: &'a [View],
    pub size: Size,
    pub options: &'a Options,
}

impl Set<'_> {
    /// With Brown's or the rational model, and without the pictures and points that do not fit.
    pub(super) fn fitted(&self, rational: bool) -> Result<(Adjusted, Selection), CalibrateError> {
        let mut selection = Selection::first(self.views, self.size);
        selection.enough()?;
        let mut held = [false; GLOBAL];
        held[BROWN..INTERIOR].fill(!rational);
        held[STRETCH] = self.options.scale_sigma.is_none();
        // The two directions err independently: their difference by root two of one.
        let stretch_sigma = self.options.scale_sigma.unwrap_or_default() * std::f64::consts::SQRT_2;
        let mut adjusted = first(&selection.used, self.size, held, stretch_sigma)?;
        loop {
            adjusted = settled(adjusted, &selection.used)?;
            let before: Vec<usize> = selection.used.iter().map(|(k, _)| *k).collect();
            // Each round takes something out: they end.
            let apart = robust(&adjusted, &selection.used)?;
            if !selection.narrow(&apart, self.views) {
                let select = self.options.select;
                let adjusted = if select { selected(adjusted, &selection.used)? } else { adjusted };
                return Ok((adjusted, selection));
            }
            selection.enough()?;
            let stays = |k: &usize| selection.used.iter().any(|(index, _)| index == k);
            let mut stay = before.iter().map(stays);
            adjusted.poses.retain(|_| stay.next().unwrap_or(false));
        }
    }

    pub(super) fn outcome(&self, adjusted: &Adjusted, selection: &Selection) -> Calibration {
        let centre = Vector2::new(adjusted.lens.cx, adjusted.lens.cy);
        let off = self.views.iter().flatten().map(|p| (p.pixel - centre).norm());
        Calibration { shown_px: off.fold(0.0, f64::max), ..outcome(adjusted, selection) }
    }

    /// With the rational model, where the sum of squares says at 99 % that it is another one (F-test).
    pub(super) fn richer(&self, brown: &Adjusted, selection: &Selection) -> Option<Calibration> {
        let mut start = Start::of(brown);
        start.held[BROWN..INTERIOR].fill(false);
        let tried = adjust(&selection.used, &start, brown.model_sigma_px).ok()?.solution;
        let terms = (INTERIOR - BROWN) as f64;
        let ratio = (brown.solution.omega - tried.omega) / terms / tried.variance_factor();
        let limit = FisherSnedecor::new(terms, tried.redundancy as f64).ok()?.inverse_cdf(0.99);
        let (adjusted, selection) = (ratio > limit).then(|| self.fitted(true).ok()).flatten()?;
        Some(self.outcome(&adjusted, &selection))
    }
}

/// Rounds in which the pictures' own variances settle.
const ROBUST_ROUNDS: usize = 10;

/// For the tests: each picture's points count as its own residuals deserve (a variance component each), so that
/// the many that agree are not pulled by one that does not. Its common variance is that of all pictures.
fn robust(adjusted: &Adjusted, used: &[(usize, View)]) -> Result<Adjusted, CalibrateError> {
    let mut start = Start::of(adjusted);
    let mut residuals = adjusted.residuals(used);
    for round in 1.. {
        let own: Vec<f64> = residuals.iter().map(|r| coordinate_px(r)).collect();
        let mut found = adjust_views(used, &start, &own, 1.0)?;
        if round == ROBUST_ROUNDS {
            found.model_sigma_px = found.common_sigma_px(used);
            return Ok(found);
        }
        (residuals, start) = (found.residuals(used), Start::of(&found));
    }
    Err(CalibrateError::NoFit)
}

/// Without the distortion terms that do not differ from 0.
fn selected(mut adjusted: Adjusted, used: &[(usize, View)]) -> Result<Adjusted, CalibrateError> {
    loop {
        let weak = check::droppable(&adjusted.held)
            .into_iter()
            .map(|k| (k, check::t_value(&adjusted, k)))
            .filter(|(_, t)| *t < SIGNIFICANT)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((k, _)) = weak else { return Ok(adjusted) };
        let mut start = Start::of(&adjusted);
        start.held[k] = true;
        let mut global = adjusted.solution.global;
        global[k] = 0.0;
        start.lens = lens_of(Size::of(&start.lens), &global);
        adjusted = settled(adjust(used, &start, adjusted.model_sigma_px)?, used)?;
    }
}

/// Adjusted again until the variance that all points have in common no longer changes.
fn settled(mut adjusted: Adjusted, used: &[(usize, View)]) -> Result<Adjusted, CalibrateError> {
    for _ in 0..MODEL_ROUNDS {
        let before = adjusted.model_sigma_px;
        adjusted = adjust(used, &Start::of(&adjusted), before)?;
        let after = adjusted.common_sigma_px(used);
        if (after - before).abs() <= MODEL_SETTLED.0 * before.max(after) + MODEL_SETTLED.1 {
            break;
        }
        adjusted.model_sigma_px = after;
    }
    Ok(adjusted)
}
