//! What marks that are rigid to the cabin would bring: some in the corners of the frame, seen on ground and in flight.

use nalgebra::{Matrix2, Vector2};

use crate::measure::setup::{GroundSight, Orientation, Setup, Shape, SurveyMarker};

/// Numbers of marks that are planned with.
pub(super) const COUNTS: [usize; 3] = [1, 2, 4];
/// Places in the frame, over its width and height: the corners, clear of most wings.
const PLACES: [(f64, f64); 4] = [(0.07, 0.09), (0.93, 0.09), (0.07, 0.91), (0.93, 0.91)];
/// Distance from the camera, m: a fairing or the fuselage beside the window is rarely farther.
const DISTANCE_M: f64 = 3.0;
const DIAMETER_M: f64 = 0.06;

/// The installation with so many marks instead of those that it has; `None` where the lens does not see the corners.
pub(super) fn with_marks(
    setup: &Setup,
    orientation: &Orientation,
    (count, pixel_sigma): (usize, f64),
) -> Option<(Setup, Orientation)> {
    let (mut setup, mut orientation) = (setup.clone(), orientation.clone());
    let usual = median(setup.markers.iter().map(|m| m.sigma_m).collect())?;
    let size = Vector2::new(f64::from(setup.lens.width), f64::from(setup.lens.height));
    for (k, (u, v)) in PLACES.iter().take(count).enumerate() {
        let pixel = size.component_mul(&Vector2::new(*u, *v));
        let ray = setup.lens.ray(&pixel).ok()?.normalize();
        let position_m =
            setup.projection_centre_m + orientation.camera_from_survey.inverse() * ray * DISTANCE_M;
        let covariance_px2 = Matrix2::identity() * (pixel_sigma * pixel_sigma);
        orientation.ground.push(GroundSight { marker: setup.markers.len(), pixel, covariance_px2 });
        setup.markers.push(SurveyMarker {
            id: format!("fixed mark {}", k + 1),
            shape: Shape::Quadrant,
            diameter_m: DIAMETER_M,
            position_m,
            sigma_m: usual,
            fixed: true,
        });
    }
    Some((setup, orientation))
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
