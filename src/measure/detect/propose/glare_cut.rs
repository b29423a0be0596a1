//! Disc that is partly hidden by glare: the ellipse through the visible outline, because the blob ends before the disc
//! does.

use nalgebra::Vector2;

use super::partial_ellipse::fit_ellipse;
use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::occlusion::{glare::glare_limits, options::GLARE, region::OcclusionBand};
use crate::detect::propose::options::GLARE_CUT;
use crate::detect::segment::blob::Blob;
use crate::estimation::robust::median;
use crate::raster::Raster;

/// Point of a blob's rim, px: its position, its position along the axis of the blob, and the grey step across the rim.
struct ContourPoint {
    at: Vector2<f64>,
    along: f64,
    step: f64,
}

/// Visible part of a blob's rim.
struct VisiblePart {
    axis: Vector2<f64>,
    left: Vec<Vector2<f64>>,
    /// Positions along the axis at which glare begins: before the first and after the second.
    ends: [Option<f64>; 2],
}

/// Returns the hypothesis with the outline of its complete disc if glare hides an end of it, joined with the part on the
/// other side of the glare, if there is one.
pub fn complete_disc(image: &Raster, hypothesis: &Hypothesis, index: usize, blobs: &[Blob]) -> Option<Hypothesis> {
    let blob = blobs.get(index)?;
    let part = visible_part(image, blob, GLARE_CUT.min_points)?;
    let far = (blobs.iter().enumerate())
        .filter(|&(i, other)| i != index && is_opposite(&part, blob, other))
        .find_map(|(i, other)| join_parts(image, &part, i, other, hypothesis, blob));
    far.or_else(|| {
        // If too little of the rim is visible, the size is known only from the neighbouring discs.
        let seen = Ellipse::from_blob(blob);
        let ellipse = fit_ellipse(&part.left, blob).and_then(|o| plausible_outline(o, blob)).unwrap_or(seen);
        let bands = glare_bands(part.axis, part.ends);
        Some(Hypothesis { ellipse, ..hypothesis.clone() }.with_glare(bands))
    })
}

fn glare_bands(axis: Vector2<f64>, [first, second]: [Option<f64>; 2]) -> Vec<OcclusionBand> {
    let band = |from: f64, to: f64| OcclusionBand { axis, from, to };
    let before = first.map(|end| band(f64::NEG_INFINITY, end));
    before.into_iter().chain(second.map(|end| band(end, f64::INFINITY))).collect()
}

/// Returns true if a blob may be the rest of the disc: across the glare, on the axis, and of similar size.
fn is_opposite(part: &VisiblePart, blob: &Blob, other: &Blob) -> bool {
    let d = other.centroid - blob.centroid;
    let own = Ellipse::from_blob(blob);
    let (along, across) = (d.dot(&part.axis), d.perp(&part.axis).abs());
    let side = if along > 0.0 { part.ends[1] } else { part.ends[0] };
    side.is_some()
        && other.area > GLARE_CUT.rest.0
        && other.area < GLARE_CUT.rest.1 * blob.area
        && along.abs() > GLARE_CUT.along.0 * own.major
        && along.abs() < GLARE_CUT.along.1 * own.major
        && across < own.minor + GLARE_CUT.across * along.abs()
}

/// Joins both parts of a disc that is crossed by a band of glare.
fn join_parts(
    image: &Raster,
    one: &VisiblePart,
    index: usize,
    other: &Blob,
    hypothesis: &Hypothesis,
    blob: &Blob,
) -> Option<Hypothesis> {
    let far = visible_part(image, other, GLARE_CUT.min_points / 3)?;
    let after = (other.centroid - blob.centroid).dot(&one.axis) > 0.0;
    let facing = if after == (far.axis.dot(&one.axis) > 0.0) { far.ends[0] } else { far.ends[1] };
    facing?;
    let points: Vec<Vector2<f64>> = one.left.iter().chain(&far.left).copied().collect();
    let ellipse = fit_ellipse(&points, blob)?;
    // One ellipse must pass through both parts.
    let off = |p: &Vector2<f64>| (ellipse.normalized_radius(*p) - 1.0).abs() * ellipse.minor;
    let mean = points.iter().map(off).sum::<f64>() / points.len() as f64;
    let along = |p: &Vector2<f64>| p.dot(&one.axis);
    let ends =
        |points: &[Vector2<f64>]| points.iter().map(along).fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
    let (near, far_ends) = (ends(&one.left), ends(&far.left));
    let (from, to) = if after { (near.1, far_ends.0) } else { (far_ends.1, near.0) };
    if mean > GLARE_CUT.off_px || from >= to {
        return None;
    }
    let blobs = hypothesis.blobs.iter().copied().chain([index]).collect();
    let bands = vec![OcclusionBand { axis: one.axis, from: from - GLARE.margin_px, to: to + GLARE.margin_px }];
    Some(Hypothesis { ellipse, blobs, ..hypothesis.clone() }.with_glare(bands))
}

/// Returns the part of a blob's rim outside glare; `None` if no end of the blob lies in glare.
fn visible_part(image: &Raster, blob: &Blob, least: usize) -> Option<VisiblePart> {
    let ellipse = Ellipse::from_blob(blob);
    let axis = ellipse.major_direction();
    let inverse = blob.covariance.try_inverse()?;
    let grey = |at: Vector2<f64>| f64::from(image.nearest_value(at.x, at.y));
    let points: Vec<ContourPoint> = (blob.contour().into_iter())
        .map(|at| {
            let normal = (inverse * (at - blob.centroid)).normalize() * GLARE_CUT.reach_px;
            let (inside, outside) = (grey(at - normal), grey(at + normal));
            ContourPoint { at, along: at.dot(&axis), step: outside - inside }
        })
        .collect();
    let typical = median(points.iter().map(|p| p.step).collect())?;
    let ends = glare_limits(image, &ellipse);
    if typical < GLARE_CUT.min_step || ends == [None, None] {
        return None;
    }
    let open = |p: &&ContourPoint| {
        p.step > GLARE_CUT.step * typical && ends[0].is_none_or(|e| p.along > e) && ends[1].is_none_or(|e| p.along < e)
    };
    let left: Vec<Vector2<f64>> = points.iter().filter(open).map(|p| p.at).collect();
    (left.len() >= least).then_some(VisiblePart { axis, left, ends })
}

/// Returns the outline if it is not much larger than its visible part.
fn plausible_outline(ellipse: Ellipse, blob: &Blob) -> Option<Ellipse> {
    let seen = Ellipse::from_blob(blob);
    let fits = ellipse.major < GLARE_CUT.larger[0] * seen.major && ellipse.minor < GLARE_CUT.larger[1] * seen.minor;
    (fits && ellipse.major > seen.major).then_some(ellipse)
}
