//! Fit of narrow quadrants by edges and outline jointly ([`crate::detect::appearance::quadrants`]), because blur mixes the
//! two.

use nalgebra::{Matrix2, Vector2};

use super::gauss_newton::{MarkerFit, fit_coarse, fit_final};
use super::prior::FitUnknowns;
use crate::detect::appearance::parameters::{
    ANGLE, BEND, BLUR, CHORD, DARK, GAMMA, HALO, LENGTH, LIGHT, MarkerParameters, MarkerPattern, N,
    OFFSET, OUTLINE, OVERSHOOT, SHEAR, SKIN, TANGENT, X, Y, grey_contrast,
};
use crate::detect::estimate::options::{OUTLINED, PRIOR};
use crate::detect::hypothesis::{EdgePair, Hypothesis, prior::PriorValue};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::image::scanline::{EllipseFrame, columns_in_area, row_interval};
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::{PixelKind, Pixels, Sorter};
use crate::detect::simd::batch::Batch;
use crate::raster::Raster;

/// Returns the first parameters of a hypothesis: its geometry, the grey levels and blur of `m`, and the grey level of the
/// skin. `None` if the hypothesis has no edges.
pub fn initial_parameters(
    hypothesis: &Hypothesis,
    m: &MarkerParameters,
    skin: f64,
) -> Option<MarkerParameters> {
    let (
        ellipse,
        EdgePair {
            along_rad: angle,
            tangent,
        },
    ) = (hypothesis.ellipse, hypothesis.edges?);
    let mut out = [0.0; N];
    (out[X], out[Y], out[ANGLE], out[TANGENT]) =
        (ellipse.centre.x, ellipse.centre.y, angle, tangent);
    let (sin, cos) = (ellipse.angle - angle).sin_cos();
    let (major2, minor2) = (ellipse.major.powi(2), ellipse.minor.powi(2));
    out[LENGTH] = (major2 * cos * cos + minor2 * sin * sin).sqrt();
    out[CHORD] = ellipse.major * ellipse.minor / out[LENGTH].max(TINY);
    out[SHEAR] = (major2 - minor2) * sin * cos / out[LENGTH].powi(2).max(TINY);
    (out[BLUR], out[LIGHT], out[DARK], out[GAMMA]) =
        (m[BLUR], m[LIGHT], m[DARK], PRIOR.gamma.value);
    (out[OVERSHOOT], out[HALO]) = (m[OVERSHOOT], m[HALO]);
    out[SKIN] = (skin / m[LIGHT]).max(0.0).powf(1.0 / PRIOR.gamma.value);
    Some(out)
}

/// Returns the free parameters of narrow quadrants and their priors, given the prior of the blur, px.
fn quadrant_unknowns(blur: PriorValue) -> FitUnknowns {
    let mut prior = [PriorValue::UNKNOWN; N];
    prior[GAMMA] = PRIOR.gamma;
    prior[BLUR] = blur;
    prior[OFFSET..OFFSET + 2].fill(PriorValue::zero(OUTLINED.aside_px));
    let mut free = [false; N];
    for k in [X, Y, ANGLE, TANGENT, BLUR, LIGHT, DARK]
        .into_iter()
        .chain(OUTLINE..N)
    {
        free[k] = true;
    }
    FitUnknowns { free, prior }
}

/// Fits outline and edges of quadrants jointly. Returns the refined hypothesis and all its parameters; `None` if the fit
/// does not converge near the first ones.
pub fn refine_quadrants(
    image: &Raster,
    hypothesis: &Hypothesis,
    start: MarkerParameters,
    blur: PriorValue,
) -> Option<(Hypothesis, MarkerParameters)> {
    if start[LENGTH] < OUTLINED.min_major_px || grey_contrast(&start) < OUTLINED.min_contrast {
        return None;
    }
    let unknowns = quadrant_unknowns(blur);
    // Half of the margin of the pixels: beyond it, they are selected again.
    let max_growth = 0.5 + 0.5 * OUTLINED.larger;
    let mut m = start;
    for _ in 0..OUTLINED.max_rounds {
        let ellipse = outline_from_parameters(&m);
        let pixels = sample_pixels(
            image,
            hypothesis.pattern,
            &ellipse,
            m[BLUR],
            OUTLINED.coarse_px,
        )?;
        let scale;
        (m, scale) = fit_coarse(
            &pixels,
            &m,
            &unknowns,
            OUTLINED.min_scale * grey_contrast(&m),
        )?;
        let now = outline_from_parameters(&m);
        if now.major < max_growth * ellipse.major && now.minor < max_growth * ellipse.minor {
            let edges = Some(EdgePair {
                along_rad: m[ANGLE],
                tangent: m[TANGENT],
            });
            let found = Hypothesis {
                ellipse: now,
                edges,
                ..hypothesis.clone()
            };
            return (scale < OUTLINED.max_scale * grey_contrast(&m)).then_some((found, m));
        }
    }
    None
}

