//! The wing bent by a deflection, and a camera that looks at all of it.

use nalgebra::{Matrix3, Rotation3, Vector3};

use crate::adjust::beam::{Bending, Grid, Mount, Section};
use crate::adjust::ground::{GroundShape, Station};
use crate::environment::Plate;
use crate::setup::Setup;

/// Steps to the curvature of a tip deflection; each leaves a hundredth of the error.
const PROPORTIONS: usize = 4;

/// Where the camera sees a point (from the projection centre, survey frame, m); camera frame.
pub(super) fn seen(
    setup: &Setup,
    turn: &Rotation3<f64>,
    point_m: &Vector3<f64>,
    in_flight: bool,
) -> Vector3<f64> {
    let p = turn * point_m;
    Plate::from_window(setup.window.as_ref(), turn, in_flight).map_or(p, |pane| pane.apparent_point(&p))
}

/// Markers in flight, wing frame, m: one coefficient of curvature, found by the rule of proportion.
pub(super) fn bent(setup: &Setup, shape: &GroundShape, tip_deflection_m: f64) -> Vec<Vector3<f64>> {
    let arcs: Vec<f64> = shape.stations.iter().map(|s| s.arc_m).collect();
    let grid = Grid::new(shape, &arcs);
    let mounts = grid.mounts(&shape.stations);
    let scale = setup.thermal.map_or(1.0, |t| t.scale());
    let place = |curvature: f64| -> Vec<Vector3<f64>> {
        let sections = grid.bend(&Bending { curvature_per_m: &[curvature], scale, ..Bending::NONE });
        let carried = sections.iter().zip(&mounts).zip(&shape.stations);
        let place = |((section, mount), s): ((&Section, &Mount), &Station)| {
            mount.carry(section, &s.surveyed_m, scale).position_m
        };
        carried.zip(&setup.markers).map(|(of, m)| if m.fixed { of.1.surveyed_m } else { place(of) }).collect()
    };
    let outermost = (0..arcs.len()).max_by(|&a, &b| arcs[a].total_cmp(&arcs[b]));
    let deflection =
        |points: &[Vector3<f64>]| outermost.map_or(0.0, |k| points[k].y - shape.stations[k].surveyed_m.y);
    let mut curvature = 2.0 * tip_deflection_m / shape.axis.length_m.powi(2);
    for _ in 0..PROPORTIONS {
        let reached = deflection(&place(curvature)) - deflection(&place(0.0));
        if reached.abs() > 1e-9 {
            curvature *= (tip_deflection_m - deflection(&place(0.0))) / reached;
        }
    }
    place(curvature)
}

/// Middle of the wing on ground and in flight; the camera upright.
pub(super) fn looking_at(ground: &[Vector3<f64>], flight: &[Vector3<f64>]) -> Rotation3<f64> {
    let mut range = [(f64::INFINITY, f64::NEG_INFINITY); 2];
    for p in ground.iter().chain(flight) {
        for (r, angle) in range.iter_mut().zip([p.z.atan2(p.x), p.y.atan2(p.x.hypot(p.z))]) {
            *r = (r.0.min(angle), r.1.max(angle));
        }
    }
    let [azimuth, elevation] = range.map(|(low, high)| if low <= high { 0.5 * (low + high) } else { 0.0 });
    let forward =
        Vector3::new(elevation.cos() * azimuth.cos(), elevation.sin(), elevation.cos() * azimuth.sin());
    let right = forward.cross(&Vector3::y()).normalize();
    let down = forward.cross(&right);
    let rows = Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
    Rotation3::from_matrix_unchecked(rows)
}
