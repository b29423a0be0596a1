//! Fit of the image model to one hypothesis.

use std::cell::RefCell;

use nalgebra::{Matrix2, Vector2};

use crate::detect::accept::verdict::{MeasuredMarker, MeasurementResult, fits_poorly, judge_fit};
use crate::detect::accept::{
    consistency::is_out_of_focus, options::VERDICT, preference::is_preferred,
};
use crate::detect::appearance::parameters::{
    ANGLE, BLUR, DARK, GAMMA, LIGHT, MAJOR, MINOR, MarkerParameters, MarkerPattern, OVERSHOOT,
    TANGENT, X, Y, grey_contrast,
};
use crate::detect::attempt::options::MEASURE;
use crate::detect::attempt::sharpening_candidates::{SharpeningCandidate, SharpeningCandidates};
use crate::detect::attempt::start::{crossing_in_reduced, fit_start};
use crate::detect::detection::{Overshoot, RejectReason, covariance::CovarianceSource};
use crate::detect::estimate::gauss_newton::{MarkerFit, fit_final};
use crate::detect::estimate::options::WEIGHT;
use crate::detect::estimate::overshoot;
use crate::detect::estimate::prior::{fix_fine_light, select_unknowns};
use crate::detect::estimate::terms::glare_spline;
use crate::detect::estimate::terms::veiling_glare::{GlareFit, fit_with_glare};
use crate::detect::estimate::{lack_of_fit, outlined_quadrants};
use crate::detect::hypothesis::{EdgePair, Hypothesis, prior::MarkerPrior};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::numbers::SIGNIFICANT_SIGMAS;
use crate::detect::occlusion::region::{OcclusionBand, Region};
use crate::detect::occlusion::{glare, paint, seam};
use crate::detect::propose::quadrant_outline::{fit_outline_and_edges, refine_outline};
use crate::detect::sample::select::{
    COARSE, EdgeAppearance, FINAL, PixelExclusion, UNLIMITED, select_pixels,
};
use crate::detect::segment::blob::Blob;
use crate::raster::Raster;

/// Conditions under which the markers of a frame are measured.
#[derive(Clone, Copy)]
pub struct Bounds {
    /// Standard deviation of the noise, grey levels.
    pub noise: f64,
    /// Largest blur, px.
    pub blur: f64,
    /// True if discs are measured through the glare that lies over them.
    pub through_glare: bool,
    /// Sharpening of the frame.
    pub overshoot: Option<Overshoot>,
    /// True if a position to some 0.1 px is sufficient.
    pub rough: bool,
}

impl Bounds {
    /// Creates the conditions of a frame without measured markers from its noise, grey levels.
    pub fn from_noise(noise: f64) -> Self {
        Self {
            noise,
            blur: VERDICT.max_blur_px,
            through_glare: false,
            overshoot: None,
            rough: false,
        }
    }
}

/// Candidates for the estimation of sharpening, collected during a search.
pub type SharedCandidates = RefCell<SharpeningCandidates>;

/// Fits the model to a hypothesis and judges the fit. Records it as a candidate for the estimation of sharpening as long as
/// that is undetermined.
///
/// # Errors
/// Returns an error if the hypothesis is not a marker, with the reason.
pub fn measure_hypothesis(
    image: &Raster,
    blobs: &[Blob],
    hypothesis: &Hypothesis,
    bounds: Bounds,
    candidates: &SharedCandidates,
) -> MeasurementResult {
    reject_without_fit(blobs, hypothesis)?;
    let attempt = FitAttempt {
        image,
        blobs,
        hypothesis,
        bounds,
        candidates,
        floor: min_scale(bounds.noise),
    };
    let (near, scale) = attempt.first_fit()?;
    // The residuals of a coarse fit are at most twice those allowed for the last one.
    if fits_poorly(
        image,
        hypothesis,
        0.5 * scale,
        bounds.noise,
        (grey_contrast(&near), near[OVERSHOOT]),
    ) {
        attempt.add_candidate(
            &with_fitted_geometry(hypothesis, &near),
            &near,
            scale,
            false,
        );
        return Err(RejectReason::PoorFit);
    }
    if near[BLUR] > bounds.blur && !may_be_out_of_focus(hypothesis, near[BLUR]) {
        return Err(RejectReason::BlurOutlier);
    }
    let mut fitted = refine_outline(image, with_fitted_geometry(hypothesis, &near), &near);
    if let Some((found, m)) = fit_outline_and_edges(image, &fitted, &near) {
        let answer = attempt.fit_with_outline(&found, &m, scale);
        if matches!(answer, Ok(_) | Err(RejectReason::Pattern)) {
            return answer;
        }
        fitted = found;
    }
    if bounds.rough {
        return judge_fit(
            image,
            &fitted,
            &MarkerFit::from_coarse(near, scale, MEASURE.rough_px),
            bounds.noise,
        );
    }
    let is_determined = !fitted.is_in_glare() || fitted.prior.has_full_size();
    if fitted.pattern == MarkerPattern::Disc && !fitted.is_under_decal() && is_determined {
        let least = scale.max(attempt.floor);
        let seams = seam::find_seams(image, &fitted.ellipse, &near, least)
            .into_iter()
            .map(Region::Seam);
        let paint =
            paint::find_painted_end(image, &fitted.ellipse, &near, least).map(Region::Paint);
        let mut without = fitted.clone();
        without.excluded.extend(seams.chain(paint));
        if without.excluded.len() > fitted.excluded.len() {
            let without = attempt.last_fit(&without, &near, scale);
            if without.is_ok() {
                return without;
            }
            // Too few pixels may remain; the fit with the excluded ones at least finds the marker.
        }
    }
    attempt.last_fit(&fitted, &near, scale)
}

