//! Decision whether a fit is accepted as a marker, with its accuracy, or rejected with a reason.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix2, Vector2};

use super::pattern::{ends_in_arcs, have_corners};
use crate::detect::accept::options::VERDICT;
use crate::detect::appearance::parameters::{
    ANGLE, BLUR, DARK, LIGHT, MAJOR, MINOR, MarkerParameters, MarkerPattern, OVERSHOOT, SAG, TAPER,
    X, Y, grey_contrast,
};
use crate::detect::detection::covariance::{Covariance, CovarianceSource};
use crate::detect::detection::{Detection, RejectReason};
use crate::detect::estimate::{gauss_newton::MarkerFit, options::PRIOR};
use crate::detect::hypothesis::{Hypothesis, options::NEIGHBOURS};
use crate::detect::image::ellipse::{Ellipse, wrap_half_turn};
use crate::detect::image::noise;
use crate::detect::numbers::IMPROBABLE_SIGMAS;
use crate::raster::Raster;

/// Returns whether residuals (root mean square, grey levels) are larger than those of a marker. They are compared with the
/// noise of the frame and, for a disc, with the noise around it. Sharpening amplifies the residuals of a marker with the
/// image, by 1 + `overshoot`.
pub fn fits_poorly(
    image: &Raster,
    hypothesis: &Hypothesis,
    rms: f64,
    noise: f64,
    (contrast, overshoot): (f64, f64),
) -> bool {
    let own = VERDICT.max_rms_over_contrast * contrast * (1.0 + overshoot.max(0.0));
    let is_larger = |noise: f64| rms > VERDICT.max_rms_over_noise * noise + own;
    // Letters raise the noise around them; they are mistaken for quadrants rather than for discs.
    if hypothesis.pattern == MarkerPattern::Disc {
        is_larger(noise.max(VERDICT.edge_noise))
            && is_larger(noise::noise_around(image, &hypothesis.ellipse))
    } else {
        is_larger(noise)
    }
}

/// Accepted marker with the parameters of its fit.
#[derive(Clone)]
pub struct MeasuredMarker {
    pub detection: Detection,
    /// Blur of its edges including the pixel, standard deviation, px.
    pub blur: f64,
    /// Contrast over the grey of white or skin.
    pub darkness: f64,
    /// Fraction of the light that black absorbs.
    pub dark: f64,
    /// Ratio of the centre's variance from blocks of residuals to that of the fit.
    pub correlation: f64,
    /// Standard deviation of a disc's semi-major axis; 0 for quadrants.
    pub major_sigma_px: f64,
    /// True if its residuals are more than noise: they are correlated, or the image is sharpened.
    pub is_systematic: bool,
    /// True if it was measured through glare that lies over it.
    pub through_glare: bool,
    /// True if no part of it was assumed to be hidden.
    pub is_whole: bool,
}

impl MeasuredMarker {
    /// Returns whether its position is so precise that nothing can hide a large part of it.
    pub fn is_sure(&self) -> bool {
        self.detection.variance() < NEIGHBOURS.certain_px2
    }

    /// Builds a whole marker for tests.
    #[cfg(test)]
    pub fn whole(detection: Detection) -> Self {
        let (blur, darkness, dark, correlation, length) = (1.5, 0.6, 0.87, 1.0, 0.0);
        let (is_systematic, through_glare, is_whole) = (false, false, true);
        Self {
            detection,
            blur,
            darkness,
            dark,
            correlation,
            major_sigma_px: length,
            is_systematic,
            through_glare,
            is_whole,
        }
    }
}

/// Accepted marker, or the reason for its rejection.
pub type MeasurementResult = Result<MeasuredMarker, RejectReason>;

