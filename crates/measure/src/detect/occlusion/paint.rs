//! Dark paint that touches an end of a flat disc, such as a dash or a letter. The end is thin: the paint makes the disc
//! look longer, and the residuals do not show it. Next to the end, the paint itself is visible.

use nalgebra::Vector2;

use super::region::OcclusionBand;
use crate::detect::appearance::parameters::{
    BLUR, EDGE_END_BLURS, EDGE_SKIRT_BLURS, MarkerParameters, grey_contrast, light_at,
};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::numbers::IMPROBABLE_SIGMAS;
use crate::detect::occlusion::options::PAINT;
use crate::raster::Raster;

/// Returns the end of a disc that dark paint touches, as a band of the image. The image of the disc is described by `m`;
/// `scale` is that of its residuals, grey levels. `None` if the ends are not thin, if no end is touched, or if both are:
/// they then shift the centre as little as they constrain it.
pub fn find_painted_end(
    image: &Raster,
    ellipse: &Ellipse,
    m: &MarkerParameters,
    scale: f64,
) -> Option<OcclusionBand> {
    // Blur removes more of an end than it leaves if the radius of curvature, `minor^2 / major`, is below it.
    if ellipse.minor * ellipse.minor > m[BLUR] * ellipse.major {
        return None;
    }
    // With a quarter of the contrast, panel lines count too, which shift a disc by less (0.1 px) than excluding an end costs
    // (0.2 px).
    let limit = (0.5 * grey_contrast(m)).max(IMPROBABLE_SIGMAS * scale);
    // One blur from the outline, 16 % of the disc's own edge are left.
    let (clear, reach) = (m[BLUR], EDGE_END_BLURS * m[BLUR] + 1.0);
    let (inner, outer) = (ellipse.enlarged(1.0, clear), ellipse.enlarged(1.0, reach));
    let (axis, extent) = (ellipse.major_direction(), outer.half_extent());
    let inwards = |end: f64| {
        let tip = ellipse.centre + axis * (end * ellipse.major);
        let half = extent.map(|v| v.min((1.0 - PAINT.end) * ellipse.major + reach));
        let along = |(x, y, value): (usize, usize, u8)| {
            let at = Vector2::new(x as f64, y as f64);
            let (s, t) = ellipse.local_position(at);
            let lies_there =
                end * s > PAINT.end * ellipse.major && outer.contains(at) && !inner.contains(at);
            let darker = || light_at(m, s / ellipse.major, t / ellipse.minor) - f64::from(value);
            (lies_there && darker() > limit).then_some(end * s)
        };
        let along: Vec<f64> = image
            .pixels_in_box(tip - half, tip + half, 1)
            .filter_map(along)
            .collect();
        (along.len() >= PAINT.min_pixels)
            .then(|| along.iter().fold(f64::MAX, |least, &s| s.min(least)))
    };
    let middle = ellipse.centre.dot(&axis);
    let skirt = EDGE_SKIRT_BLURS * m[BLUR] + 1.0;
    match (inwards(1.0), inwards(-1.0)) {
        (Some(from), None) => Some(OcclusionBand {
            axis,
            from: middle + from - skirt,
            to: f64::INFINITY,
        }),
        (None, Some(from)) => Some(OcclusionBand {
            axis,
            from: f64::NEG_INFINITY,
            to: middle - from + skirt,
        }),
        _ => None,
    }
}
