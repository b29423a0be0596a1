//! Start of a measurement: first parameters and coarse fit.

use nalgebra::Vector2;

use crate::detect::appearance::parameters::{
    ANGLE, BLUR, DARK, GAMMA, LIGHT, MAJOR, MINOR, MarkerParameters, N, TANGENT, X, Y,
};
use crate::detect::attempt::options::MEASURE;
use crate::detect::detection::{Overshoot, RejectReason};
use crate::detect::estimate::gauss_newton::fit_coarse;
use crate::detect::estimate::options::PRIOR;
use crate::detect::estimate::overshoot;
use crate::detect::estimate::prior::{coarse_unknowns, darkness_for_grey_ratio};
use crate::detect::hypothesis::{EdgePair, Hypothesis};
use crate::detect::image::histogram::Histogram;
use crate::detect::propose::reduced::ReducedImage;
use crate::detect::sample::pixels::Pixels;
use crate::detect::sample::select::{
    COARSE, EdgeAppearance, PixelBudget, PixelExclusion, select_pixels,
};
use crate::raster::Raster;

/// Selects pixels and makes a coarse fit. Returns the parameters and the scale of the residuals, grey levels.
///
/// # Errors
/// Returns an error if the contrast is too low or the fit does not converge.
pub fn fit_start(
    image: &Raster,
    masked: PixelExclusion,
    hypothesis: &Hypothesis,
    (appearance, sharpened): (EdgeAppearance, Option<Overshoot>),
    budget: PixelBudget,
    floor: f64,
) -> Result<(MarkerParameters, f64), RejectReason> {
    let pixels = select_pixels(image, masked, hypothesis, appearance, budget)
        .ok_or(RejectReason::LowContrast)?;
    let mut start = start_parameters(hypothesis, &pixels, appearance, floor)
        .ok_or(RejectReason::LowContrast)?;
    sharpened
        .iter()
        .for_each(|known| overshoot::set_overshoot_start(known, &mut start));
    fit_coarse(&pixels, &start, &coarse_unknowns(hypothesis), floor)
        .ok_or(RejectReason::NoConvergence)
}

/// Finds the crossing of the edges of large quadrants in a reduced image of them, px.
pub fn crossing_in_reduced(
    image: &Raster,
    hypothesis: &Hypothesis,
    floor: f64,
) -> Option<Vector2<f64>> {
    let small = ReducedImage::from_large_quadrants(image, hypothesis)?;
    let appearance = EdgeAppearance {
        crossing: small.hypothesis.ellipse.centre,
        blur: MEASURE.blur_px,
    };
    // The remaining overshoot in the reduced image hardly shifts a crossing.
    let (m, _) = fit_start(
        &small.image,
        PixelExclusion::Blobs(&[]),
        &small.hypothesis,
        (appearance, None),
        COARSE,
        floor,
    )
    .ok()?;
    Some(small.to_original(Vector2::new(m[X], m[Y])))
}

/// Returns a fit's start parameters: the hypothesis' geometry, grey levels of its pixels; `None` if contrast is low.
fn start_parameters(
    hypothesis: &Hypothesis,
    pixels: &Pixels,
    appearance: EdgeAppearance,
    floor: f64,
) -> Option<MarkerParameters> {
    let ellipse = &hypothesis.ellipse;
    let mut m = [0.0; N];
    m[X] = appearance.crossing.x;
    m[Y] = appearance.crossing.y;
    match hypothesis.edges {
        None => {
            m[ANGLE] = ellipse.angle;
            m[MAJOR] = ellipse.major;
            m[MINOR] = ellipse.minor;
        }
        Some(EdgePair { along_rad, tangent }) => {
            m[ANGLE] = along_rad;
            m[TANGENT] = tangent.max(MEASURE.min_tangent);
        }
    }
    m[BLUR] = appearance.blur;
    let greys = pixels
        .batches
        .iter()
        .flat_map(|b| b.value.iter().take(b.len).map(|&v| v as u8));
    let count = Histogram::from_values(greys);
    let total = count.total();
    if total < MEASURE.min_pixels {
        return None;
    }
    let at = |rank: usize| count.value_at_rank(rank).map(|grey| grey as f64);
    let (low, high) = (at(total / 40)?, at(total * 8 / 10)?);
    m[LIGHT] = high.max(1.0);
    m[GAMMA] = PRIOR.gamma.value;
    m[DARK] = darkness_for_grey_ratio(low.max(1.0) / high.max(1.0));
    (m[DARK] > MEASURE.min_start_darkness
        && high - low > MEASURE.min_start_step + MEASURE.spread_by_noise * floor)
        .then_some(m)
}
