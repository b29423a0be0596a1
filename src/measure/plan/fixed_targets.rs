//! Fixed targets, rigid to the cabin, in the corners of the frame, visible on the ground and in flight.

use nalgebra::{Matrix2, Vector2};

use crate::estimation::robust::median;
use crate::observation::Observation;
use crate::setup::{Orientation, Setup, Shape, SurveyMarker, fixed_target};

/// Numbers of additional targets that are predicted.
pub(super) const COUNTS: [usize; 3] = [1, 2, 4];

/// Adds `count` fixed targets to an installation, in the corners after the first `passed`. Returns `None` if the lens does
/// not see them.
pub(super) fn add_fixed_targets(
    setup: &Setup,
    orientation: &Orientation,
    (passed, count, pixel_sigma): (usize, usize, f64),
) -> Option<(Setup, Orientation)> {
    let (mut setup, mut orientation) = (setup.clone(), orientation.clone());
    let median_sigma_m = median(setup.markers.iter().map(|m| m.sigma_m).collect())?;
    let size = Vector2::new(f64::from(setup.lens.width), f64::from(setup.lens.height));
    for (k, (u, v)) in fixed_target::POSITIONS.iter().enumerate().skip(passed).take(count) {
        let pixel = size.component_mul(&Vector2::new(*u, *v));
        let ray = setup.lens.ray(&pixel).ok()?.normalize();
        let position_m =
            setup.projection_centre_m + orientation.camera_from_survey.inverse() * ray * fixed_target::DISTANCE_M;
        let covariance_px2 = Matrix2::identity() * (pixel_sigma * pixel_sigma);
        orientation.ground.push(Observation { marker: setup.markers.len(), pixel, covariance_px2 });
        setup.markers.push(SurveyMarker {
            id: format!("F{:02}", k + 1),
            shape: Shape::Quadrant,
            diameter_m: fixed_target::DIAMETER_M,
            position_m,
            sigma_m: median_sigma_m,
            fixed: true,
            flight_motion_m: fixed_target::FLIGHT_MOTION_M,
            part: None,
        });
    }
    Some((setup, orientation))
}