/// Accepts or rejects a fit.
///
/// # Errors
/// Returns an error if the fit is not a marker, with the reason.
pub fn judge_fit(
    image: &Raster,
    hypothesis: &Hypothesis,
    fit: &MarkerFit,
    noise: f64,
) -> MeasurementResult {
    let m = &fit.parameters;
    let contrast = grey_contrast(m);
    let ellipse = fitted_ellipse(hypothesis, m);
    check_shape(image, hypothesis, m, &ellipse)?;
    if m[DARK] < VERDICT.min_darkness
        || contrast < VERDICT.min_contrast.max(IMPROBABLE_SIGMAS * noise)
    {
        return Err(RejectReason::LowContrast);
    }
    if m[BLUR] > VERDICT.max_blur_px
        || fit.inliers < VERDICT.min_inliers
        || fits_poorly(image, hypothesis, fit.rms, noise, (contrast, m[OVERSHOOT]))
    {
        return Err(RejectReason::PoorFit);
    }
    if is_other_pattern(image, hypothesis, m, &ellipse) {
        return Err(RejectReason::Pattern);
    }
    let covariance = centre_covariance(hypothesis, fit, &ellipse);
    let sigma = (covariance[(0, 0)] + covariance[(1, 1)]).sqrt();
    if !(sigma > 0.0 && sigma < max_centre_sigma(hypothesis, &ellipse)) {
        return Err(RejectReason::Uncertain);
    }
    let is_disc = hypothesis.pattern == MarkerPattern::Disc;
    Ok(MeasuredMarker {
        detection: Detection {
            shape: hypothesis.pattern.shape(),
            centre_px: ellipse.centre,
            covariance_px2: covariance,
            semi_major_px: ellipse.major,
            semi_minor_px: ellipse.minor,
            angle_rad: ellipse.angle,
            fit_rms: fit.rms,
            contrast,
            marker: None,
        },
        blur: m[BLUR],
        darkness: contrast / m[LIGHT].max(1.0),
        dark: m[DARK],
        correlation: fit.correlation,
        major_sigma_px: if is_disc {
            fit.covariance[(MAJOR, MAJOR)].max(0.0).sqrt()
        } else {
            0.0
        },
        is_systematic: fit.is_systematic || m[OVERSHOOT] > 0.0,
        through_glare: false,
        is_whole: hypothesis.is_whole(),
    })
}

/// Returns the ellipse of a fit; for quadrants their given ellipse, moved to the saddle point.
fn fitted_ellipse(hypothesis: &Hypothesis, m: &MarkerParameters) -> Ellipse {
    let centre = Vector2::new(m[X], m[Y]);
    if hypothesis.pattern != MarkerPattern::Disc {
        return Ellipse {
            centre,
            ..hypothesis.ellipse
        };
    }
    let (major, minor) = (m[MAJOR].max(m[MINOR]), m[MINOR].min(m[MAJOR]));
    let turn = if m[MAJOR] >= m[MINOR] { 0.0 } else { FRAC_PI_2 };
    Ellipse {
        centre,
        major,
        minor,
        angle: wrap_half_turn(m[ANGLE] + turn),
    }
}

/// Checks whether a fitted ellipse can be that of a marker and enough of it is visible.
///
/// # Errors
/// Returns an error if not, with the reason.
fn check_shape(
    image: &Raster,
    hypothesis: &Hypothesis,
    m: &MarkerParameters,
    ellipse: &Ellipse,
) -> Result<(), RejectReason> {
    let moved = (ellipse.centre - hypothesis.ellipse.centre).norm();
    if moved > VERDICT.max_shift.at(hypothesis.ellipse.major) {
        return Err(RejectReason::PoorFit);
    }
    let (extent, last) = (
        ellipse.half_extent(),
        [image.width() - 1, image.height() - 1].map(|v| v as f64),
    );
    let (low, high) = (ellipse.centre - extent, ellipse.centre + extent);
    if (0..2).any(|k| low[k] < 0.5 || high[k] > last[k] - 0.5) {
        return Err(RejectReason::TouchesEdge);
    }
    if ellipse.major < VERDICT.min_axes_px[0] || ellipse.minor < VERDICT.min_axes_px[1] {
        return Err(RejectReason::TooSmall);
    }
    let is_disc = hypothesis.pattern == MarkerPattern::Disc;
    let lopsided = is_disc && m[TAPER].abs() > IMPROBABLE_SIGMAS * PRIOR.taper;
    let flattest = if is_disc {
        VERDICT.max_axis_ratio
    } else {
        VERDICT.max_axis_ratio_quadrants
    };
    if lopsided || ellipse.major > flattest * ellipse.minor {
        return Err(RejectReason::NotAnEllipse);
    }
    let is_lit = |at: Vector2<f64>| hypothesis.glare().any(|b| b.contains(&at));
    // Edges that only point at their crossing determine it less precisely than their covariance states.
    let crossing = !is_disc && is_lit(ellipse.centre);
    let hidden = || {
        hypothesis.is_in_glare() && ellipse.outline_fraction(|at| is_lit(*at)) > PRIOR.max_hidden
    };
    if crossing || hidden() {
        Err(RejectReason::GlareOccluded)
    } else {
        Ok(())
    }
}

