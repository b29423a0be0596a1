//! The observation equation written a second time over dual numbers, with a quadrature of its own.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use num_dual::{Dual64, DualNum};

use super::*;
use crate::adjust::beam::{Bending, RAISE_TERMS, twist_basis};
use crate::adjust::example::{orientation, setup, window};
use crate::adjust::shapes::shapes_at;
use crate::setup::{Setup, Uncertainty};

const STEPS: usize = 4000;
const C: usize = 5;
const T: usize = 3;
/// Curvature, twist, raise, mounting, ground rotation, centre, ground position, scale.
const ALL: usize = C + T + RAISE_TERMS + 3 + 3 + 3 + 3 + 1;

type Dual3 = [Dual64; 3];

fn turned(w: &[Dual64], p: Dual3) -> Dual3 {
    let angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
    let angle = angle2.sqrt();
    let (a, b) = (angle.sin() / angle, (-angle.cos() + 1.0) / angle2);
    let cross = |p: Dual3| -> Dual3 {
        [w[1] * p[2] - w[2] * p[1], w[2] * p[0] - w[0] * p[2], w[0] * p[1] - w[1] * p[0]]
    };
    let (once, twice) = (cross(p), cross(cross(p)));
    std::array::from_fn(|k| p[k] + a * once[k] + b * twice[k])
}

fn by_matrix(m: &Matrix3<f64>, p: Dual3) -> Dual3 {
    std::array::from_fn(|i| p[0] * m[(i, 0)] + p[1] * m[(i, 1)] + p[2] * m[(i, 2)])
}

/// Slope of the bending at an arc length.
fn bent(scene: &Scene, c: &[Dual64], arc: f64) -> Dual64 {
    let length = scene.ground.axis.length_m;
    let shapes = shapes_at(arc / length);
    c.iter().zip(shapes).fold(Dual64::from(0.0), |sum, (c, s)| sum + *c * (s * length))
}

/// A marker in flight: the raised ground axis turned piece by piece, and the rigid arm at its end.
fn in_flight(scene: &Scene, marker: usize, x: &[Dual64; ALL]) -> Dual3 {
    let (c, rest) = x.split_at(C);
    let (t, rest) = rest.split_at(T);
    let (h, rest) = rest.split_at(RAISE_TERMS);
    let (p, scale) = (&rest[9..12], rest[12]);
    let axis = &scene.ground.axis;
    let end = scene.ground.stations[marker].arc_m;
    let step = end / STEPS as f64;
    let mut ground = [Dual64::from(axis.root_m.x), Dual64::from(axis.root_m.y) + h[0]];
    let mut flight = ground;
    for k in 0..STEPS {
        let arc = (k as f64 + 0.5) * step;
        let eta = arc / axis.length_m;
        let rise = h[1] + h[2] * (2.0 * eta) + h[3] * (3.0 * eta * eta);
        let (sin, cos) = axis.slope_rad(arc).sin_cos();
        let (dx, dy) = (Dual64::from(cos * step), rise * (step / axis.length_m) + sin * step);
        let turn = bent(scene, c, arc);
        ground = [ground[0] + dx, ground[1] + dy];
        flight[0] += scale * (dx * turn.cos() - dy * turn.sin());
        flight[1] += scale * (dx * turn.sin() + dy * turn.cos());
    }
    let slope = Dual64::from(axis.slope_rad(end));
    let arm = [p[0] - ground[0], p[1] - ground[1], p[2] - axis.root_m.z];
    let along = arm[0] * slope.cos() + arm[1] * slope.sin();
    let normal = arm[1] * slope.cos() - arm[0] * slope.sin();
    let twist = t.iter().zip(twist_basis(axis, end)).fold(Dual64::from(0.0), |s, (t, b)| s + *t * b)
        * scene.ground.nose;
    let (n, z) = (normal * twist.cos() - arm[2] * twist.sin(), normal * twist.sin() + arm[2] * twist.cos());
    let slope = slope + bent(scene, c, end);
    [
        flight[0] + scale * (along * slope.cos() - n * slope.sin()),
        flight[1] + scale * (along * slope.sin() + n * slope.cos()),
        scale * z + axis.root_m.z,
    ]
}