/// Returns whether a blur can be that of a marker out of focus, independent of the blur of the frame's other markers.
fn may_be_out_of_focus(hypothesis: &Hypothesis, blur: f64) -> bool {
    is_out_of_focus(hypothesis.pattern.shape(), hypothesis.ellipse.minor, blur)
        && blur < VERDICT.max_blur_px
}

/// Rejects hypotheses that need no fit.
///
/// # Errors
/// Returns an error if the hypothesis touches the frame's edge, is too small or too flat.
pub fn reject_without_fit(blobs: &[Blob], hypothesis: &Hypothesis) -> Result<(), RejectReason> {
    let ellipse = &hypothesis.ellipse;
    if hypothesis
        .blobs
        .iter()
        .any(|&i| blobs.get(i).is_some_and(|b| b.at_edge))
    {
        return Err(RejectReason::TouchesEdge);
    }
    if ellipse.major < MEASURE.min_axes_px[0] || ellipse.minor < MEASURE.min_axes_px[1] {
        return Err(RejectReason::TooSmall);
    }
    if hypothesis.prior.size.is_none()
        && ellipse.major > MEASURE.max_blob_axis_ratio * ellipse.minor
    {
        return Err(RejectReason::NotAnEllipse);
    }
    Ok(())
}

/// State of the measurement of one hypothesis.
struct FitAttempt<'a> {
    image: &'a Raster,
    blobs: &'a [Blob],
    hypothesis: &'a Hypothesis,
    bounds: Bounds,
    candidates: &'a SharedCandidates,
    /// Smallest scale of residuals, grey levels.
    floor: f64,
}

