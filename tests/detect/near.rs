//! Promise: a camera near the skin finds large and flat markers; writing and lines are not detected as markers.

use crate::common::drawn::{
    Ellipse, HEIGHT, WIDTH, discs, is_within, measured, on_skin, picture, place_on_skin, quadrants,
};
use nalgebra::Vector2;
use wingd::measure::detect::{RejectReason, Rejected, detect};
use wingd::measure::raster::Raster;

/// A rendered scene in a frame, with its corner at (1000, 800).
fn in_frame(scene: impl Fn(f64, f64) -> f64, skin: u8, seed: u64) -> Raster {
    let part = picture(scene, 1.1, 1.5, seed);
    place_on_skin(WIDTH, part.luma(), skin)
}

#[test]
fn quadrants_thicker_than_the_near_background_reaches_are_found() {
    let target: Ellipse = [450.2, 210.7, 229.0, 71.0, -0.09];
    let scene = quadrants(target, 0.8, [165.0, 60.0, 230.0]);
    for seed in 0..2 {
        let [x, y, a, b, angle] = target;
        let m = measured(
            &in_frame(&scene, 165, seed),
            [x + 1000.0, y + 800.0, a, b, angle],
            6.0,
        );
        assert!(
            (m.semi_major_px / a - 1.0).abs() < 0.05,
            "{} px long",
            m.semi_major_px
        );
    }
}

/// Focal length, px, height of the camera, and row of its horizon.
const FOCAL: f64 = 3000.0;
const HEIGHT_M: f64 = 1.5;
const HORIZON: f64 = -1530.0;

#[test]
fn quadrants_that_are_not_centred_in_their_outline_are_found() {
    // Positions on the skin, m: lateral, ahead, and the radius. The centre of their outline is 8 px below their own.
    let [aside, ahead, radius] = [0.02, 2.58, 0.17];
    let target: Ellipse = [aside, ahead, radius, radius, 0.0];
    let on_target = quadrants(target, 0.6, [160.0, 60.0, 225.0]);
    let scene = |x: f64, y: f64| {
        let away = FOCAL * HEIGHT_M / (y - HORIZON);
        on_target((x - 0.5 * WIDTH as f64) * away / FOCAL, away)
    };
    let centre = [
        0.5 * WIDTH as f64 + FOCAL * aside / ahead,
        HORIZON + FOCAL * HEIGHT_M / ahead,
    ];
    assert!(centre[1] > 100.0 && centre[1] < HEIGHT as f64 - 100.0);
    for seed in 0..2 {
        let marker = [centre[0] + 1000.0, centre[1] + 800.0, 198.0, 115.0, 0.0];
        measured(&in_frame(scene, 160, seed), marker, 6.0);
    }
}

#[test]
fn dots_far_smaller_than_the_discs_about_them_are_no_markers() {
    // Discs on a plane, from 80 px down to 13; the dots next to the nearer ones are as long as farther discs.
    let disc = |k: i32| {
        let a = 80.0 * 0.8f64.powi(k);
        [
            a / 0.111,
            if k % 2 == 0 { 110.0 } else { 190.0 },
            a,
            0.15 * a,
            0.0,
        ]
    };
    let discs: Vec<Ellipse> = (0..9).map(disc).collect();
    let dots = (0..3).map(|k| {
        let [x, y, a, b, angle] = disc(k);
        [x + 0.4 * a, y + 60.0, 0.3 * a, 0.3 * b, angle]
    });
    let all: Vec<Ellipse> = discs.iter().copied().chain(dots).collect();
    let found = detect(&picture(on_skin(&all, 165.0, 60.0), 1.1, 1.5, 1)).markers;
    let shown = |&[x0, y0, a, b, angle]: &Ellipse| {
        let own = |x: f64, y: f64| is_within([x0, y0, 0.1 * a, b, angle], x, y);
        found
            .iter()
            .filter(|m| own(m.centre_px.x, m.centre_px.y))
            .count()
    };
    let near: Vec<usize> = discs.iter().map(shown).collect();
    assert_eq!((near, found.len()), (vec![1; 9], 9));
}

#[test]
fn markers_seen_from_little_above_the_skin_are_found() {
    // From 1 m above, at 20 m and more.
    let flat: [Ellipse; 3] = [
        [160.4, 120.3, 110.0, 3.6, 0.08],
        [450.7, 130.8, 70.0, 2.0, -0.06],
        [700.2, 140.4, 90.0, 2.4, -0.09],
    ];
    let target: Ellipse = [420.3, 260.6, 74.0, 3.5, 0.12];
    let on_target = quadrants(target, 0.75, [160.0, 90.0, 215.0]);
    let discs = on_skin(&flat, 160.0, 90.0);
    let scene = |x: f64, y: f64| {
        if is_within(target, x, y) {
            on_target(x, y)
        } else {
            discs(x, y)
        }
    };
    for seed in 0..3 {
        let image = picture(scene, 1.0, 1.5, seed);
        measured(&image, target, 6.0);
        for disc in flat {
            measured(&image, disc, 6.0);
        }
    }
}

#[test]
fn a_streak_across_the_discs_is_no_marker() {
    // As long and as thin as a far disc.
    let streak: Ellipse = [590.0, 150.0, 42.0, 1.9, 1.2];
    let all: Vec<Ellipse> = discs().into_iter().chain([streak]).collect();
    for seed in 0..3 {
        let found = detect(&picture(on_skin(&all, 165.0, 60.0), 1.1, 1.5, seed));
        assert_eq!(found.markers.len(), 9);
        let there = |r: &&Rejected| (r.centre_px - Vector2::new(streak[0], streak[1])).norm() < 2.0;
        let reasons: Vec<RejectReason> = found
            .rejected
            .iter()
            .filter(there)
            .map(|r| r.reason)
            .collect();
        assert!(
            reasons.contains(&RejectReason::OrientationOutlier),
            "{reasons:?}"
        );
    }
}
