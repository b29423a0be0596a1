//! Correction from the ellipse's centre to the image of the disc's centre (docs/identification.md).

use nalgebra::Vector2;

use super::Identities;
use super::beam::WingState;
use super::outline::SkinDisc;
use super::scene::WingView;
use crate::detect::{CovarianceSource, Detection};
use crate::geometry::Lens;
use crate::setup::Shape;

/// Standard deviation of the local normal about each axis, rad: deviation of the smooth skin and of the fitted bending and
/// twist.
const NORMAL_SIGMA: f64 = 0.015;
/// Standard deviation of the skin's warp, 1/m: 2 degrees of twist over 20 m, a crown that grows along the span. At grazing
/// incidence it shifts the ellipse along its major axis.
const WARP_SIGMA_PER_M: f64 = 0.002;

/// Moves the centres of circle detections to the images of the discs' centres. Quadrant targets need no correction: two
/// straight edges through the centre meet at the centre's image, also on a curved skin.
pub(super) fn correct_centres(
    scene: &WingView<'_>,
    state: &WingState,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<Detection> {
    let markers = identities
        .marker_of
        .iter()
        .copied()
        .chain(std::iter::repeat(None));
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

fn correct_centre(lens: &Lens, detection: &Detection, disc: &SkinDisc) -> Option<Detection> {
    let bias = disc.centre_bias_px(lens)?;
    let outboard = disc.normal.cross(&disc.chord);
    let warped = SkinDisc {
        warp_per_m: WARP_SIGMA_PER_M,
        ..*disc
    };
    let others = [
        disc.tilted(&disc.chord, NORMAL_SIGMA),
        disc.tilted(&outboard, NORMAL_SIGMA),
        warped,
    ];
    let mut covariance_px2 = detection.covariance_px2.clone();
    for other in others {
        let change: Vector2<f64> = other.centre_bias_px(lens).map_or(bias, |b| b - bias);
        covariance_px2.add(CovarianceSource::Perspective, change * change.transpose());
    }
    Some(Detection {
        centre_px: detection.centre_px - bias,
        covariance_px2,
        ..detection.clone()
    })
}