impl FitAttempt<'_> {
    /// Fits a hypothesis coarsely. Returns the marker's parameters and the scale of the residuals, grey levels.
    fn first_fit(&self) -> Result<(MarkerParameters, f64), RejectReason> {
        let Self {
            image,
            blobs,
            hypothesis,
            bounds,
            floor,
            ..
        } = *self;
        let budget = if hypothesis.is_under_decal() {
            UNLIMITED
        } else {
            COARSE
        };
        let known = hypothesis
            .prior
            .edge
            .map(|edge| edge.blur.value)
            .or(hypothesis.prior.blur);
        let blur = known.unwrap_or(MEASURE.blur_px);
        let first = |appearance: EdgeAppearance| {
            fit_start(
                image,
                PixelExclusion::Blobs(blobs),
                hypothesis,
                (appearance, bounds.overshoot),
                budget,
                floor,
            )
        };
        let appearance = EdgeAppearance {
            crossing: hypothesis.ellipse.centre,
            blur,
        };
        first(appearance).or_else(|reason| {
            let crossing = crossing_in_reduced(image, hypothesis, floor).ok_or(reason)?;
            first(EdgeAppearance {
                crossing,
                ..appearance
            })
        })
    }

    /// Fits all parameters, from those of the first fit and the scale of its residuals, grey levels, and judges the fit.
    fn last_fit(
        &self,
        fitted: &Hypothesis,
        near: &MarkerParameters,
        scale: f64,
    ) -> MeasurementResult {
        let Self {
            image,
            blobs,
            hypothesis,
            bounds,
            floor,
            ..
        } = *self;
        let (mut unknowns, bends) = select_unknowns(fitted);
        unknowns.free[GAMMA] &= grey_contrast(near) > MEASURE.min_gamma_contrast * near[LIGHT];
        bounds
            .overshoot
            .iter()
            .for_each(|known| overshoot::add_overshoot_prior(known, &mut unknowns));
        let whole = !hypothesis.is_under_decal();
        let (masked, all) = if whole {
            (exclude_darker_surroundings(near, floor), FINAL)
        } else {
            (PixelExclusion::Blobs(blobs), UNLIMITED)
        };
        let appearance = EdgeAppearance {
            crossing: Vector2::new(near[X], near[Y]),
            blur: near[BLUR],
        };
        let pixels = select_pixels(image, masked, fitted, appearance, all)
            .ok_or(RejectReason::NoConvergence)?;
        let mut bent = fit_final(&pixels, near, scale, &unknowns, floor);
        if bent.is_none() && fitted.pattern == MarkerPattern::Disc {
            // Between neighbours too little skin is visible to determine how the light changes.
            fix_fine_light(&mut unknowns);
            bent = fit_final(&pixels, near, scale, &unknowns, floor);
        }
        let bent = bent.ok_or(RejectReason::NoConvergence)?;
        // If the bend is not significant, the straight model is more precise.
        let sigma = |k: usize| bent.covariance[(k, k)].max(0.0).sqrt();
        let is_bent = |&k: &usize| bent.parameters[k].abs() > SIGNIFICANT_SIGMAS * sigma(k);
        let result = if !hypothesis.is_whole() || bends.iter().any(is_bent) {
            bent
        } else {
            bends.iter().for_each(|&k| unknowns.free[k] = false);
            bent.with_zero(bends)
        };
        let (plain, rms) = (result.parameters, result.rms);
        let floor = floor.max(WEIGHT.floor * grey_contrast(near));
        // The light field does not support overshoot.
        let bears_field = whole && bounds.overshoot.is_none();
        let result = lack_of_fit::improve_fit(&pixels, result, &unknowns, floor, bears_field);
        let answer = judge_fit(image, fitted, &result, bounds.noise);
        if matches!(answer, Ok(_) | Err(RejectReason::PoorFit)) {
            self.add_candidate(fitted, &plain, rms, answer.is_ok());
        }
        if bounds.through_glare && fitted.pattern == MarkerPattern::Disc && fitted.is_in_glare() {
            self.choose_in_glare(fitted, &result, answer, floor)
        } else {
            answer
        }
    }

    /// Records a fit as a candidate for the estimation of sharpening, as long as that is undetermined.
    fn add_candidate(
        &self,
        fitted: &Hypothesis,
        plain: &MarkerParameters,
        scale: f64,
        is_marker: bool,
    ) {
        if self.bounds.overshoot.is_none() && self.hypothesis.prior == MarkerPrior::default() {
            let candidate = SharpeningCandidate {
                hypothesis: fitted.clone(),
                plain: *plain,
                scale,
                is_marker,
            };
            self.candidates
                .borrow_mut()
                .add_if_informative(candidate, self.bounds.noise);
        }
    }

    /// Measures a disc with glare over it, from the fit and the judgement without the part in glare. If both its ends are
    /// visible through the glare, it is measured through the glare; otherwise, if all of its size is predicted, through the
    /// fringe of the glare.
    fn choose_in_glare(
        &self,
        fitted: &Hypothesis,
        fit: &MarkerFit,
        plain: MeasurementResult,
        floor: f64,
    ) -> MeasurementResult {
        if !matches!(
            plain,
            Ok(_) | Err(RejectReason::Uncertain | RejectReason::GlareOccluded)
        ) {
            return plain;
        }
        let through = |bands: Vec<OcclusionBand>| self.fit_through_glare(fitted, fit, bands, floor);
        let all = through(Vec::new());
        if let Some((all, true)) = all {
            return Ok(all);
        }
        // The edges next to a saturated end determine it less precisely than the neighbouring discs: it stays
        // excluded.
        let known = fitted.prior.has_full_size();
        let fringe = || {
            through(glare::find_glare_bands(
                self.image,
                &fitted.ellipse,
                MEASURE.fringe_ratio,
            ))
        };
        let fringe = if known {
            fringe().map(|(fringe, _)| fringe)
        } else {
            None
        };
        match (plain, fringe) {
            (Ok(plain), Some(fringe)) if !is_preferred(&fringe.detection, &plain.detection) => {
                Ok(plain)
            }
            (_, Some(fringe)) => Ok(fringe),
            (Err(reason), None) => {
                let (mut all, _) = all.ok_or(reason)?;
                if !known {
                    let axis = all.detection.ellipse().major_direction();
                    let variance = MEASURE.one_end_px.powi(2);
                    all.detection.covariance_px2.add_along(
                        CovarianceSource::SaturatedEnd,
                        axis,
                        variance,
                    );
                }
                Ok(all)
            }
            (plain, None) => plain,
        }
    }

    /// Measures a disc with the part that is visible through glare, outside some bands, from the fit without the part in
    /// glare. Also returns whether both its ends are visible.
    fn fit_through_glare(
        &self,
        seen: &Hypothesis,
        fit: &MarkerFit,
        bands: Vec<OcclusionBand>,
        floor: f64,
    ) -> Option<(MeasuredMarker, bool)> {
        let m = &fit.parameters;
        let mut fitted = with_fitted_geometry(seen, m).with_glare(bands);
        let mut start = GlareFit::from_plain(fit, floor);
        for _ in 0..2 {
            let appearance = EdgeAppearance {
                crossing: fitted.ellipse.centre,
                blur: m[BLUR],
            };
            let pixels = select_pixels(
                self.image,
                exclude_darker_surroundings(m, floor),
                &fitted,
                appearance,
                UNLIMITED,
            )?;
            let (mut unknowns, _) = select_unknowns(&fitted);
            // Glare changes the contrast along the disc far more than its own darkness does.
            unknowns.free[DARK + 1..=DARK + 2].fill(false);
            let lit = fit_with_glare(&pixels, &fitted.ellipse, &start, &unknowns, floor)?;
            let found = judge_fit(self.image, &fitted, &lit.fit, self.bounds.noise).ok()?;
            let mut found = MeasuredMarker {
                through_glare: true,
                is_whole: false,
                ..found
            };
            let variance = Matrix2::identity() * MEASURE.glare_px.powi(2);
            found
                .detection
                .covariance_px2
                .add(CovarianceSource::ThroughGlare, variance);
            let moved = (found.detection.centre_px - fitted.ellipse.centre).norm();
            if moved < MEASURE.settled_px {
                return Some((found, glare_spline::shows_ends(&pixels)));
            }
            fitted.ellipse = found.detection.ellipse();
            start = lit;
        }
        None
    }

    /// Measures narrow quadrants by edges and outline together, from the parameters of a first fit and the scale of its
    /// residuals, grey levels.
    fn fit_with_outline(
        &self,
        found: &Hypothesis,
        m: &MarkerParameters,
        scale: f64,
    ) -> MeasurementResult {
        let result = outlined_quadrants::fit_quadrants(self.image, found, m, scale, self.floor);
        let (pixels, result, unknowns) = result.ok_or(RejectReason::NoConvergence)?;
        // Too few pixels to determine a light field.
        let floor = self.floor.max(WEIGHT.floor * grey_contrast(m));
        let result = lack_of_fit::improve_fit(&pixels, result, &unknowns, floor, false);
        if !outlined_quadrants::has_white(&result.parameters) {
            return Err(RejectReason::Pattern);
        }
        judge_fit(self.image, found, &result, self.bounds.noise)
    }
}

