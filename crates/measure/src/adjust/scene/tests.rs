//! Independent implementation of the observation equation with dual numbers and its own quadrature.
use nalgebra::{Matrix3, Vector3};
use num_dual::{Dual64, DualNum};

use super::*;
use crate::adjust::beam::{Bending, COMPLIANCES, MAX_CURVATURE_TERMS, RAISE_TERMS, twist_basis};
use crate::adjust::example::{gull_wing, orientation, setup, tilted_values, window};
use crate::adjust::shapes::curvature_integrals;
use crate::setup::{Setup, SetupUncertainty, WingBreak};

/// Steps of the reference's quadrature: finer than the difference that the tests resolve.
const STEPS: usize = 16000;
const C: usize = 5;
const T: usize = 3;
/// Curvature, twist, raise, mounting, ground rotation, centre, ground position, scale.
const ALL: usize = C + T + RAISE_TERMS + 3 + 3 + 3 + 3 + 1;

type Dual3 = [Dual64; 3];

fn rotate_point(w: &[Dual64], p: Dual3) -> Dual3 {
    let angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
    let angle = angle2.sqrt();
    let (a, b) = (angle.sin() / angle, (-angle.cos() + 1.0) / angle2);
    let cross = |p: Dual3| -> Dual3 {
        [
            w[1] * p[2] - w[2] * p[1],
            w[2] * p[0] - w[0] * p[2],
            w[0] * p[1] - w[1] * p[0],
        ]
    };
    let (once, twice) = (cross(p), cross(cross(p)));
    std::array::from_fn(|k| p[k] + a * once[k] + b * twice[k])
}

fn multiply_matrix(m: &Matrix3<f64>, p: Dual3) -> Dual3 {
    std::array::from_fn(|i| p[0] * m[(i, 0)] + p[1] * m[(i, 1)] + p[2] * m[(i, 2)])
}

/// Slope of the bending at an arc length.
fn bending_slope(scene: &WingScene, c: &[Dual64], arc: f64) -> Dual64 {
    let length = scene.ground.axis.length_m;
    let shapes = curvature_integrals(arc / length);
    c.iter()
        .zip(shapes)
        .fold(Dual64::from(0.0), |sum, (c, s)| sum + *c * (s * length))
}

/// Position of a marker in flight: the raised ground axis is rotated piece by piece, with the rigid arm at its end.
fn flight_position(scene: &WingScene, marker: usize, x: &[Dual64; ALL]) -> Dual3 {
    let (c, rest) = x.split_at(C);
    let (t, rest) = rest.split_at(T);
    let (h, rest) = rest.split_at(RAISE_TERMS);
    let (p, scale) = (&rest[9..12], rest[12]);
    let axis = &scene.ground.axis;
    let end = scene.ground.stations[marker].arc_m;
    let step = end / STEPS as f64;
    let mut ground = [
        Dual64::from(axis.root_m.x),
        Dual64::from(axis.root_m.y) + h[0],
    ];
    let mut flight = ground;
    for k in 0..STEPS {
        let arc = (k as f64 + 0.5) * step;
        let eta = arc / axis.length_m;
        let rise = h[1] + h[2] * (2.0 * eta) + h[3] * (3.0 * eta * eta);
        let (sin, cos) = axis.slope_rad(arc).sin_cos();
        let (dx, dy) = (
            Dual64::from(cos * step),
            rise * (step / axis.length_m) + sin * step,
        );
        let turn = bending_slope(scene, c, arc);
        ground = [ground[0] + dx, ground[1] + dy];
        flight[0] += scale * (dx * turn.cos() - dy * turn.sin());
        flight[1] += scale * (dx * turn.sin() + dy * turn.cos());
    }
    let slope = Dual64::from(axis.slope_rad(end));
    let arm = [p[0] - ground[0], p[1] - ground[1], p[2] - axis.root_m.z];
    let along = arm[0] * slope.cos() + arm[1] * slope.sin();
    let normal = arm[1] * slope.cos() - arm[0] * slope.sin();
    let twist = t
        .iter()
        .zip(twist_basis(axis, end))
        .fold(Dual64::from(0.0), |s, (t, b)| s + *t * b)
        * scene.ground.nose;
    let (n, z) = (
        normal * twist.cos() - arm[2] * twist.sin(),
        normal * twist.sin() + arm[2] * twist.cos(),
    );
    let slope = slope + bending_slope(scene, c, end);
    [
        flight[0] + scale * (along * slope.cos() - n * slope.sin()),
        flight[1] + scale * (along * slope.sin() + n * slope.cos()),
        scale * z + axis.root_m.z,
    ]
}