fn pixel(scene: &Scene, marker: usize, x: &[Dual64; ALL]) -> [Dual64; 2] {
    let pose = &x[C + T + RAISE_TERMS..];
    let mut p = in_flight(scene, marker, x);
    for k in 0..3 {
        p[k] -= pose[6 + k];
    }
    let seen = turned(&pose[..3], turned(&pose[3..6], by_matrix(&scene.camera_from_wing, p)));
    let (x, y) = (seen[0] / seen[2], seen[1] / seen[2]);
    let l = &scene.lens;
    let r2 = x * x + y * y;
    let radial = r2 * (r2 * (r2 * l.k3 + l.k2) + l.k1) + 1.0;
    [
        (x * radial + x * y * (2.0 * l.p1) + (r2 + x * x * 2.0) * l.p2) * l.fx + l.cx,
        (y * radial + (r2 + y * y * 2.0) * l.p1 + x * y * (2.0 * l.p2)) * l.fy + l.cy,
    ]
}

/// The same from the code under test: pixel and its derivative to each unknown.
fn coded(scene: &Scene, marker: usize, x: &[f64; ALL]) -> (Vector2<f64>, Vec<Vector2<f64>>) {
    let at = |from: usize| Vector3::new(x[from], x[from + 1], x[from + 2]);
    let first = C + T + RAISE_TERMS;
    let pose =
        Pose { mount_rad: at(first), ground_rad: at(first + 3), centre_m: at(first + 6), ..Pose::default() };
    let bending = Bending {
        curvature_per_m: &x[..C],
        twist_rad: &x[C..C + T],
        scale: x[ALL - 1],
        raise_m: std::array::from_fn(|j| x[C + T + j]),
    };
    let state = scene.marker(marker, &scene.bend(&bending), &at(first + 9), &bending, &[0.0; ESTIMATED]);
    let seen = scene.project(&state.carried.position_m, &scene.camera(&pose)).unwrap();
    let by = seen.by_point;
    let mut list: Vec<Vector2<f64>> = state.by_curvature[..C].iter().map(|d| by * d).collect();
    list.extend(state.by_twist[..T].iter().chain(&state.by_raise).map(|d| by * d));
    let camera = [seen.by_mount, seen.by_ground_rotation, -by, by * state.carried.by_ground];
    list.extend(camera.iter().flat_map(|m| (0..3).map(move |k| m.column(k).into_owned())));
    list.push(by * state.by_scale);
    (seen.pixel, list)
}

#[test]
fn derivatives_match_dual_numbers() {
    let scene = Scene::new(&setup(), &orientation()).unwrap();
    for marker in [0, 3, 8] {
        let ground = scene.ground.stations[marker].surveyed_m;
        let mut x = [0.0; ALL];
        let usual = [4e-3, 2e-3, -1e-3, 5e-4, 2e-4, 0.03, -0.02, 0.01, 4e-3, -6e-3, 3e-3, 2e-3];
        x[..usual.len()].copy_from_slice(&usual);
        let camera = [2e-3, -1e-3, 3e-3, 1e-3, 2e-3, -1e-3, 2e-3, 3e-3, -2e-3];
        x[usual.len()..ALL - 4].copy_from_slice(&camera);
        x[ALL - 4..ALL - 1].copy_from_slice(ground.as_slice());
        x[ALL - 1] = 0.9984;
        let (found, derivatives) = coded(&scene, marker, &x);
        for (k, derivative) in derivatives.iter().enumerate() {
            let seeded: [Dual64; ALL] =
                std::array::from_fn(|i| Dual64::new(x[i], if i == k { 1.0 } else { 0.0 }));
            let expected = pixel(&scene, marker, &seeded);
            for axis in 0..2 {
                let (value, slope) = (expected[axis].re, expected[axis].eps);
                assert!((found[axis] - value).abs() < 1e-3, "marker {marker}: {} {value}", found[axis]);
                // The tables are linear between their points: the quadratures differ by 1e-6.
                let error = (derivative[axis] - slope).abs();
                assert!(
                    error < 2e-5 * (1.0 + slope.abs()),
                    "marker {marker} unknown {k}: {} {slope}",
                    derivative[axis]
                );
            }
        }
    }
}

