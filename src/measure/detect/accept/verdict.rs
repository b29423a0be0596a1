//! A fit is a marker with its accuracy, or is turned down with a reason.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix2, Vector2};

use super::pattern::{ends_in_arcs, have_corners};
use crate::detect::accept::options::VERDICT;
use crate::detect::appearance::parameters::{
    ANGLE, BLUR, DARK, LIGHT, MAJOR, MINOR, OVERSHOOT, MarkerParameters, MarkerPattern, SAG, TAPER, X, Y, contrast,
};
use crate::detect::detection::covariance::{Covariance, CovarianceSource};
use crate::detect::detection::{Detection, RejectReason};
use crate::detect::estimate::{gauss_newton::MarkerFit, options::PRIOR};
use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::ellipse::{Ellipse, half_turn};
use crate::detect::image::noise;
use crate::raster::Raster;
use crate::setup::Shape;

/// Whether residuals, root mean square, are larger than a marker's with the frame's noise and, of a disc, with that about it,
/// grey levels. What the formula leaves of a marker was sharpened with the picture, by one and the `overshoot`, a ratio.
pub fn fits_poorly(
    image: &Raster,
    hypothesis: &Hypothesis,
    rms: f64,
    noise: f64,
    (contrast, overshoot): (f64, f64),
) -> bool {
    let own = VERDICT.poor.1 * contrast * (1.0 + overshoot.max(0.0));
    let is_larger = |noise: f64| rms > VERDICT.poor.0 * noise + own;
    // Letters, which are their own noise, are taken for quadrants rather than for discs.
    if hypothesis.pattern == MarkerPattern::Disc {
        is_larger(noise.max(VERDICT.lost_noise)) && is_larger(noise::about(image, &hypothesis.ellipse))
    } else {
        is_larger(noise)
    }
}

/// A fitted marker with its blur.
#[derive(Clone)]
pub struct MeasuredMarker {
    /// The answer.
    pub detection: Detection,
    /// Blur of its edges, pixel included, px.
    pub blur: f64,
    /// Contrast over the grey of white or skin.
    pub darkness: f64,
    /// Share of the light that black takes away.
    pub dark: f64,
    /// The centre's variance from blocks of residuals over that of the fit.
    pub correlation: f64,
    /// Standard deviation of a disc's semi-major axis, px; 0 of quadrants.
    pub length: f64,
    /// Whether its residuals are no noise alone: they hang together, or are those of a sharpened picture.
    pub is_systematic: bool,
    /// Whether glare lies over it, through which it was measured.
    pub through_glare: bool,
    /// Whether no part of it was taken for hidden.
    pub is_whole: bool,
}

impl MeasuredMarker {
    /// Whether its place is told so well that nothing can hide much of it.
    pub fn is_sure(&self) -> bool {
        self.detection.variance() < VERDICT.sure_px2
    }

    /// A whole marker of a test.
    #[cfg(test)]
    pub fn whole(detection: Detection) -> Self {
        let (blur, darkness, dark, correlation, length) = (1.5, 0.6, 0.87, 1.0, 0.0);
        let (is_systematic, through_glare, is_whole) = (false, false, true);
        Self { detection, blur, darkness, dark, correlation, length, is_systematic, through_glare, is_whole }
    }
}

/// A marker, or why there is none.
pub type MeasurementResult = Result<MeasuredMarker, RejectReason>;

/// Accepts or turns down a fit.
pub fn judge_fit(image: &Raster, hypothesis: &Hypothesis, fit: &MarkerFit, noise: f64) -> MeasurementResult {
    let m = &fit.parameters;
    let contrast = contrast(m);
    let ellipse = fitted_ellipse(hypothesis, m);
    check_shape(image, hypothesis, m, &ellipse)?;
    if m[DARK] < VERDICT.least_dark || contrast < VERDICT.least_contrast.max(VERDICT.over_noise * noise) {
        return Err(RejectReason::LowContrast);
    }
    if m[BLUR] > VERDICT.softest_px
        || fit.inliers < VERDICT.inliers
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
            shape: if is_disc { Shape::Circle } else { Shape::Quadrant },
            centre_px: ellipse.centre,
            covariance_px2: covariance,
            semi_major_px: ellipse.major,
            semi_minor_px: ellipse.minor,
            angle_rad: ellipse.angle,
            fit_rms: fit.rms,
            contrast,
        },
        blur: m[BLUR],
        darkness: contrast / m[LIGHT].max(1.0),
        dark: m[DARK],
        correlation: fit.correlation,
        length: if is_disc { fit.covariance[(MAJOR, MAJOR)].max(0.0).sqrt() } else { 0.0 },
        is_systematic: fit.is_systematic || m[OVERSHOOT] > 0.0,
        through_glare: false,
        is_whole: hypothesis.is_whole(),
    })
}

/// The ellipse of a fit; of quadrants the one that they had, about their saddle.
fn fitted_ellipse(hypothesis: &Hypothesis, m: &MarkerParameters) -> Ellipse {
    let centre = Vector2::new(m[X], m[Y]);
    if hypothesis.pattern != MarkerPattern::Disc {
        return Ellipse { centre, ..hypothesis.ellipse };
    }
    let (major, minor) = (m[MAJOR].max(m[MINOR]), m[MINOR].min(m[MAJOR]));
    let turn = if m[MAJOR] >= m[MINOR] { 0.0 } else { FRAC_PI_2 };
    Ellipse { centre, major, minor, angle: half_turn(m[ANGLE] + turn) }
}

