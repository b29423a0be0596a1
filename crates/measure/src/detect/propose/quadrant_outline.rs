//! Outline of quadrants.

use nalgebra::Vector2;

use crate::detect::appearance::parameters::{BLUR, LIGHT, MarkerParameters, X, Y, grey_contrast};
use crate::detect::estimate::options::{OUTLINED, PRIOR};
use crate::detect::estimate::outlined_quadrants;
use crate::detect::hypothesis::{Hypothesis, prior::PriorValue};
use crate::detect::image::scanline::{EllipseFrame, columns_in_area, row_interval};
use crate::detect::image::{ellipse::Ellipse, histogram::Histogram};
use crate::detect::propose::moments;
use crate::detect::propose::options::{BLURRED, OUTLINE};
use crate::detect::segment::bitmask::LevelSide;
use crate::detect::segment::blob;
use crate::raster::Raster;

/// Returns quadrants with the outline of the pixels that are nearer to black than to white.
pub fn refine_outline(image: &Raster, hypothesis: Hypothesis, m: &MarkerParameters) -> Hypothesis {
    if hypothesis.edges.is_none() {
        return hypothesis;
    }
    let saddle = Vector2::new(m[X], m[Y]);
    let ellipse = &hypothesis.ellipse;
    if hypothesis.prior.blur.is_some() || hypothesis.prior.size.is_some() {
        return Hypothesis {
            ellipse: Ellipse {
                centre: saddle,
                ..*ellipse
            },
            ..hypothesis
        };
    }
    let level = (m[LIGHT] - OUTLINE.end * grey_contrast(m)).clamp(0.0, f64::from(u8::MAX)) as u8;
    let own = blob::dark_parts(image, ellipse, 0.0, level);
    let found = moments::quadrants_from_blobs(&[0, 1], &own)
        .or_else(|| moments::quadrants_from_blobs(&[0], &own));
    let mut out = found.map_or(*ellipse, |f| f.ellipse);
    if let Some(longer) =
        white_half_length(image, &out, m).filter(|longer| *longer > OUTLINE.longer * out.major)
    {
        out.major = longer;
    }
    // Blur removes more of the thin end of one black part than of the other.
    if out.minor < OUTLINE.thick_px && (out.centre - saddle).norm() > OUTLINE.aside_px {
        out.centre = saddle;
    }
    Hypothesis {
        ellipse: out,
        ..hypothesis
    }
}

/// Fits outline and edges of quadrants that are narrow for their blur. Returns the hypothesis and all parameters; `None` if
/// the quadrants are not narrow or the fit does not converge.
pub fn fit_outline_and_edges(
    image: &Raster,
    hypothesis: &Hypothesis,
    m: &MarkerParameters,
) -> Option<(Hypothesis, MarkerParameters)> {
    let ellipse = &hypothesis.ellipse;
    if hypothesis.edges.is_none()
        || hypothesis.is_in_glare()
        || ellipse.minor > OUTLINE.narrow_blurs * m[BLUR]
    {
        return None;
    }
    let reach = (ellipse.half_extent() * OUTLINE.about).add_scalar(BLURRED.skin_px);
    let skin = skin_grey(image, ellipse.centre - reach, ellipse.centre + reach)? as f64;
    let centre = Vector2::new(m[X], m[Y]);
    let centred = Hypothesis {
        ellipse: Ellipse { centre, ..*ellipse },
        ..hypothesis.clone()
    };
    let start = outlined_quadrants::initial_parameters(&centred, m, skin)?;
    outlined_quadrants::refine_quadrants(
        image,
        &centred,
        start,
        PriorValue::with_relative_sigma(m[BLUR], PRIOR.edge_scatter),
    )
}

/// Returns the grey values of the pixels within an outline.
pub fn grey_values_inside(image: &Raster, ellipse: &Ellipse) -> impl Iterator<Item = u8> {
    let rows = EllipseFrame::new(ellipse).enlarged_rows(0.0);
    let (reach, centre) = (ellipse.half_extent().y, ellipse.centre.y);
    let area = [0, 0, image.width() - 1, image.height() - 1];
    let lines = (centre - reach).max(0.0) as usize..(centre + reach).max(0.0) as usize + 1;
    lines.flat_map(move |y| {
        let columns =
            row_interval(&rows, y as f64).map(|(from, to)| columns_in_area(from, to, area));
        columns
            .and_then(|columns| image.row(y).get(columns))
            .unwrap_or(&[])
            .iter()
            .copied()
    })
}

/// Returns the grey value of the skin in a box of which a marker takes less than half.
pub fn skin_grey(image: &Raster, low: Vector2<f64>, high: Vector2<f64>) -> Option<usize> {
    Histogram::from_values(image.pixels_in_box(low, high, 2).map(|(_, _, value)| value)).median()
}

/// Returns half the length of the white of quadrants along the axis of their outline, px, which is that of the marker: blur
/// removes the thin ends of the black of a flat marker, at which the white is thickest.
fn white_half_length(image: &Raster, ellipse: &Ellipse, m: &MarkerParameters) -> Option<f64> {
    if ellipse.minor > OUTLINE.thick_px {
        return None;
    }
    let centre = Vector2::new(m[X], m[Y]);
    let reach = ellipse.half_extent() * OUTLINE.about_white;
    let (low, high) = (centre - reach, centre + reach);
    let skin = skin_grey(image, low, high)? as f64;
    let level = 0.5 * (skin + m[LIGHT]);
    if m[LIGHT] - skin < OUTLINED.whiter * grey_contrast(m) {
        return None;
    }
    let own = |s: f64, t: f64| {
        s.abs() < OUTLINE.about_white * ellipse.major && t.abs() < ellipse.minor + OUTLINE.white_px
    };
    let place = |at: Vector2<f64>| Ellipse { centre, ..*ellipse }.local_position(at);
    let (mut least, mut most) = (0.0f64, 0.0f64);
    let lighter = LevelSide::Lighter(level.clamp(0.0, f64::from(u8::MAX - 1)) as u8);
    for blob in blob::blobs_in_box(image, low, high, lighter) {
        let (s, t) = place(blob.centroid);
        if !own(s, t) || blob.area < OUTLINE.white * ellipse.major * ellipse.minor {
            continue;
        }
        for &[y, from, to] in &blob.runs {
            for x in [from, to] {
                let (s, _) = place(Vector2::new(f64::from(x), f64::from(y)));
                (least, most) = (least.min(s), most.max(s));
            }
        }
    }
    let (before, behind) = (-least, most);
    let even = before.min(behind) > OUTLINE.min_white_end * ellipse.major
        && before.max(behind) < OUTLINE.max_white_ratio * before.min(behind);
    even.then_some(0.5 * (before + behind))
}
