//! Promise: markers are found if the lighter regions on both sides of them are not the skin.

use crate::common::drawn::{
    Ellipse, WIDTH, assert_consistent, is_within, local, measured, nearest, normalised_square,
    picture, place_on_skin, read_part_on_skin,
};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use wingd::measure::detect::detect;
use wingd::measure::raster::Raster;
use wingd::measure::setup::Shape;

#[test]
fn a_disc_close_to_others_is_found() {
    // On one side the neighbour is as far above part of the disc as below it; only a fragment of it is segmented first.
    measured(
        &read_part_on_skin("packed.png", 116),
        [1220.432, 940.096, 102.1, 26.2, -0.12],
        9.0,
    );
}

#[test]
fn a_disc_in_a_band_of_shadow_is_found() {
    let disc = [450.3, 205.6, 18.0, 2.3, 0.1];
    let scene = |x: f64, y: f64| {
        let in_shade = (160.0..260.0).contains(&(y + 0.1 * (x - 450.0)));
        match (in_shade, is_within(disc, x, y)) {
            (false, _) => 130.0,
            (true, false) => 76.0,
            (true, true) => 38.0,
        }
    };
    for seed in 0..2 {
        let frame = place_on_skin(WIDTH, picture(scene, 0.9, 1.5, seed).luma(), 76);
        measured(&frame, [1450.3, 1005.6, 18.0, 2.3, 0.1], 12.0);
    }
}

#[test]
fn corners_of_a_checkerboard_are_not_detected_as_quadrants() {
    // Where four squares meet, two of them are black; each ends in a corner, not in an arc.
    for (k, (side, flat, turn)) in [
        (60.0, 0.5, 0.1),
        (70.0, 0.4, 0.5),
        (50.0, 0.7, 0.8),
        (80.0, 0.35, -0.3),
    ]
    .into_iter()
    .enumerate()
    {
        let board = |x: f64, y: f64| {
            let (s, t) = local([450.0, 210.0, side, flat * side, turn], x, y);
            let (column, row) = (s.floor(), t.floor());
            let there = (-3.0..3.0).contains(&s) && (-2.0..2.0).contains(&t);
            if there && (column + row).rem_euclid(2.0) < 1.0 {
                40.0
            } else {
                190.0
            }
        };
        let found = detect(&picture(board, 1.0, 1.5, k as u64)).markers;
        assert!(found.is_empty(), "board {k}: {found:?}");
    }
}

const FRAME: (usize, usize) = (2400, 1600);

/// Renders a part of a wing next to a background with softened edges, placed on even skin by [`place_on_skin`].
fn place_next_to(part: &[u8], sharp: &[f64]) -> Raster {
    let (width, height) = FRAME;
    let row = |y: usize| &sharp[y.min(height - 1) * width..][..width];
    let mut soft: Vec<u8> = Vec::new();
    for y in 0..height {
        let rows = [row(y.saturating_sub(1)), row(y), row(y + 1)];
        let column = |x: usize| rows[0][x] + 2.0 * rows[1][x] + rows[2][x];
        soft.extend((0..width).map(|x| {
            let sum =
                column(x.saturating_sub(1)) + 2.0 * column(x) + column((x + 1).min(width - 1));
            (sum / 16.0).round() as u8
        }));
    }
    for (y, part) in part.chunks(WIDTH).enumerate() {
        soft[(y + 800) * width + 1000..][..WIDTH].copy_from_slice(part);
    }
    Raster::new(width, height, soft).unwrap()
}

/// Thousands of roofs and windows in all greys.
fn town(seed: u64) -> Vec<f64> {
    let (width, height) = FRAME;
    let mut random = StdRng::seed_from_u64(seed);
    let mut out = vec![120.0; width * height];
    for _ in 0..4000 {
        let (x0, y0) = (
            random.random_range(0..width),
            random.random_range(0..height),
        );
        let (w, h) = (random.random_range(4..40), random.random_range(3..25));
        let grey = random.random_range(20.0..235.0);
        for y in y0..(y0 + h).min(height) {
            out[y * width..][x0..(x0 + w).min(width)].fill(grey);
        }
    }
    out
}

/// Alternating dark and light slabs of random brightness: where four meet, two opposite ones are dark.
fn slabs(seed: u64) -> Vec<f64> {
    const SIDE: (usize, usize) = (150, 90);
    let (width, height) = FRAME;
    let mut random = StdRng::seed_from_u64(seed);
    let greys: Vec<f64> = (0..width.div_ceil(SIDE.0) * height.div_ceil(SIDE.1))
        .map(|_| random.random_range(-25.0..25.0))
        .collect();
    let grey = |i: usize| {
        let (column, row) = (i % width / SIDE.0, i / width / SIDE.1);
        let usual = if (column + row).is_multiple_of(2) {
            55.0
        } else {
            190.0
        };
        usual + greys[row * width.div_ceil(SIDE.0) + column]
    };
    (0..width * height).map(grey).collect()
}

/// Markers of a wing: quadrants below, discs that shrink upwards.
fn wing_markers() -> Vec<(Shape, Ellipse)> {
    let quadrants = (0..6).map(|k| {
        let x = 130.3 + 125.7 * f64::from(k);
        (
            Shape::Quadrant,
            [
                x,
                330.4 + 8.3 * f64::from(k % 2),
                48.0,
                8.5,
                0.04 - 0.02 * f64::from(k),
            ],
        )
    });
    let discs = (0..9).map(|k| {
        let (x, y) = (
            140.3 + 300.1 * f64::from(k % 3),
            80.4 + 80.2 * f64::from(k / 3),
        );
        (
            Shape::Circle,
            [
                x,
                y,
                34.0 + 0.03 * y,
                4.0 + 0.005 * y,
                0.1 - 0.05 * f64::from(k % 3),
            ],
        )
    });
    quadrants.chain(discs).collect()
}

/// Renders the wing next to a background with four seeds: all markers are found, consistent with their sigma.
fn assert_all_found_next_to(something: impl Fn(u64) -> Vec<f64>) {
    let markers = wing_markers();
    let scene = |x: f64, y: f64| {
        let skin = 165.0;
        let Some((shape, marker)) = markers.iter().find(|(_, m)| is_within(*m, x, y)) else {
            return skin;
        };
        let (s, t) = local(*marker, x, y);
        let white = *shape == Shape::Quadrant && (0.8 * s + 0.6 * t) * (0.8 * t - 0.6 * s) < 0.0;
        if white { 225.0 } else { 60.0 }
    };
    let mut squares = Vec::new();
    for seed in 0..4 {
        let found = detect(&place_next_to(
            picture(scene, 1.0, 1.5, seed).luma(),
            &something(seed),
        ))
        .markers;
        for &(shape, [x, y, a, b, angle]) in &markers {
            let near = nearest(&found, [x + 1000.0, y + 800.0, a, b, angle]);
            let near = near.filter(|(m, _)| m.shape == shape);
            squares.extend(near.map(|(m, error)| normalised_square(m, error)));
        }
    }
    assert_consistent(&squares, 4 * markers.len());
}

#[test]
fn markers_before_a_town_are_found() {
    assert_all_found_next_to(town);
}

#[test]
fn markers_before_slabs_that_look_like_quadrants_are_found() {
    assert_all_found_next_to(slabs);
}
