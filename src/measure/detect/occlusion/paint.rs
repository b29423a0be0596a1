//! Dark paint that touches an end of a flat disc, as a dash or a letter does. The end is thin: what the paint adds there to the
//! outline passes for a longer disc, and residuals do not tell. Beside the end the paint itself shows.

use nalgebra::Vector2;

use super::region::OcclusionBand;
use crate::detect::appearance::parameters::{BLUR, MarkerParameters, contrast, light_at};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::occlusion::options::PAINT;
use crate::raster::Raster;

/// The end that dark paint touches of a disc whose image is known to `m`, as a band of the picture; `scale` is that of the
/// residuals. `None` where no end is thin, none is touched, or both are: then they move the centre as little as they tell of it.
pub fn find_painted_end(image: &Raster, ellipse: &Ellipse, m: &MarkerParameters, scale: f64) -> Option<OcclusionBand> {
    // The radius of curvature of an end.
    if ellipse.minor * ellipse.minor > PAINT.thin_blurs * m[BLUR] * ellipse.major {
        return None;
    }
    let limit = (PAINT.dark * contrast(m)).max(PAINT.significance * scale);
    let (clear, reach) = (PAINT.clear_blurs * m[BLUR], PAINT.reach_blurs * m[BLUR] + 1.0);
    let (inner, outer) = (ellipse.larger(1.0, clear), ellipse.larger(1.0, reach));
    let (axis, extent) = (ellipse.axis(), outer.extent());
    let inwards = |end: f64| {
        let tip = ellipse.centre + axis * (end * ellipse.major);
        let half = extent.map(|v| v.min((1.0 - PAINT.end) * ellipse.major + reach));
        let along = |(x, y, value): (usize, usize, u8)| {
            let at = Vector2::new(x as f64, y as f64);
            let (s, t) = ellipse.local(at);
            let lies_there = end * s > PAINT.end * ellipse.major && outer.contains(at) && !inner.contains(at);
            let darker = || light_at(m, s / ellipse.major, t / ellipse.minor) - f64::from(value);
            (lies_there && darker() > limit).then_some(end * s)
        };
        let along: Vec<f64> = image.part(tip - half, tip + half, 1).filter_map(along).collect();
        (along.len() >= PAINT.min_pixels).then(|| along.iter().fold(f64::MAX, |least, &s| s.min(least)))
    };
    let middle = ellipse.centre.dot(&axis);
    let skirt = PAINT.skirt_blurs * m[BLUR] + 1.0;
    match (inwards(1.0), inwards(-1.0)) {
        (Some(from), None) => Some(OcclusionBand { axis, from: middle + from - skirt, to: f64::INFINITY }),
        (None, Some(from)) => Some(OcclusionBand { axis, from: f64::NEG_INFINITY, to: middle - from + skirt }),
        _ => None,
    }
}
