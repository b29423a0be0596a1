//! Promise: markers are found where what is lighter on both sides of them is not the skin.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod drawn;

use drawn::{WIDTH, framed, measured, on_even_skin, picture, within};
use wingd::measure::detect::detect;

#[test]
fn a_disc_that_lies_close_to_others_is_found() {
    // What lies as far above as below a part of it is the next one on one side; what is seen of it first is a rag.
    measured(&on_even_skin("packed.png", 116), [1220.432, 940.096, 102.1, 26.2, -0.12], 9.0);
}

#[test]
fn a_disc_in_a_band_of_shadow_is_found() {
    let disc = [450.3, 205.6, 18.0, 2.3, 0.1];
    let scene = |x: f64, y: f64| {
        let in_shade = (160.0..260.0).contains(&(y + 0.1 * (x - 450.0)));
        match (in_shade, within(disc, x, y)) {
            (false, _) => 130.0,
            (true, false) => 76.0,
            (true, true) => 38.0,
        }
    };
    for seed in 0..2 {
        let frame = framed(WIDTH, picture(scene, 0.9, 1.5, seed).luma(), 76);
        measured(&frame, [1450.3, 1005.6, 18.0, 2.3, 0.1], 12.0);
    }
}

#[test]
fn corners_of_a_checkerboard_are_no_quadrants() {
    // Where four squares meet, two of them are black; each ends in a corner, not in an arc.
    for (k, (side, flat, turn)) in
        [(60.0, 0.5, 0.1), (70.0, 0.4, 0.5), (50.0, 0.7, 0.8), (80.0, 0.35, -0.3)].into_iter().enumerate()
    {
        let board = |x: f64, y: f64| {
            let (s, t) = drawn::local([450.0, 210.0, side, flat * side, turn], x, y);
            let (column, row) = (s.floor(), t.floor());
            let there = (-3.0..3.0).contains(&s) && (-2.0..2.0).contains(&t);
            if there && (column + row).rem_euclid(2.0) < 1.0 { 40.0 } else { 190.0 }
        };
        let found = detect(&picture(board, 1.0, 1.5, k as u64)).markers;
        assert!(found.is_empty(), "board {k}: {found:?}");
    }
}