#[test]
fn derivatives_through_a_bowed_pane_match_differences() {
    let scene = Scene::new(&Setup { window: Some(window()), ..setup() }, &orientation()).unwrap();
    let pose = Pose {
        mount_rad: Vector3::new(2e-3, -1e-3, 3e-3),
        ground_rad: Vector3::new(1e-3, 2e-3, -1e-3),
        centre_m: Vector3::new(1e-3, 2e-3, -1e-3),
        window_m: Vector3::new(-1e-3, 1e-3, 1e-3),
        bow: 0.2,
        ..Pose::default()
    };
    let point = Vector3::new(9.0, -1.1, 0.8);
    let seen = scene.project(&point, &scene.camera(&pose)).unwrap();
    let plane = scene.project(&point, &scene.ground_camera(&pose)).unwrap();
    assert_eq!(plane.by_bow, Vector2::zeros());
    let difference = |change: &dyn Fn(&mut Pose, &mut Vector3<f64>, f64), step: f64| {
        let at = |h: f64| {
            let (mut pose, mut point) = (pose, point);
            change(&mut pose, &mut point, h);
            scene.project(&point, &scene.camera(&pose)).unwrap().pixel
        };
        (at(step) - at(-step)) / (2.0 * step)
    };
    let close = |found: Vector2<f64>, expected: Vector2<f64>, tolerance: f64| {
        assert!((found - expected).norm() < tolerance * expected.norm(), "{found} {expected}");
    };
    for k in 0..3 {
        let column = |m: &Matrix2x3<f64>| m.column(k).into_owned();
        close(column(&seen.by_point), difference(&|_, p, h| p[k] += h, 1e-3), 1e-5);
        close(-column(&seen.by_point), difference(&|pose, _, h| pose.window_m[k] += h, 1e-3), 1e-5);
        close(column(&seen.by_mount), difference(&|pose, _, h| pose.mount_rad[k] += h, 1e-5), 1e-5);
        close(
            column(&seen.by_ground_rotation),
            difference(&|pose, _, h| pose.ground_rad[k] += h, 1e-5),
            1e-5,
        );
    }
    close(seen.by_bow, difference(&|pose, _, h| pose.bow += h, 1e-3), 1e-3);
}

/// A root, an axis and a span that lie elsewhere, held against a scene that is built there; lens against differences.
#[test]
fn what_is_estimated_moves_markers_as_a_scene_built_elsewhere() {
    let free = Setup { uncertainty: Uncertainty::default(), ..setup() };
    let scene = Scene::new(&free, &orientation()).unwrap();
    let bending = Bending { curvature_per_m: &[4e-3, 1e-3], twist_rad: &[0.03], ..Bending::NONE };
    let (sin, cos) = 0.01f64.sin_cos();
    let moved = [
        ([0.3, 0.0, 0.0], Setup { root_offset_m: 0.8, ..setup() }),
        ([0.0, 0.3, 0.0], Setup { axis_chord_offset_m: Some(0.4), ..setup() }),
        ([0.0, 0.0, 0.01], Setup { span_direction: Vector2::new(cos, sin), ..setup() }),
    ];
    for (estimated, there) in moved {
        let other = Scene::new(&there, &orientation()).unwrap();
        for marker in [0, 4, 8] {
            let here = scene.ground.stations[marker].surveyed_m;
            let found = scene.marker(marker, &scene.bend(&bending), &here, &bending, &estimated);
            let there = other.ground.stations[marker].surveyed_m;
            let built = other.marker(marker, &other.bend(&bending), &there, &bending, &[0.0; ESTIMATED]);
            let place = |s: &Scene, p: &Vector3<f64>| s.ground.frame.survey_point(p);
            let found_m = place(&scene, &found.carried.position_m);
            let error = found_m - place(&other, &built.carried.position_m);
            let held = scene.marker(marker, &scene.bend(&bending), &here, &bending, &[0.0; ESTIMATED]);
            let effect = (found_m - place(&scene, &held.carried.position_m)).norm();
            assert!(
                error.norm() < 1e-3 + 0.03 * effect,
                "{estimated:?} marker {marker}: {error} of {effect}"
            );
        }
    }
}

