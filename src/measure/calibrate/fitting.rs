//! The adjustments that a calibration consists of: without what does not fit, of the model that the pictures tell.

use nalgebra::Vector2;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::adjust::{CameraAdjustment, AdjustmentStart, adjust_bundle, adjust_with_view_sigmas, initial_adjustment};
use super::check;
use super::model::{GLOBAL, INTERIOR, STRETCH, ImageSize, lens_from_parameters};
use super::outcome::build_calibration;
use super::outliers::Selection;
use super::{CalibrateError, Calibration, CalibrationOptions, SIGNIFICANT, BoardView};
use crate::estimation::robust::coordinate_sigma_px;
use crate::geometry::BROWN;

/// Rounds in which the points' common variance settles.
const MODEL_ROUNDS: usize = 8;
/// A change of the common standard deviation that no longer matters: its share, and px.
const MODEL_SETTLED: (f64, f64) = (0.05, 1e-3);

/// What is calibrated.
pub(super) struct CalibrationProblem<'a> {
    pub views: &'a [BoardView],
    pub size: ImageSize,
    pub options: &'a CalibrationOptions,
}

impl CalibrationProblem<'_> {
    /// With Brown's or the rational model, and without the pictures and points that do not fit.
    pub(super) fn fit_without_outliers(&self, rational: bool) -> Result<(CameraAdjustment, Selection), CalibrateError> {
        let mut selection = Selection::from_views(self.views, self.size);
        selection.check_count()?;
        let mut held = [false; GLOBAL];
        held[BROWN..INTERIOR].fill(!rational);
        held[STRETCH] = self.options.scale_sigma.is_none();
        // The two directions err independently: their difference by root two of one.
        let stretch_sigma = self.options.scale_sigma.unwrap_or_default() * std::f64::consts::SQRT_2;
        let mut adjusted = initial_adjustment(&selection.used, self.size, held, stretch_sigma)?;
        loop {
            adjusted = settle_model_sigma(adjusted, &selection.used)?;
            let before: Vec<usize> = selection.used.iter().map(|(k, _)| *k).collect();
            // Each round takes something out: they end.
            let apart = adjust_robustly(&adjusted, &selection.used)?;
            if !selection.remove_worst(&apart, self.views) {
                let select = self.options.select;
                let adjusted = if select { drop_insignificant_terms(adjusted, &selection.used)? } else { adjusted };
                return Ok((adjusted, selection));
            }
            selection.check_count()?;
            let stays = |k: &usize| selection.used.iter().any(|(index, _)| index == k);
            let mut stay = before.iter().map(stays);
            adjusted.poses.retain(|_| stay.next().unwrap_or(false));
        }
    }

    pub(super) fn calibration(&self, adjusted: &CameraAdjustment, selection: &Selection) -> Calibration {
        let centre = Vector2::new(adjusted.lens.cx, adjusted.lens.cy);
        let off = self.views.iter().flatten().map(|p| (p.pixel - centre).norm());
        Calibration { shown_px: off.fold(0.0, f64::max), ..build_calibration(adjusted, selection) }
    }

    /// With the rational model, where the sum of squares says at 99 % that it is another one (F-test).
    pub(super) fn rational_calibration(&self, brown: &CameraAdjustment, selection: &Selection) -> Option<Calibration> {
        let mut start = AdjustmentStart::from_adjustment(brown);
        start.held[BROWN..INTERIOR].fill(false);
        let tried = adjust_bundle(&selection.used, &start, brown.model_sigma_px).ok()?.solution;
        let terms = (INTERIOR - BROWN) as f64;
        let ratio = (brown.solution.omega - tried.omega) / terms / tried.variance_factor();
        let limit = FisherSnedecor::new(terms, tried.redundancy as f64).ok()?.inverse_cdf(0.99);
        let (adjusted, selection) = (ratio > limit).then(|| self.fit_without_outliers(true).ok()).flatten()?;
        Some(self.calibration(&adjusted, &selection))
    }
}

/// Rounds in which the pictures' own variances settle.
const ROBUST_ROUNDS: usize = 10;

/// For the tests: each picture's points count as its own residuals deserve (a variance component each), so that
/// the many that agree are not pulled by one that does not. Its common variance is that of all pictures.
fn adjust_robustly(adjusted: &CameraAdjustment, used: &[(usize, BoardView)]) -> Result<CameraAdjustment, CalibrateError> {
    let mut start = AdjustmentStart::from_adjustment(adjusted);
    let mut residuals = adjusted.residuals(used);
    for round in 1.. {
        let own: Vec<f64> = residuals.iter().map(|r| coordinate_sigma_px(r)).collect();
        let mut found = adjust_with_view_sigmas(used, &start, &own, 1.0)?;
        if round == ROBUST_ROUNDS {
            found.model_sigma_px = found.common_sigma_px(used);
            return Ok(found);
        }
        (residuals, start) = (found.residuals(used), AdjustmentStart::from_adjustment(&found));
    }
    Err(CalibrateError::NoFit)
}

/// Without the distortion terms that do not differ from 0.
fn drop_insignificant_terms(mut adjusted: CameraAdjustment, used: &[(usize, BoardView)]) -> Result<CameraAdjustment, CalibrateError> {
    loop {
        let weak = check::droppable_terms(&adjusted.held)
            .into_iter()
            .map(|k| (k, check::t_value(&adjusted, k)))
            .filter(|(_, t)| *t < SIGNIFICANT)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((k, _)) = weak else { return Ok(adjusted) };
        let mut start = AdjustmentStart::from_adjustment(&adjusted);
        start.held[k] = true;
        let mut global = adjusted.solution.global;
        global[k] = 0.0;
        start.lens = lens_from_parameters(ImageSize::from_lens(&start.lens), &global);
        adjusted = settle_model_sigma(adjust_bundle(used, &start, adjusted.model_sigma_px)?, used)?;
    }
}

/// Adjusted again until the variance that all points have in common no longer changes.
fn settle_model_sigma(mut adjusted: CameraAdjustment, used: &[(usize, BoardView)]) -> Result<CameraAdjustment, CalibrateError> {
    for _ in 0..MODEL_ROUNDS {
        let before = adjusted.model_sigma_px;
        adjusted = adjust_bundle(used, &AdjustmentStart::from_adjustment(&adjusted), before)?;
        let after = adjusted.common_sigma_px(used);
        if (after - before).abs() <= MODEL_SETTLED.0 * before.max(after) + MODEL_SETTLED.1 {
            break;
        }
        adjusted.model_sigma_px = after;
    }
    Ok(adjusted)
}
