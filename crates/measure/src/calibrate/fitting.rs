//! Sequence of adjustments in a calibration: outlier removal, choice of the lens model, selection of terms.

use nalgebra::Vector2;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::adjust::{CameraAdjustment, initial_adjustment};
use super::check;
use super::model::{GLOBAL, INTERIOR, ImageSize, STRETCH, lens_from_parameters};
use super::outcome::build_calibration;
use super::outliers::Selection;
use super::{BoardView, CalibrateError, Calibration, CalibrationOptions, T_LIMIT_95};
use crate::estimation::robust::coordinate_sigma_px;
use crate::geometry::BROWN;

/// Maximum number of rounds in which the common variance settles.
const MODEL_ROUNDS: usize = 8;
/// Change of the common standard deviation at which the rounds stop: relative, and px.
const MODEL_SETTLED: (f64, f64) = (0.05, 1e-3);

/// Images, image size and options of a calibration.
pub(super) struct CalibrationProblem<'a> {
    pub views: &'a [BoardView],
    pub size: ImageSize,
    pub options: &'a CalibrationOptions,
}

impl CalibrationProblem<'_> {
    /// Fits Brown's or the rational model and removes the images and points that do not fit.
    pub(super) fn fit_without_outliers(
        &self,
        rational: bool,
    ) -> Result<(CameraAdjustment, Selection), CalibrateError> {
        let mut selection = Selection::from_views(self.views, self.size);
        selection.check_view_count()?;
        let mut fixed = [false; GLOBAL];
        fixed[BROWN..INTERIOR].fill(!rational);
        fixed[STRETCH] = self.options.scale_sigma.is_none();
        // The errors of the two directions are independent: their difference has root two times the standard
        // deviation.
        let stretch_sigma = self.options.scale_sigma.unwrap_or_default() * std::f64::consts::SQRT_2;
        let mut adjusted = initial_adjustment(&selection.used, self.size, fixed, stretch_sigma)?;
        loop {
            adjusted = settle_model_sigma(adjusted, &selection.used)?;
            let before: Vec<usize> = selection.used.iter().map(|(k, _)| *k).collect();
            // Each round removes something, so the loop ends.
            let robust = adjust_robustly(&adjusted, &selection.used)?;
            if !selection.remove_worst(&robust, self.views) {
                let select = self.options.select;
                let adjusted = if select {
                    drop_insignificant_terms(adjusted, &selection.used)?
                } else {
                    adjusted
                };
                return Ok((adjusted, selection));
            }
            selection.check_view_count()?;
            let stays = |k: &usize| selection.used.iter().any(|(index, _)| index == k);
            let mut stay = before.iter().map(stays);
            adjusted
                .camera
                .poses
                .retain(|_| stay.next().unwrap_or(false));
        }
    }

    /// Builds the calibration with the radius that the boards cover.
    pub(super) fn calibration(
        &self,
        adjusted: &CameraAdjustment,
        selection: &Selection,
    ) -> Calibration {
        let centre = Vector2::new(adjusted.camera.lens.cx, adjusted.camera.lens.cy);
        let off = self
            .views
            .iter()
            .flatten()
            .map(|p| (p.pixel - centre).norm());
        Calibration {
            covered_radius_px: off.fold(0.0, f64::max),
            ..build_calibration(adjusted, selection)
        }
    }

    /// Fits the rational model if an F-test at 99 % prefers it to Brown's.
    pub(super) fn rational_calibration(
        &self,
        brown: &CameraAdjustment,
        selection: &Selection,
    ) -> Option<Calibration> {
        let mut start = brown.camera.clone();
        start.fixed[BROWN..INTERIOR].fill(false);
        let tried = start
            .adjust(&selection.used, brown.model_sigma_px)
            .ok()?
            .solution;
        let terms = (INTERIOR - BROWN) as f64;
        let ratio = (brown.solution.omega - tried.omega) / terms / tried.variance_factor();
        let limit = FisherSnedecor::new(terms, tried.redundancy as f64)
            .ok()?
            .inverse_cdf(0.99);
        let (adjusted, selection) = (ratio > limit)
            .then(|| self.fit_without_outliers(true).ok())
            .flatten()?;
        Some(self.calibration(&adjusted, &selection))
    }
}

/// Rounds in which the variances of the images settle.
const ROBUST_ROUNDS: usize = 10;

/// Adjusts for the outlier tests: the points of each image are weighted by its own residuals (a variance component per
/// image), so that one deviating image does not distort the others. The common variance is that of all images.
fn adjust_robustly(
    adjusted: &CameraAdjustment,
    used: &[(usize, BoardView)],
) -> Result<CameraAdjustment, CalibrateError> {
    let own_sigmas = |adjusted: &CameraAdjustment| -> Vec<f64> {
        adjusted
            .residuals(used)
            .iter()
            .map(|r| coordinate_sigma_px(r))
            .collect()
    };
    let mut found = adjusted
        .camera
        .adjust_weighted(used, &own_sigmas(adjusted), 1.0)?;
    for _ in 1..ROBUST_ROUNDS {
        found = found
            .camera
            .adjust_weighted(used, &own_sigmas(&found), 1.0)?;
    }
    found.model_sigma_px = found.common_sigma_px(used);
    Ok(found)
}

/// Fixes distortion terms at 0 that do not differ from it, one by one.
fn drop_insignificant_terms(
    mut adjusted: CameraAdjustment,
    used: &[(usize, BoardView)],
) -> Result<CameraAdjustment, CalibrateError> {
    loop {
        let weak = check::droppable_terms(&adjusted.camera.fixed)
            .into_iter()
            .map(|k| (k, check::t_value(&adjusted, k)))
            .filter(|(_, t)| *t < T_LIMIT_95)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((k, _)) = weak else {
            return Ok(adjusted);
        };
        let mut start = adjusted.camera.clone();
        start.fixed[k] = true;
        let mut global = adjusted.solution.global;
        global[k] = 0.0;
        start.lens = lens_from_parameters(ImageSize::from_lens(&start.lens), &global);
        adjusted = settle_model_sigma(start.adjust(used, adjusted.model_sigma_px)?, used)?;
    }
}

/// Repeats the adjustment until the common variance no longer changes.
fn settle_model_sigma(
    mut adjusted: CameraAdjustment,
    used: &[(usize, BoardView)],
) -> Result<CameraAdjustment, CalibrateError> {
    for _ in 0..MODEL_ROUNDS {
        let before = adjusted.model_sigma_px;
        adjusted = adjusted.camera.adjust(used, before)?;
        let after = adjusted.common_sigma_px(used);
        if (after - before).abs() <= MODEL_SETTLED.0 * before.max(after) + MODEL_SETTLED.1 {
            break;
        }
        adjusted.model_sigma_px = after;
    }
    Ok(adjusted)
}
