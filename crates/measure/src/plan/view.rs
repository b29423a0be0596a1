//! The wing bent by a deflection, and a camera directed at all of it.

use nalgebra::{Matrix3, Rotation3, Vector3};

use crate::adjust::beam::{BeamGrid, BeamSection, Bending};
use crate::adjust::ground::{GroundShape, Station};
use crate::adjust::marker_arm::MarkerArm;
use crate::setup::Setup;

/// Number of steps to the curvature of a tip deflection; each reduces the error to 1 %.
const MAX_PROPORTION_STEPS: usize = 4;

/// Returns the markers in flight, wing frame, m, for one coefficient of curvature, found by proportion.
pub(super) fn bend_markers(
    setup: &Setup,
    shape: &GroundShape,
    tip_deflection_m: f64,
) -> Vec<Vector3<f64>> {
    let arcs: Vec<f64> = shape.stations.iter().map(|s| s.arc_m).collect();
    let grid = BeamGrid::new(shape, &arcs);
    let mounts = MarkerArm::all_on_ground(&grid, shape);
    let scale = setup.thermal.map_or(1.0, |t| t.scale());
    let place = |curvature: f64| -> Vec<Vector3<f64>> {
        let sections = grid.bend(&Bending {
            curvature_per_m: &[curvature],
            scale,
            ..Bending::UNBENT
        });
        let carried = sections.iter().zip(&mounts).zip(&shape.stations);
        let position = |((section, mount), s): ((&BeamSection, &MarkerArm), &Station)| {
            mount.carry(section, &s.surveyed_m, scale).0.position_m
        };
        carried
            .zip(&setup.markers)
            .map(|(at, m)| {
                if m.fixed {
                    at.1.surveyed_m
                } else {
                    position(at)
                }
            })
            .collect()
    };
    let outermost = (0..arcs.len()).max_by(|&a, &b| arcs[a].total_cmp(&arcs[b]));
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