/// Returns the smallest scale of residuals, grey levels.
pub fn min_scale(noise: f64) -> f64 {
    MEASURE.min_scale.max(MEASURE.min_scale_over_noise * noise)
}

/// Returns the rule that excludes pixels outside a fitted disc that are darker than its bright surroundings by more than a
/// fraction of the contrast and than residuals of the smallest scale `floor`, grey levels.
pub fn exclude_darker_surroundings<'a>(m: &MarkerParameters, floor: f64) -> PixelExclusion<'a> {
    PixelExclusion::DarkerThan(
        *m,
        (WEIGHT.cut_scales * floor).max(MEASURE.foreign_contrast * grey_contrast(m)),
    )
}

/// Returns the hypothesis with the geometry of a coarse fit.
fn with_fitted_geometry(hypothesis: &Hypothesis, m: &MarkerParameters) -> Hypothesis {
    let mut out = hypothesis.clone();
    match hypothesis.edges {
        None => {
            out.ellipse = Ellipse {
                centre: Vector2::new(m[X], m[Y]),
                major: m[MAJOR],
                minor: m[MINOR],
                angle: m[ANGLE],
            };
        }
        Some(_) => {
            out.edges = Some(EdgePair {
                along_rad: m[ANGLE],
                tangent: m[TANGENT],
            })
        }
    }
    out
}