/// Whether a fitted ellipse may be a marker's, and enough of it shows.
fn check_shape(
    image: &Raster,
    hypothesis: &Hypothesis,
    m: &MarkerParameters,
    ellipse: &Ellipse,
) -> Result<(), RejectReason> {
    let moved = (ellipse.centre - hypothesis.ellipse.centre).norm();
    if moved > VERDICT.moved.0 * hypothesis.ellipse.major + VERDICT.moved.1 {
        return Err(RejectReason::PoorFit);
    }
    let (extent, last) = (ellipse.extent(), [image.width() - 1, image.height() - 1].map(|v| v as f64));
    let (low, high) = (ellipse.centre - extent, ellipse.centre + extent);
    if (0..2).any(|k| low[k] < VERDICT.rim_px || high[k] > last[k] - VERDICT.rim_px) {
        return Err(RejectReason::TouchesEdge);
    }
    if ellipse.major < VERDICT.least_px[0] || ellipse.minor < VERDICT.least_px[1] {
        return Err(RejectReason::TooSmall);
    }
    let is_disc = hypothesis.pattern == MarkerPattern::Disc;
    let lopsided = is_disc && m[TAPER].abs() > VERDICT.lopsided * PRIOR.taper;
    let flattest = if is_disc { VERDICT.flattest } else { VERDICT.flattest_quadrants };
    if lopsided || ellipse.major > flattest * ellipse.minor {
        return Err(RejectReason::NotAnEllipse);
    }
    let is_lit = |at: Vector2<f64>| hypothesis.glare().any(|b| b.contains(&at));
    // Edges that only point at their crossing tell it worse than they say.
    let crossing = !is_disc && is_lit(ellipse.centre);
    let hidden = || hypothesis.is_in_glare() && ellipse.share(|at| is_lit(*at)) > VERDICT.hidden_by_glare;
    if crossing || hidden() { Err(RejectReason::GlareOccluded) } else { Ok(()) }
}

/// Whether quadrants are none of a target's, where their outline is not known beforehand.
fn is_other_pattern(image: &Raster, hypothesis: &Hypothesis, m: &MarkerParameters, ellipse: &Ellipse) -> bool {
    let known = hypothesis.prior.blur.is_some() || hypothesis.prior.size.is_some();
    hypothesis.edges.filter(|_| !known).is_some_and(|edges| {
        !ends_in_arcs(image, hypothesis.pattern, ellipse, edges.along_rad, m)
            || have_corners(image, hypothesis.pattern, ellipse, m)
    })
}

/// The centre's covariance, px^2: the fit's, and of a disc what curved skin and glare add.
fn centre_covariance(hypothesis: &Hypothesis, fit: &MarkerFit, ellipse: &Ellipse) -> Covariance {
    let m = &fit.parameters;
    let mut out = Covariance::of_fit(fit.covariance.fixed_view::<2, 2>(X, X).into_owned(), fit.white);
    out.add(CovarianceSource::Beside, fit.foreign_covariance);
    // A crossing lies where glare does not.
    if hypothesis.pattern != MarkerPattern::Disc {
        return out;
    }
    let axis = Vector2::new(m[ANGLE].cos(), m[ANGLE].sin());
    out.add_along(CovarianceSource::CurvedSkin, axis, (VERDICT.laid * m[SAG]).powi(2));
    if hypothesis.is_in_glare() {
        // Both edges of a thin disc lie in the same light.
        let by =
            if hypothesis.prior.tells_all_of_size() { VERDICT.rest_of_fringe_px } else { VERDICT.fringe_px };
        let (along, across) = (ellipse.axis(), by * (ellipse.minor / VERDICT.even_px).min(1.0));
        let along_too = by.powi(2) - across.powi(2);
        let doubt = Matrix2::identity() * across.powi(2) + along * along.transpose() * along_too;
        out.add(CovarianceSource::GlareFringe, doubt);
    }
    out
}

/// The standard deviation of a centre beyond which a place is too uncertain, px. A part of an outline, or one in uneven light,
/// tells the centre less well, and says so; so does what is hardly seen, of which all is known but the place.
fn max_centre_sigma(hypothesis: &Hypothesis, ellipse: &Ellipse) -> f64 {
    let (vaguest, vaguer) = match (hypothesis.prior.size, hypothesis.pattern) {
        (Some(_), MarkerPattern::Disc) => (VERDICT.vaguest_predicted_px, VERDICT.predicted),
        // Edges that only point at their crossing.
        (Some(_), _) => (VERDICT.vaguest_crossing_px, 1.0),
        (None, _) => (VERDICT.vaguest_px, 1.0),
    };
    let most = if hypothesis.is_whole() && !hypothesis.is_painted() {
        vaguer * (VERDICT.vaguest_whole.0 * ellipse.major).max(VERDICT.vaguest_whole.1)
    } else {
        vaguest
    };
    most.min(VERDICT.vaguest * ellipse.major).min(vaguest)
}