/// Fits quadrants of known outline and edges to all pixels in and around them, with bends and with planes of light and
/// darkness. Returns the pixels, the fit and its unknowns.
pub fn fit_quadrants(
    image: &Raster,
    hypothesis: &Hypothesis,
    m: &MarkerParameters,
    scale: f64,
    floor: f64,
) -> Option<(Pixels, MarkerFit, FitUnknowns)> {
    let pixels = sample_pixels(
        image,
        hypothesis.pattern,
        &hypothesis.ellipse,
        m[BLUR],
        OUTLINED.final_px,
    )?;
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

/// Returns true if the white of narrow quadrants is lighter than the skin. Between two discs in a row the apparent white is
/// the skin itself.
pub fn has_white(m: &MarkerParameters) -> bool {
    let skin = m[SKIN].max(0.0).powf(m[GAMMA]);
    1.0 - skin > OUTLINED.whiter * grey_contrast(m) / m[LIGHT].max(1.0)
}

/// Returns the outline described by the parameters.
fn outline_from_parameters(m: &MarkerParameters) -> Ellipse {
    let (sin, cos) = m[ANGLE].sin_cos();
    let (along, across) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
    let centre = Vector2::new(m[X], m[Y]) + along * m[OFFSET] + across * m[OFFSET + 1];
    let half = (along + across * m[SHEAR]) * m[LENGTH];
    let chord = across * m[CHORD];
    let moments: Matrix2<f64> = half * half.transpose() + chord * chord.transpose();
    Ellipse::from_moments(centre, moments, 1.0)
}

/// Selects about `wanted` of the pixels in and around an outline.
fn sample_pixels(
    image: &Raster,
    pattern: MarkerPattern,
    ellipse: &Ellipse,
    blur: f64,
    wanted: f64,
) -> Option<Pixels> {
    let (centre, margin) = (ellipse.centre, OUTLINED.beyond.at(blur));
    let origin = [centre.x.round(), centre.y.round()];
    let about = ellipse.enlarged(OUTLINED.larger, 0.0);
    let (frame, own) = (EllipseFrame::new(&about), EllipseFrame::new(ellipse));
    let (rows, inner) = (
        Some(frame.enlarged_rows(margin)?),
        Some(own.enlarged_rows(blur)?),
    );
    let count = std::f64::consts::PI * (about.major + margin) * (about.minor + margin);
    let step = (count / wanted).round().clamp(1.0, OUTLINED.max_step) as usize;
    // Pixels of a row lie in the gaps between those of the adjacent rows.
    let shift = (OUTLINED.row_shift * (step * OUTLINED.outside_step) as f64).round() as usize;
    let (width, height) = (image.width(), image.height());
    let area = [0, 0, width - 1, height - 1];
    let reach = about.half_extent().y + margin;
    let lines = (centre.y - reach).max(0.0) as usize
        ..((centre.y + reach).max(0.0) as usize + 1).min(height);
    let mut sorter = Sorter::new(pattern, origin);
    let mut batch = Batch::new();
    for y in lines {
        let Some((from, to)) = row_interval(&rows, y as f64) else {
            continue;
        };
        let inside = row_interval(&inner, y as f64)
            .map_or(0..0, |(from, to)| columns_in_area(from, to, area));
        for x in columns_in_area(from, to, area) {
            let turn = x + y * shift;
            let step = if inside.contains(&x) {
                step
            } else {
                step * OUTLINED.outside_step
            };
            let Some(&value) = image.row(y).get(x).filter(|_| turn.is_multiple_of(step)) else {
                continue;
            };
            batch.len = 0;
            batch.push(
                (x as f64 - origin[0]) as f32,
                (y as f64 - origin[1]) as f32,
                f32::from(value),
            );
            let (s, t) = ellipse.local_position(Vector2::new(x as f64, y as f64));
            (batch.p[0], batch.q[0]) = ((s / ellipse.major) as f32, (t / ellipse.minor) as f32);
            batch.root[0] = 1.0;
            sorter.push(PixelKind::Integrated, &batch, 0);
        }
    }
    let mut out = sorter.finish();
    out.outlined = true;
    Some(out)
}
