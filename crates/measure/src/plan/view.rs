//! The wing bent by a deflection, and a camera directed at all of it.

use nalgebra::{Matrix3, Rotation3, Vector3};

use crate::adjust::beam::{Bending, GAUSS_POINTS};
use crate::adjust::ground::GroundShape;
use crate::adjust::target_wing::TargetWing;
use crate::setup::Setup;

/// Number of steps to the curvature of a tip deflection; each reduces the error to 1 %.
const MAX_PROPORTION_STEPS: usize = 4;

/// Returns the markers in flight, wing frame, m, for one coefficient of curvature, found by proportion.
pub(super) fn bend_markers(
    setup: &Setup,
    shape: &GroundShape,
    tip_deflection_m: f64,
) -> Vec<Vector3<f64>> {
    let wing = TargetWing::of_survey(setup, shape.clone(), GAUSS_POINTS);
    let scale = setup.thermal.map_or(1.0, |t| t.scale());
    let place = |curvature: f64| -> Vec<Vector3<f64>> {
        let bending = Bending {
            curvature_per_m: &[curvature],
            scale,
            ..Bending::UNBENT
        };
        let carried = wing.carry(&bending).into_iter();
        carried.map(|at| at.position_m).collect()
    };
    let arc_m = |k: usize| shape.stations[k].arc_m;
    let outermost = (0..shape.stations.len()).max_by(|&a, &b| arc_m(a).total_cmp(&arc_m(b)));
    let deflection = |points: &[Vector3<f64>]| {
        outermost.map_or(0.0, |k| points[k].y - shape.stations[k].surveyed_m.y)
    };
    let mut curvature = 2.0 * tip_deflection_m / shape.axis.length_m.powi(2);
    for _ in 0..MAX_PROPORTION_STEPS {
        let reached = deflection(&place(curvature)) - deflection(&place(0.0));
        if reached.abs() > 1e-9 {
            curvature *= (tip_deflection_m - deflection(&place(0.0))) / reached;
        }
    }
    place(curvature)
}

/// Returns the attitude of an upright camera directed at the middle of the wing on the ground and in flight.
pub(super) fn camera_attitude(ground: &[Vector3<f64>], flight: &[Vector3<f64>]) -> Rotation3<f64> {
    let mut range = [(f64::INFINITY, f64::NEG_INFINITY); 2];
    for p in ground.iter().chain(flight) {
        for (r, angle) in range
            .iter_mut()
            .zip([p.z.atan2(p.x), p.y.atan2(p.x.hypot(p.z))])
        {
            *r = (r.0.min(angle), r.1.max(angle));
        }
    }
    let [azimuth, elevation] =
        range.map(|(low, high)| if low <= high { 0.5 * (low + high) } else { 0.0 });
    let forward = Vector3::new(
        elevation.cos() * azimuth.cos(),
        elevation.sin(),
        elevation.cos() * azimuth.sin(),
    );
    let right = forward.cross(&Vector3::y()).normalize();
    let down = forward.cross(&right);
    let rows = Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
    Rotation3::from_matrix_unchecked(rows)
}
