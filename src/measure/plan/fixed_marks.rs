//! What marks that are rigid to the cabin would bring: some in the corners of the frame, seen on ground and in flight.

use nalgebra::{Matrix2, Vector2};

use crate::estimation::robust::median;
use crate::setup::{GroundObservation, Orientation, Setup, Shape, SurveyMarker, fixed_mark};

/// Numbers of marks that are planned with.
pub(super) const COUNTS: [usize; 3] = [1, 2, 4];

/// The installation with so many marks more, in the corners after the first `passed`; `None` where the lens does not see
/// them.
pub(super) fn with_marks(
    setup: &Setup,
    orientation: &Orientation,
    (passed, count, pixel_sigma): (usize, usize, f64),
) -> Option<(Setup, Orientation)> {
    let (mut setup, mut orientation) = (setup.clone(), orientation.clone());
    let usual = median(setup.markers.iter().map(|m| m.sigma_m).collect())?;
    let size = Vector2::new(f64::from(setup.lens.width), f64::from(setup.lens.height));
    for (k, (u, v)) in fixed_mark::PLACES.iter().enumerate().skip(passed).take(count) {
        let pixel = size.component_mul(&Vector2::new(*u, *v));
        let ray = setup.lens.ray(&pixel).ok()?.normalize();
        let position_m = setup.projection_centre_m
            + orientation.camera_from_survey.inverse() * ray * fixed_mark::DISTANCE_M;
        let covariance_px2 = Matrix2::identity() * (pixel_sigma * pixel_sigma);
        orientation.ground.push(GroundObservation { marker: setup.markers.len(), pixel, covariance_px2 });
        setup.markers.push(SurveyMarker {
            id: format!("F{:02}", k + 1),
            shape: Shape::Quadrant,
            diameter_m: fixed_mark::DIAMETER_M,
            position_m,
            sigma_m: usual,
            fixed: true,
            flight_motion_m: fixed_mark::FLIGHT_MOTION_M,
            part: None,
        });
    }
    Some((setup, orientation))
}