fn reference_pixel(scene: &WingScene, marker: usize, x: &[Dual64; ALL]) -> [Dual64; 2] {
    let pose = &x[C + T + RAISE_TERMS..];
    let mut p = flight_position(scene, marker, x);
    for k in 0..3 {
        p[k] -= pose[6 + k];
    }
    let seen = rotate_point(
        &pose[..3],
        rotate_point(&pose[3..6], multiply_matrix(&scene.camera_from_wing, p)),
    );
    let (x, y) = (seen[0] / seen[2], seen[1] / seen[2]);
    let l = &scene.lens;
    let r2 = x * x + y * y;
    let radial = r2 * (r2 * (r2 * l.k3 + l.k2) + l.k1) + 1.0;
    [
        (x * radial + x * y * (2.0 * l.p1) + (r2 + x * x * 2.0) * l.p2) * l.fx + l.cx,
        (y * radial + (r2 + y * y * 2.0) * l.p1 + x * y * (2.0 * l.p2)) * l.fy + l.cy,
    ]
}

/// Pixel and its derivatives with respect to each unknown, from the code under test.
fn computed_pixel(
    scene: &WingScene,
    marker: usize,
    x: &[f64; ALL],
) -> (Vector2<f64>, Vec<Vector2<f64>>) {
    let at = |from: usize| Vector3::new(x[from], x[from + 1], x[from + 2]);
    let first = C + T + RAISE_TERMS;
    let pose = CameraPose {
        mount_rad: at(first),
        ground_rad: at(first + 3),
        centre_m: at(first + 6),
        ..CameraPose::default()
    };
    let bending = Bending {
        curvature_per_m: &x[..C],
        compliances: [0.0; COMPLIANCES],
        twist_rad: &x[C..C + T],
        scale: x[ALL - 1],
        raise_m: std::array::from_fn(|j| x[C + T + j]),
    };
    let state = scene.marker_with_dimensions(
        marker,
        &scene.bend(&bending),
        &at(first + 9),
        &bending,
        &[0.0; ESTIMATED_DIMENSIONS],
    );
    let seen = scene
        .project(&state.carried.position_m, &scene.flight_camera(&pose))
        .unwrap();
    let by = seen.by_point;
    let mut list: Vec<Vector2<f64>> = state.by_bending[..C].iter().map(|d| by * d).collect();
    list.extend(
        state.by_twist[..T]
            .iter()
            .chain(&state.by_raise)
            .map(|d| by * d),
    );
    let camera = [
        seen.by_mount,
        seen.by_ground_rotation,
        -by,
        by * state.carried.by_ground,
    ];
    list.extend(
        camera
            .iter()
            .flat_map(|m| (0..3).map(move |k| m.column(k).into_owned())),
    );
    list.push(by * state.by_scale);
    (seen.pixel, list)
}

