//! From the ellipse's centre to the image of the disc's centre (docs/model.md).

use nalgebra::Vector2;

use super::Identities;
use super::beam::State;
use super::outline::Disc;
use super::scene::Scene;
use crate::detect::{Detection, CovarianceSource};
use crate::geometry::Lens;
use crate::setup::Shape;

/// Standard deviation of the local normal about each axis: the smooth skin and the fitted bending
/// and twist against the true ones, rad.
const NORMAL_SIGMA: f64 = 0.015;
/// Standard deviation of the skin's warp, 1/m: 2 degrees of twist over 20 m, a crown that grows along
/// the span. Seen at a grazing angle it shifts the ellipse along its major axis.
const WARP_SIGMA_PER_M: f64 = 0.002;

/// Detections with their centres at the discs' centres. A quadrant target's saddle is where two
/// straight edges through its centre meet: on a curved skin too they meet at the centre's image,
/// so nothing is due.
pub(super) fn correct_centres(
    scene: &Scene<'_>,
    state: &State,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<Detection> {
    let markers = identities.marker_of.iter().copied().chain(std::iter::repeat(None));
    detections
        .iter()
        .zip(markers)
        .map(|(detection, marker)| {
            let circle = marker.filter(|_| detection.shape == Shape::Circle);
            let disc = circle.and_then(|j| scene.marker_disc(state, j));
            disc.and_then(|d| correct_centre(&scene.setup.lens, detection, &d))
                .unwrap_or_else(|| detection.clone())
        })
        .collect()
}

fn correct_centre(lens: &Lens, detection: &Detection, disc: &Disc) -> Option<Detection> {
    let bias = disc.centre_bias_px(lens)?;
    let outboard = disc.normal.cross(&disc.chord);
    let warped = Disc { warp_per_m: WARP_SIGMA_PER_M, ..*disc };
    let others = [disc.tilted(&disc.chord, NORMAL_SIGMA), disc.tilted(&outboard, NORMAL_SIGMA), warped];
    let mut covariance_px2 = detection.covariance_px2.clone();
    for other in others {
        let change: Vector2<f64> = other.centre_bias_px(lens).map_or(bias, |b| b - bias);
        covariance_px2.add(CovarianceSource::Perspective, change * change.transpose());
    }
    Some(Detection { centre_px: detection.centre_px - bias, covariance_px2, ..detection.clone() })
}