/// Returns whether quadrants are not those of a target. Quadrants with a known outline are not checked.
fn is_other_pattern(
    image: &Raster,
    hypothesis: &Hypothesis,
    m: &MarkerParameters,
    ellipse: &Ellipse,
) -> bool {
    let known = hypothesis.prior.blur.is_some() || hypothesis.prior.size.is_some();
    hypothesis.edges.filter(|_| !known).is_some_and(|edges| {
        !ends_in_arcs(image, hypothesis.pattern, ellipse, edges.along_rad, m)
            || have_corners(image, hypothesis.pattern, ellipse, m)
    })
}

/// Returns the centre's covariance, px^2: that of the fit and, for a disc, the contributions of curved skin and glare.
fn centre_covariance(hypothesis: &Hypothesis, fit: &MarkerFit, ellipse: &Ellipse) -> Covariance {
    let m = &fit.parameters;
    let mut out = Covariance::from_fit(
        fit.covariance.fixed_view::<2, 2>(X, X).into_owned(),
        fit.white,
    );
    // Glare does not cover an accepted crossing.
    if hypothesis.pattern != MarkerPattern::Disc {
        return out;
    }
    let axis = Vector2::new(m[ANGLE].cos(), m[ANGLE].sin());
    out.add_along(
        CovarianceSource::CurvedSkin,
        axis,
        (VERDICT.decal_stretch * m[SAG]).powi(2),
    );
    if hypothesis.is_in_glare() {
        // Both edges of a thin disc lie in the same light.
        let by = if hypothesis.prior.has_full_size() {
            VERDICT.residual_fringe_px
        } else {
            VERDICT.fringe_px
        };
        let (along, across) = (
            ellipse.major_direction(),
            by * (ellipse.minor / VERDICT.uniform_light_px).min(1.0),
        );
        let extra_along = by.powi(2) - across.powi(2);
        let fringe = Matrix2::identity() * across.powi(2) + along * along.transpose() * extra_along;
        out.add(CovarianceSource::GlareFringe, fringe);
    }
    out
}

/// Returns the largest acceptable standard deviation of a centre, px. It is larger for a partly visible outline or one in
/// uneven light, and for a marker of which everything but the position is predicted, because their covariance accounts for
/// it.
fn max_centre_sigma(hypothesis: &Hypothesis, ellipse: &Ellipse) -> f64 {
    let (limit, factor) = match (hypothesis.prior.size, hypothesis.pattern) {
        (Some(_), MarkerPattern::Disc) => (VERDICT.max_sigma_predicted_px, 2.0),
        // Edges that only point at their crossing.
        (Some(_), _) => (VERDICT.max_sigma_crossing_px, 1.0),
        (None, _) => (VERDICT.max_sigma_px, 1.0),
    };
    let most = if hypothesis.is_whole() && !hypothesis.is_painted() {
        factor * (VERDICT.max_relative_sigma_whole * ellipse.major).max(VERDICT.min_sigma_limit_px)
    } else {
        limit
    };
    most.min(VERDICT.max_relative_sigma * ellipse.major)
        .min(limit)
}