#[test]
fn derivatives_match_dual_numbers() {
    let scene = WingScene::new(&setup(), &orientation()).unwrap();
    for marker in [0, 3, 8] {
        let ground = scene.ground.stations[marker].surveyed_m;
        let mut x = [0.0; ALL];
        let typical = [
            4e-3, 2e-3, -1e-3, 5e-4, 2e-4, 0.03, -0.02, 0.01, 4e-3, -6e-3, 3e-3, 2e-3,
        ];
        x[..typical.len()].copy_from_slice(&typical);
        let camera = [2e-3, -1e-3, 3e-3, 1e-3, 2e-3, -1e-3, 2e-3, 3e-3, -2e-3];
        x[typical.len()..ALL - 4].copy_from_slice(&camera);
        x[ALL - 4..ALL - 1].copy_from_slice(ground.as_slice());
        x[ALL - 1] = 0.9984;
        let (found, derivatives) = computed_pixel(&scene, marker, &x);
        for (k, derivative) in derivatives.iter().enumerate() {
            let seeded: [Dual64; ALL] =
                std::array::from_fn(|i| Dual64::new(x[i], if i == k { 1.0 } else { 0.0 }));
            let expected = reference_pixel(&scene, marker, &seeded);
            for axis in 0..2 {
                let (value, slope) = (expected[axis].re, expected[axis].eps);
                assert!(
                    (found[axis] - value).abs() < 1e-3,
                    "marker {marker}: {} {value}",
                    found[axis]
                );
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
    let scene = WingScene::new(
        &Setup {
            window: Some(window()),
            ..setup()
        },
        &orientation(),
    )
    .unwrap();
    let pose = CameraPose {
        mount_rad: Vector3::new(2e-3, -1e-3, 3e-3),
        ground_rad: Vector3::new(1e-3, 2e-3, -1e-3),
        centre_m: Vector3::new(1e-3, 2e-3, -1e-3),
        window_m: Vector3::new(-1e-3, 1e-3, 1e-3),
        bow: 0.2,
        ..CameraPose::default()
    };
    let point = Vector3::new(9.0, -1.1, 0.8);
    let seen = scene.project(&point, &scene.flight_camera(&pose)).unwrap();
    let plane = scene.project(&point, &scene.ground_camera(&pose)).unwrap();
    assert_eq!(plane.by_bow, Vector2::zeros());
    let difference = |change: &dyn Fn(&mut CameraPose, &mut Vector3<f64>, f64), step: f64| {
        let at = |h: f64| {
            let (mut pose, mut point) = (pose, point);
            change(&mut pose, &mut point, h);
            scene
                .project(&point, &scene.flight_camera(&pose))
                .unwrap()
                .pixel
        };
        (at(step) - at(-step)) / (2.0 * step)
    };
    let close = |found: Vector2<f64>, expected: Vector2<f64>, tolerance: f64| {
        assert!(
            (found - expected).norm() < tolerance * expected.norm(),
            "{found} {expected}"
        );
    };
    for k in 0..3 {
        let column = |m: &Matrix2x3<f64>| m.column(k).into_owned();
        close(
            column(&seen.by_point),
            difference(&|_, p, h| p[k] += h, 1e-3),
            1e-5,
        );
        close(
            -column(&seen.by_point),
            difference(&|pose, _, h| pose.window_m[k] += h, 1e-3),
            1e-5,
        );
        close(
            column(&seen.by_mount),
            difference(&|pose, _, h| pose.mount_rad[k] += h, 1e-5),
            1e-5,
        );
        close(
            column(&seen.by_ground_rotation),
            difference(&|pose, _, h| pose.ground_rad[k] += h, 1e-5),
            1e-5,
        );
    }
    close(
        seen.by_bow,
        difference(&|pose, _, h| pose.bow += h, 1e-3),
        1e-3,
    );
}

/// Compares a root, an axis and a span that are moved by corrections with a scene built there.
#[test]
fn corrected_dimensions_match_a_scene_built_with_them() {
    let swept = |sweep_rad: f64| Setup {
        breaks: vec![WingBreak {
            span_m: 9.5,
            sweep_rad: Some(sweep_rad),
        }],
        ..setup()
    };
    let setup = || swept(0.05);
    let free = Setup {
        uncertainty: SetupUncertainty::DEFAULT,
        ..setup()
    };
    let scene = WingScene::new(&free, &orientation()).unwrap();
    let bending = Bending {
        curvature_per_m: &[4e-3, 1e-3],
        twist_rad: &[0.03],
        ..Bending::UNBENT
    };
    let (sin, cos) = 0.01f64.sin_cos();
    let moved = [
        (
            [0.3, 0.0, 0.0, 0.0],
            Setup {
                root_offset_m: 0.8,
                ..setup()
            },
        ),
        (
            [0.0, 0.3, 0.0, 0.0],
            Setup {
                axis_chord_offset_m: Some(0.4),
                ..setup()
            },
        ),
        (
            [0.0, 0.0, 0.01, 0.0],
            Setup {
                span_direction: Vector2::new(cos, sin),
                ..setup()
            },
        ),
        ([0.0, 0.0, 0.0, 0.01], swept(0.06)),
    ];
    for (estimated, there) in moved {
        let other = WingScene::new(&there, &orientation()).unwrap();
        for marker in [0, 4, 8] {
            let here = scene.ground.stations[marker].surveyed_m;
            let found = scene.marker_with_dimensions(
                marker,
                &scene.bend(&bending),
                &here,
                &bending,
                &estimated,
            );
            let there = other.ground.stations[marker].surveyed_m;
            let built = other.marker_with_dimensions(
                marker,
                &other.bend(&bending),
                &there,
                &bending,
                &[0.0; ESTIMATED_DIMENSIONS],
            );
            let survey_position = |s: &WingScene, p: &Vector3<f64>| s.ground.frame.survey_point(p);
            let found_m = survey_position(&scene, &found.carried.position_m);
            let error = found_m - survey_position(&other, &built.carried.position_m);
            let nominal = scene.marker_with_dimensions(
                marker,
                &scene.bend(&bending),
                &here,
                &bending,
                &[0.0; ESTIMATED_DIMENSIONS],
            );
            let effect = (found_m - survey_position(&scene, &nominal.carried.position_m)).norm();
            assert!(
                error.norm() < 1e-3 + 0.03 * effect,
                "{estimated:?} marker {marker}: {error} of {effect}"
            );
        }
    }
}

#[test]
fn twist_inboard_of_a_break_carries_the_outboard_part_along() {
    let scene = WingScene::new(&gull_wing(None), &orientation()).unwrap();
    let flat = scene.grid.bend(&Bending::UNBENT);
    let twisted = scene.grid.bend(&Bending {
        twist_rad: &[0.02],
        ..Bending::UNBENT
    });
    let at = |k: usize| flat[k].axis_m;
    let arc_m = scene.ground.axis.breaks[0].arc_m;
    let inboard_rad = 0.02 * twist_basis(&scene.ground.axis, arc_m)[0] * scene.ground.nose;
    for (k, section) in twisted.iter().enumerate().skip(5) {
        // The axis inboard of the break is straight; what lies outboard rotates about its extension.
        let slope = (at(3) - at(1)).y / (at(3) - at(1)).x;
        let above_m = at(k).y - at(3).y - slope * (at(k).x - at(3).x);
        let (aft_m, expected_m) = (section.axis_m.z - at(k).z, inboard_rad.sin() * above_m);
        assert!(
            (aft_m - expected_m).abs() < 0.02 * expected_m,
            "{k}: {aft_m} {expected_m}"
        );
    }
    assert_eq!(twisted[2].axis_m.z, at(2).z);
}

#[test]
fn derivatives_of_a_tilted_wing_match_differences() {
    for wing in [setup(), gull_wing(None), gull_wing(Some(0.07))] {
        check_derivatives(&Setup {
            uncertainty: SetupUncertainty::DEFAULT,
            ..wing
        });
    }
}

fn check_derivatives(setup: &Setup) {
    let scene = WingScene::new(setup, &orientation()).unwrap();
    let typical = tilted_values();
    let answers = Some(scene.dimension_derivatives(&typical.bending()));
    for values in [
        typical.clone(),
        UnknownValues {
            dimension_derivatives: answers,
            ..typical
        },
    ] {
        let marker = 5;
        let ground = scene.ground.stations[marker].surveyed_m;
        let at = |values: &UnknownValues, ground: &Vector3<f64>| {
            scene.marker_in_flight(marker, &scene.bend_frame(values), ground, values)
        };
        let state = at(&values, &ground);
        let close = |name: &str,
                     found: Vector3<f64>,
                     step: f64,
                     change: &dyn Fn(&mut UnknownValues, f64)| {
            let moved = |h: f64| {
                let mut values = values.clone();
                change(&mut values, h);
                at(&values, &ground).carried.position_m
            };
            let expected = (moved(step) - moved(-step)) / (2.0 * step);
            let error = (found - expected).norm();
            assert!(
                error < 1e-5 * (1.0 + expected.norm()),
                "{name}: {found} {expected}"
            );
        };
        close("plane", state.by_plane, 1e-3, &|v, h| {
            v.plane_rad = v.plane_rad.map(|p| p + h)
        });
        close("scale", state.by_scale, 1e-4, &|v, h| v.scale += h);
        for k in 0..2 {
            close("curvature", state.by_bending[k], 1e-6, &|v, h| {
                v.curvature_per_m[k] += h
            });
            close("twist", state.by_twist[k], 1e-4, &|v, h| {
                v.twist_rad[k] += h
            });
            close("raise", state.by_raise[k], 1e-4, &|v, h| v.raise_m[k] += h);
        }
        for k in 0..COMPLIANCES {
            close(
                "compliance",
                state.by_bending[MAX_CURVATURE_TERMS + k],
                1e-3,
                &|v, h| v.compliances[k] += h,
            );
        }
        for k in 0..ESTIMATED_DIMENSIONS {
            close("estimated", state.by_estimated[k], 1e-4, &|v, h| {
                v.estimated[k] += h
            });
        }
        for k in 0..3 {
            let there = |h: f64| {
                at(&values, &(ground + Vector3::ith(k, h)))
                    .carried
                    .position_m
            };
            let by_ground = (there(1e-4) - there(-1e-4)) / 2e-4;
            assert!(
                (by_ground - state.carried.by_ground.column(k)).norm() < 1e-5,
                "ground {k}: {by_ground}"
            );
        }
    }
}
