//! Narrow quadrants, by edges and outline together ([`crate::detect::appearance::quadrants`]), for blur mixes what lies at the one with what
//! lies at the other.

use nalgebra::{Matrix2, Vector2};

use super::gauss_newton::{MarkerFit, fit_final, fit_coarse};
use super::prior::FitUnknowns;
use crate::detect::appearance::parameters::{
    ANGLE, ASIDE, BEND, BLUR, CHORD, DARK, GAMMA, HALO, LENGTH, LIGHT, N, OUTLINE, OVERSHOOT, MarkerParameters,
    MarkerPattern, SHEAR, SKIN, TANGENT, X, Y, contrast,
};
use crate::detect::estimate::options::{OUTLINED, PRIOR};
use crate::detect::hypothesis::{EdgePair, Hypothesis, prior::PriorValue};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::image::scanline::{EllipseFrame, columns, row_of};
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::{PixelKind, Pixels, Sorter};
use crate::detect::simd::batch::Batch;
use crate::raster::Raster;

/// A hypothesis's first parameters: its geometry, with grey levels and blur of `m`, and the skin's grey level.
pub fn initial_parameters(hypothesis: &Hypothesis, m: &MarkerParameters, skin: f64) -> Option<MarkerParameters> {
    let (ellipse, EdgePair { along_rad: angle, tangent }) = (hypothesis.ellipse, hypothesis.edges?);
    let mut out = [0.0; N];
    (out[X], out[Y], out[ANGLE], out[TANGENT]) = (ellipse.centre.x, ellipse.centre.y, angle, tangent);
    let (sin, cos) = (ellipse.angle - angle).sin_cos();
    let (major2, minor2) = (ellipse.major.powi(2), ellipse.minor.powi(2));
    out[LENGTH] = (major2 * cos * cos + minor2 * sin * sin).sqrt();
    out[CHORD] = ellipse.major * ellipse.minor / out[LENGTH].max(TINY);
    out[SHEAR] = (major2 - minor2) * sin * cos / out[LENGTH].powi(2).max(TINY);
    (out[BLUR], out[LIGHT], out[DARK], out[GAMMA]) = (m[BLUR], m[LIGHT], m[DARK], PRIOR.gamma.value);
    (out[OVERSHOOT], out[HALO]) = (m[OVERSHOOT], m[HALO]);
    out[SKIN] = (skin / m[LIGHT]).max(0.0).powf(1.0 / PRIOR.gamma.value);
    Some(out)
}

/// What is sought of narrow quadrants with a blur, px.
fn quadrant_unknowns(blur: PriorValue) -> FitUnknowns {
    let mut prior = [PriorValue::UNKNOWN; N];
    prior[GAMMA] = PRIOR.gamma;
    prior[BLUR] = blur;
    prior[ASIDE..ASIDE + 2].fill(PriorValue::zero(OUTLINED.aside_px));
    let mut free = [false; N];
    for k in [X, Y, ANGLE, TANGENT, BLUR, LIGHT, DARK].into_iter().chain(OUTLINE..N) {
        free[k] = true;
    }
    FitUnknowns { free, prior }
}

/// Quadrants with outline and edges from both together, and all their parameters, from first ones; `None` where that does not
/// settle near them.
pub fn refine_quadrants(
    image: &Raster,
    hypothesis: &Hypothesis,
    start: MarkerParameters,
    blur: PriorValue,
) -> Option<(Hypothesis, MarkerParameters)> {
    if start[LENGTH] < OUTLINED.min_major_px || contrast(&start) < OUTLINED.min_contrast {
        return None;
    }
    let unknowns = quadrant_unknowns(blur);
    let mut m = start;
    for _ in 0..OUTLINED.max_rounds {
        let ellipse = outline_from_parameters(&m);
        let pixels = sample_pixels(image, hypothesis.pattern, &ellipse, m[BLUR], OUTLINED.coarse_px)?;
        let scale;
        (m, scale) = fit_coarse(&pixels, &m, &unknowns, OUTLINED.min_scale * contrast(&m))?;
        let now = outline_from_parameters(&m);
        if now.major < OUTLINED.max_growth * ellipse.major && now.minor < OUTLINED.max_growth * ellipse.minor {
            let edges = Some(EdgePair { along_rad: m[ANGLE], tangent: m[TANGENT] });
            let found = Hypothesis { ellipse: now, edges, ..hypothesis.clone() };
            return (scale < OUTLINED.max_scale * contrast(&m)).then_some((found, m));
        }
    }
    None
}

