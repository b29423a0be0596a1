//! A fit is a marker with its accuracy, or is turned down with a reason.

use nalgebra::{Matrix2, Vector2};

use super::pattern::{ends_in_arcs, have_corners};
use crate::measure::detect::appearance::parameters::{
    ANGLE, BLUR, DARK, FIRST, LIGHT, Pattern, SECOND, TAPER, THIRD, X, Y, contrast,
};
use crate::measure::detect::detection::{Detection, RejectReason};
use crate::measure::detect::estimate::gauss_newton::Fit;
use crate::measure::detect::estimate::prior::TAPER_SPREAD;
use crate::measure::detect::hypothesis::Hypothesis;
use crate::measure::detect::image::ellipse::{Ellipse, half_turn};
use crate::measure::detect::image::noise;
use crate::measure::raster::Raster;
use crate::measure::setup::Shape;

/// How a decal lies on a curved skin is not known: stretched or not, it differs along the marker by
/// the sag times the skin's slope, for which one in fourteen stands.
const LAID: f64 = 0.07;
/// Share of the outline that glare may hide; and what its fringe, up to a tenth of the skin's light before it is seen,
/// does to the edges beside it, px: about a tenth of an edge's width.
const DROWNED: f64 = 0.64;
const VEIL_PX: f64 = 0.1;
/// The same where most of the fringe is left out, or measured.
const VEIL_LEFT_PX: f64 = 0.06;
/// Semi-minor axis below which that shifts a disc less across its axis, px.
const EVEN: f64 = 20.0;
/// Greatest standard deviation of a centre, px: of any, and of one whose length its like predict, so that no more than
/// the place along it is in doubt; of quadrants whose outline is predicted.
const VAGUEST: f64 = 2.0;
const VAGUEST_FORETOLD: f64 = 2.5;
const VAGUEST_CROSSING: f64 = 0.5;
/// Axis ratio of the flattest ellipse that is taken for a marker: seen from a metre above the skin, discs are 1:28 on a wing
/// that bends downwards, and seams are far flatter.
const FLATTEST: f64 = 40.0;
/// That of quadrants, which are nearer: flatter ones are two discs side by side.
const FLATTEST_QUADRANTS: f64 = 26.0;
/// Greatest blur that is measured, px.
pub const SOFTEST: f64 = 3.2;
/// What noise may be at edges, grey levels, where JPEG has left none of it beside them.
const LOST: f64 = 1.0;

/// Whether residuals, root mean square, are larger than a marker's with the frame's noise and, of a disc, with that about it,
/// grey levels.
pub fn fits_poorly(image: &Raster, hypothesis: &Hypothesis, rms: f64, noise: f64, contrast: f64) -> bool {
    let is_larger = |noise: f64| rms > 1.6 * noise + 0.05 * contrast;
    // Letters, which are their own noise, are taken for quadrants rather than for discs.
    if hypothesis.pattern == Pattern::Disc {
        is_larger(noise.max(LOST)) && is_larger(noise::about(image, &hypothesis.ellipse))
    } else {
        is_larger(noise)
    }
}

/// A fitted marker with its blur.
#[derive(Clone)]
pub struct Measured {
    /// The answer.
    pub detection: Detection,
    /// Blur of its edges, pixel included, px.
    pub blur: f64,
    /// Contrast over the grey of white or skin.
    pub darkness: f64,
    /// The centre's variance from blocks of residuals over that of the fit.
    pub correlation: f64,
    /// The centre's covariance if no residuals hung together, px^2.
    pub white: Matrix2<f64>,
    /// Standard deviation of a disc's semi-major axis, px; 0 of quadrants.
    pub length: f64,
    /// Whether glare lies over it, through which it was measured.
    pub through_glare: bool,
    /// Whether no part of it was taken for hidden.
    pub is_whole: bool,
}

impl Measured {
    /// Whether its place is told so well that nothing can hide much of it.
    pub fn is_sure(&self) -> bool {
        self.detection.variance() < 0.1
    }

    /// A whole marker of a test.
    #[cfg(test)]
    pub fn whole(detection: Detection) -> Self {
        let white = Matrix2::identity();
        let (blur, darkness, correlation, length) = (1.5, 0.6, 1.0, 0.0);
        Self { detection, blur, darkness, correlation, white, length, through_glare: false, is_whole: true }
    }
}

