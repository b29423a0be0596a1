//! Fixed targets, rigid to the cabin, in the corners of the frame, visible on the ground and in flight.

use nalgebra::{Matrix2, Vector2};

use crate::estimation::robust::median;
use crate::observation::Observation;
use crate::setup::{Orientation, Setup, Shape, SurveyMarker, fixed_target};

/// Free distance between a target and a marker of the wing, in diameters of the target's image.
const CLEARANCE: f64 = 0.75;
/// Shifts from the corner towards the middle of the image, over its width and height, at which a target may be.
const SHIFTS: [(f64, f64); 9] = [
    (0.0, 0.0),
    (0.0, 0.12),
    (0.12, 0.0),
    (0.0, 0.24),
    (0.24, 0.0),
    (0.12, 0.12),
    (0.0, 0.36),
    (0.36, 0.0),
    (0.24, 0.24),
];

/// Place in the image that a marker of the wing takes on the ground or in flight: its centre and radius, px.
pub(super) type TakenPlace = (Vector2<f64>, f64);

/// Adds `count` fixed targets to an installation, after the first `passed`: in the corners, or next to them where the wing's
/// markers leave room. Returns `None` if the lens does not see them or there is no room.
pub(super) fn add_fixed_targets(
    setup: &Setup,
    orientation: &Orientation,
    (passed, count, pixel_sigma): (usize, usize, f64),
    taken: &[TakenPlace],
) -> Option<(Setup, Orientation)> {
    let (mut setup, mut orientation) = (setup.clone(), orientation.clone());
    let median_sigma_m = median(setup.markers.iter().map(|m| m.sigma_m).collect())?;
    let size = Vector2::new(f64::from(setup.lens.width), f64::from(setup.lens.height));
    let clear_px =
        CLEARANCE * setup.lens.focal_px() * fixed_target::DIAMETER_M / fixed_target::DISTANCE_M;
    let is_free = |pixel: &Vector2<f64>| {
        taken
            .iter()
            .all(|(centre, radius_px)| (centre - pixel).norm() > clear_px + radius_px)
    };
    let mut added = vec![];
    for (k, (u, v)) in fixed_target::POSITIONS
        .iter()
        .enumerate()
        .skip(passed)
        .take(count)
    {
        let inward = |side: f64, shift: f64| {
            if side < 0.5 {
                side + shift
            } else {
                side - shift
            }
        };
        let places = SHIFTS
            .map(|(du, dv)| size.component_mul(&Vector2::new(inward(*u, du), inward(*v, dv))));
        let pixel = places.into_iter().find(is_free)?;
        let ray = setup.lens.ray(&pixel).ok()?.normalize();
        let position_m = setup.projection_centre_m
            + orientation.camera_from_survey.inverse() * ray * fixed_target::DISTANCE_M;
        added.push((k, pixel, position_m));
    }
    for (k, pixel, position_m) in added {
        let covariance_px2 = Matrix2::identity() * (pixel_sigma * pixel_sigma);
        orientation.ground.push(Observation {
            marker: setup.markers.len(),
            pixel,
            covariance_px2,
        });
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
