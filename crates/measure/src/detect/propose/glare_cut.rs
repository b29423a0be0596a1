//! Disc that is partly hidden by glare: the ellipse through the visible outline, because the blob ends before the disc
//! does.

use nalgebra::Vector2;

use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::occlusion::{glare::glare_limits, region::OcclusionBand};
use crate::detect::propose::options::GLARE_CUT;
use crate::detect::segment::blob::Blob;
use crate::estimation::robust::median;
use crate::geometry::fit_conic;
use crate::raster::Raster;

/// Point of a blob's rim, px: its position, its position along the axis of the blob, and the grey step across the rim.
struct ContourPoint {
    at: Vector2<f64>,
    along: f64,
    step: f64,
}

/// Returns the hypothesis with the outline of its complete disc, of which `blob` shows a part; `None` if no end of the blob
/// lies in glare.
pub fn complete_disc(image: &Raster, hypothesis: &Hypothesis, blob: &Blob) -> Option<Hypothesis> {
    let seen = Ellipse::from_blob(blob);
    let axis = seen.major_direction();
    let inverse = blob.covariance.try_inverse()?;
    let grey = |at: Vector2<f64>| f64::from(image.nearest_value(at.x, at.y));
    let points: Vec<ContourPoint> = (blob.contour().into_iter())
        .map(|at| {
            let normal = (inverse * (at - blob.centroid)).normalize() * GLARE_CUT.reach_px;
            let (inside, outside) = (grey(at - normal), grey(at + normal));
            ContourPoint {
                at,
                along: at.dot(&axis),
                step: outside - inside,
            }
        })
        .collect();
    let typical = median(points.iter().map(|p| p.step).collect())?;
    let ends = glare_limits(image, &seen);
    if typical < GLARE_CUT.min_step || ends == [None, None] {
        return None;
    }
    let open = |p: &&ContourPoint| {
        p.step > GLARE_CUT.step * typical
            && ends[0].is_none_or(|e| p.along > e)
            && ends[1].is_none_or(|e| p.along < e)
    };
    let left: Vec<Vector2<f64>> = points.iter().filter(open).map(|p| p.at).collect();
    if left.len() < GLARE_CUT.min_points {
        return None;
    }
    // If too little of the rim is visible, the size is known only from the neighbouring discs.
    let ellipse = visible_outline(&left, &seen).unwrap_or(seen);
    let band = |from: f64, to: f64| OcclusionBand { axis, from, to };
    let before = ends[0].map(|end| band(f64::NEG_INFINITY, end));
    let bands = before
        .into_iter()
        .chain(ends[1].map(|end| band(end, f64::INFINITY)))
        .collect();
    Some(
        Hypothesis {
            ellipse,
            ..hypothesis.clone()
        }
        .with_glare(bands),
    )
}

/// Returns the ellipse through points of the rim if it is larger than the part that is seen, but not by much.
fn visible_outline(rim: &[Vector2<f64>], seen: &Ellipse) -> Option<Ellipse> {
    let (centre, shape) =
        fit_conic(rim).filter(|(_, shape)| shape.determinant() > 0.0 && shape.trace() > 0.0)?;
    let ellipse = Ellipse::from_moments(centre, shape, 1.0);
    let fits = ellipse.major < GLARE_CUT.larger[0] * seen.major
        && ellipse.minor < GLARE_CUT.larger[1] * seen.minor;
    (fits && ellipse.major > seen.major).then_some(ellipse)
}