/// The answer for quadrants whose outline and edges are known: the fit of all pixels in and about them, with bends and planes
/// of light and darkness; those pixels, and what was sought.
pub fn fit_quadrants(
    image: &Raster,
    hypothesis: &Hypothesis,
    m: &MarkerParameters,
    scale: f64,
    floor: f64,
) -> Option<(Pixels, MarkerFit, FitUnknowns)> {
    let pixels = sample_pixels(image, hypothesis.pattern, &hypothesis.ellipse, m[BLUR], OUTLINED.final_px)?;
    let mut unknowns = quadrant_unknowns(PriorValue::UNKNOWN);
    for k in [BEND, BEND + 1, LIGHT + 1, LIGHT + 2, DARK + 1, DARK + 2] {
        unknowns.free[k] = true;
    }
    for k in [BEND, BEND + 1] {
        unknowns.prior[k] = PriorValue::zero(OUTLINED.bend / m[LENGTH]);
    }
    for k in [DARK + 1, DARK + 2] {
        unknowns.prior[k] = PriorValue::zero(OUTLINED.dark);
    }
    let found = fit_final(&pixels, m, scale, &unknowns, floor)?;
    Some((pixels, found, unknowns))
}

/// Whether the white of narrow quadrants is lighter than the skin: between two discs in a row it is the skin itself.
pub fn has_white(m: &MarkerParameters) -> bool {
    let skin = m[SKIN].max(0.0).powf(m[GAMMA]);
    1.0 - skin > OUTLINED.whiter * contrast(m) / m[LIGHT].max(1.0)
}

/// The outline of parameters.
fn outline_from_parameters(m: &MarkerParameters) -> Ellipse {
    let (sin, cos) = m[ANGLE].sin_cos();
    let (along, across) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
    let centre = Vector2::new(m[X], m[Y]) + along * m[ASIDE] + across * m[ASIDE + 1];
    let half = (along + across * m[SHEAR]) * m[LENGTH];
    let chord = across * m[CHORD];
    let moments: Matrix2<f64> = half * half.transpose() + chord * chord.transpose();
    Ellipse::from_moments(centre, moments, 1.0)
}

/// Some of the pixels in and about an outline.
fn sample_pixels(image: &Raster, pattern: MarkerPattern, ellipse: &Ellipse, blur: f64, wanted: f64) -> Option<Pixels> {
    let (centre, margin) = (ellipse.centre, OUTLINED.beyond.0 * blur + OUTLINED.beyond.1);
    let origin = [centre.x.round(), centre.y.round()];
    let about = ellipse.larger(OUTLINED.larger, 0.0);
    let (frame, own) = (EllipseFrame::new(&about), EllipseFrame::new(ellipse));
    let (rows, inner) = (Some(frame.grown(margin)?), Some(own.grown(blur)?));
    let count = std::f64::consts::PI * (about.major + margin) * (about.minor + margin);
    let step = (count / wanted).round().clamp(1.0, OUTLINED.max_step) as usize;
    // Those of a row lie in the gaps of the rows beside it.
    let shift = (OUTLINED.row_shift * (step * OUTLINED.outside_step) as f64).round() as usize;
    let (width, height) = (image.width(), image.height());
    let area = [0, 0, width - 1, height - 1];
    let reach = about.extent().y + margin;
    let lines = (centre.y - reach).max(0.0) as usize..((centre.y + reach).max(0.0) as usize + 1).min(height);
    let mut sorter = Sorter::new(pattern, origin);
    let mut batch = Batch::new();
    for y in lines {
        let Some((from, to)) = row_of(&rows, y as f64) else { continue };
        let inside = row_of(&inner, y as f64).map_or(0..0, |(from, to)| columns(from, to, area));
        for x in columns(from, to, area) {
            let turn = x + y * shift;
            let step = if inside.contains(&x) { step } else { step * OUTLINED.outside_step };
            let Some(&value) = image.row(y).get(x).filter(|_| turn.is_multiple_of(step)) else { continue };
            batch.len = 0;
            batch.push((x as f64 - origin[0]) as f32, (y as f64 - origin[1]) as f32, f32::from(value));
            let (s, t) = ellipse.local(Vector2::new(x as f64, y as f64));
            (batch.p[0], batch.q[0]) = ((s / ellipse.major) as f32, (t / ellipse.minor) as f32);
            batch.root[0] = 1.0;
            sorter.push(PixelKind::Integrated, &batch, 0);
        }
    }
    let mut out = sorter.finish();
    out.outlined = true;
    Some(out)
}