#[test]
fn derivatives_by_the_lens_match_differences() {
    let scene = Scene::new(&setup(), &orientation()).unwrap();
    let point = Vector3::new(9.0, -1.1, 0.8);
    let seen = scene.project(&point, &scene.camera(&Pose::default())).unwrap();
    for (k, step) in [1.0, 1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4, 1e-5, 1e-5].into_iter().enumerate() {
        let at = |sign: f64| {
            let mut pose = Pose::default();
            pose.lens[k] = sign * step;
            scene.project(&point, &scene.camera(&pose)).unwrap().pixel
        };
        let difference = (at(1.0) - at(-1.0)) / (2.0 * step);
        let error = (difference - seen.by_lens.column(k)).norm();
        assert!(error < 1e-6 * (1.0 + difference.norm()), "{k}: {difference}");
    }
}

/// A frame's unknowns that all move a marker: a plane of bending that leans, a root that turned, what is only estimated.
fn leaning() -> Values {
    Values {
        curvature_per_m: vec![4e-3, 1e-3],
        twist_rad: vec![0.03, -0.02],
        raise_m: [0.02, -0.01, 0.0, 0.0],
        estimated: [0.1, 0.05, 0.005],
        root_rotation_rad: Vector3::new(1e-2, -2e-2, 1e-2),
        plane_rad: Some(0.03),
        ..Values::expected(0.999)
    }
}

#[test]
fn derivatives_of_a_wing_that_leans_match_differences() {
    let free = Setup { uncertainty: Uncertainty::default(), ..setup() };
    let scene = Scene::new(&free, &orientation()).unwrap();
    let usual = leaning();
    let answers = Some(Arc::new(scene.answers(&usual.bending())));
    for values in [usual.clone(), Values { answers, ..usual }] {
        let marker = 5;
        let ground = scene.ground.stations[marker].surveyed_m;
        let at = |values: &Values, ground: &Vector3<f64>| {
            scene.in_flight(marker, &scene.bent(values), ground, values)
        };
        let state = at(&values, &ground);
        let close = |name: &str, found: Vector3<f64>, step: f64, change: &dyn Fn(&mut Values, f64)| {
            let moved = |h: f64| {
                let mut values = values.clone();
                change(&mut values, h);
                at(&values, &ground).carried.position_m
            };
            let expected = (moved(step) - moved(-step)) / (2.0 * step);
            let error = (found - expected).norm();
            assert!(error < 1e-5 * (1.0 + expected.norm()), "{name}: {found} {expected}");
        };
        close("plane", state.by_plane, 1e-3, &|v, h| v.plane_rad = v.plane_rad.map(|p| p + h));
        close("scale", state.by_scale, 1e-4, &|v, h| v.scale += h);
        for k in 0..2 {
            close("curvature", state.by_curvature[k], 1e-6, &|v, h| v.curvature_per_m[k] += h);
            close("twist", state.by_twist[k], 1e-4, &|v, h| v.twist_rad[k] += h);
            close("raise", state.by_raise[k], 1e-4, &|v, h| v.raise_m[k] += h);
        }
        for k in 0..ESTIMATED {
            close("estimated", state.by_estimated[k], 1e-4, &|v, h| v.estimated[k] += h);
            let there = |h: f64| at(&values, &(ground + Vector3::ith(k, h))).carried.position_m;
            let by_ground = (there(1e-4) - there(-1e-4)) / 2e-4;
            assert!((by_ground - state.carried.by_ground.column(k)).norm() < 1e-5, "ground {k}: {by_ground}");
        }
    }
}