/// Accepts or turns down a fit.
pub fn judge(
    image: &Raster,
    hypothesis: &Hypothesis,
    fit: &Fit,
    noise: f64,
) -> Result<Measured, RejectReason> {
    let m = &fit.parameters;
    let contrast = contrast(m);
    let ellipse = match hypothesis.pattern {
        Pattern::Disc => {
            let (centre, angle) = (Vector2::new(m[X], m[Y]), m[ANGLE]);
            let (major, minor, angle) = if m[FIRST] >= m[SECOND] {
                (m[FIRST], m[SECOND], angle)
            } else {
                (m[SECOND], m[FIRST], angle + std::f64::consts::FRAC_PI_2)
            };
            Ellipse { centre, major, minor, angle: half_turn(angle) }
        }
        _ => Ellipse { centre: Vector2::new(m[X], m[Y]), ..hypothesis.ellipse },
    };
    let moved = (ellipse.centre - hypothesis.ellipse.centre).norm();
    if moved > 0.25 * hypothesis.ellipse.major + 2.0 {
        return Err(RejectReason::PoorFit);
    }
    let extent = ellipse.extent();
    let (w, h) = (image.width() as f64, image.height() as f64);
    let c = ellipse.centre;
    if c.x - extent.x < 0.5 || c.y - extent.y < 0.5 || c.x + extent.x > w - 1.5 || c.y + extent.y > h - 1.5 {
        return Err(RejectReason::TouchesEdge);
    }
    if ellipse.minor < 0.8 || ellipse.major < 3.5 {
        return Err(RejectReason::TooSmall);
    }
    let lopsided = hypothesis.pattern == Pattern::Disc && m[TAPER].abs() > 4.0 * TAPER_SPREAD;
    let flattest = if hypothesis.pattern == Pattern::Disc { FLATTEST } else { FLATTEST_QUADRANTS };
    if lopsided || ellipse.major > flattest * ellipse.minor {
        return Err(RejectReason::NotAnEllipse);
    }
    let glare = hypothesis.is_in_glare();
    let is_lit = |at: Vector2<f64>| hypothesis.glare().any(|b| b.holds(&at));
    // Edges that only point at their crossing tell it worse than they say.
    let crossing = hypothesis.pattern != Pattern::Disc && is_lit(ellipse.centre);
    if crossing || glare && ellipse.share(|at| is_lit(*at)) > DROWNED {
        return Err(RejectReason::GlareOccluded);
    }
    if m[DARK] < 0.15 || contrast < 8.0 || contrast < 4.0 * noise {
        return Err(RejectReason::LowContrast);
    }
    if m[BLUR] > SOFTEST || fit.inliers < 0.55 || fits_poorly(image, hypothesis, fit.rms, noise, contrast) {
        return Err(RejectReason::PoorFit);
    }
    let edges =
        hypothesis.edges.filter(|_| hypothesis.prior.blur.is_none() && hypothesis.prior.size.is_none());
    let is_other = |edges: (f64, f64)| {
        !ends_in_arcs(image, hypothesis.pattern, &ellipse, edges.0, m)
            || have_corners(image, hypothesis.pattern, &ellipse, m)
    };
    if edges.is_some_and(is_other) {
        return Err(RejectReason::Pattern);
    }
    let mut covariance = fit.covariance.fixed_view::<2, 2>(0, 0).into_owned();
    if hypothesis.pattern == Pattern::Disc {
        let axis = Vector2::new(m[ANGLE].cos(), m[ANGLE].sin());
        covariance += axis * axis.transpose() * (LAID * m[THIRD]).powi(2);
    }
    // A crossing lies where glare does not.
    if glare && hypothesis.pattern == Pattern::Disc {
        // Both edges of a thin disc lie in the same light.
        let veil = if hypothesis.prior.tells_all_of_size() { VEIL_LEFT_PX } else { VEIL_PX };
        let (along, across) = (ellipse.axis(), veil * (ellipse.minor / EVEN).min(1.0));
        let along_too = veil.powi(2) - across.powi(2);
        covariance += Matrix2::identity() * across.powi(2) + along * along.transpose() * along_too;
    }
    let spread = (covariance[(0, 0)] + covariance[(1, 1)]).sqrt();
    // A part of an outline, or one in uneven light, tells the centre less well, and says so; so does what is hardly seen, of
    // which all is known but the place.
    let (vaguest, vaguer) = match (hypothesis.prior.size, hypothesis.pattern) {
        (Some(_), Pattern::Disc) => (VAGUEST_FORETOLD, 2.0),
        // Edges that only point at their crossing.
        (Some(_), _) => (VAGUEST_CROSSING, 1.0),
        (None, _) => (VAGUEST, 1.0),
    };
    let most = if hypothesis.is_whole() { vaguer * (0.02 * ellipse.major).max(0.6) } else { vaguest };
    let most = most.min(0.05 * ellipse.major).min(vaguest);
    if !(spread > 0.0 && spread < most) {
        return Err(RejectReason::Uncertain);
    }
    Ok(Measured {
        detection: Detection {
            shape: if hypothesis.pattern == Pattern::Disc { Shape::Circle } else { Shape::Quadrant },
            centre_px: ellipse.centre,
            covariance_px2: Matrix2::from_fn(|i, j| covariance[(i, j)]),
            beside_px2: 0.0,
            semi_major_px: ellipse.major,
            semi_minor_px: ellipse.minor,
            angle_rad: ellipse.angle,
            fit_rms: fit.rms,
            contrast,
        },
        blur: m[BLUR],
        darkness: contrast / m[LIGHT].max(1.0),
        correlation: fit.correlation,
        white: fit.white,
        length: if hypothesis.pattern == Pattern::Disc {
            fit.covariance[(FIRST, FIRST)].max(0.0).sqrt()
        } else {
            0.0
        },
        through_glare: false,
        is_whole: hypothesis.is_whole(),
    })
}
