//! Promise: a disc partly covered by the decal of another disc is found, with a consistent standard deviation.

use crate::common::drawn::{Ellipse, discs, is_within, nearest, normalised_square, picture};
use wingd::measure::detect::detect;

const SKIN: f64 = 190.0;
const BLACK: f64 = 50.0;

/// Nine complete discs and one next to the last of them, covered by its decal. The visible part is above
/// a row at its centre, with a given slant.
fn scene(hidden: Ellipse, beside: Ellipse, [row, slant]: [f64; 2]) -> impl Fn(f64, f64) -> f64 {
    let mut whole = discs().to_vec();
    whole.push(beside);
    move |x, y| {
        let left = is_within(hidden, x, y) && y < row + slant * (x - hidden[0]);
        if left || whole.iter().any(|&d| is_within(d, x, y)) {
            BLACK
        } else {
            SKIN
        }
    }
}

/// Normalised error of a disc covered by a decal with different slants.
fn normalised_error(slants: &[f64]) -> f64 {
    let (mut squares, mut count) = (0.0, 0);
    for (blur, noise) in [(0.9, 2.0), (1.8, 2.0), (0.9, 5.0)] {
        for seed in 0..4u64 {
            let shift = 0.23 * seed as f64;
            let slant = slants[seed as usize % slants.len()];
            let hidden = [560.4 + shift, 372.0 + shift, 51.0, 6.0, -0.09];
            let beside = [566.0 + shift, 386.5 + shift, 51.7, 6.1, -0.09];
            // 50 % covered, or a little more or less.
            let row = 371.5 + 0.6 * seed as f64;
            let found = detect(&picture(
                scene(hidden, beside, [row, slant]),
                blur,
                noise,
                seed,
            ))
            .markers;
            let (marker, error) = nearest(&found, hidden)
                .unwrap_or_else(|| panic!("blur {blur}, noise {noise}, slant {slant}: not found"));
            println!(
                "blur {blur}, noise {noise}, slant {slant}: off by {:.2} {:.2} px",
                error.x, error.y
            );
            squares += normalised_square(marker, error);
            count += 1;
            assert_eq!(found.len(), 11, "each disc once, and nothing else");
        }
    }
    let normalised = (squares / f64::from(count)).sqrt();
    println!("normalised error {normalised:.2}");
    normalised
}

#[test]
fn the_visible_part_of_a_disc_under_a_decal_determines_its_position() {
    let normalised = normalised_error(&[0.0]);
    assert!(
        (0.5..1.4).contains(&normalised),
        "{normalised} standard deviations"
    );
}

#[test]
fn the_visible_part_of_a_disc_under_a_slanting_decal_determines_its_position() {
    // Slants of the discs, and of decals that are rotated on the skin, or in the image of a rotated camera.
    let normalised = normalised_error(&[-0.16, 0.06, -0.09, 0.1]);
    assert!(
        (0.5..1.4).contains(&normalised),
        "{normalised} standard deviations"
    );
}

#[test]
fn half_a_disc_is_not_measured_as_a_thinner_one() {
    // The visible part under a decal that ends along the disc looks like an ellipse of half its thickness, offset by 3 px.
    let (hidden, beside) = (
        [560.4, 372.0, 51.0, 6.0, 0.0],
        [566.0, 386.5, 51.7, 6.1, 0.0],
    );
    let mut count = 0;
    for (k, row) in [371.7, 372.4, 373.3, 374.2].into_iter().enumerate() {
        for (blur, noise) in [(0.7, 0.6), (1.8, 2.0)] {
            let found = detect(&picture(
                scene(hidden, beside, [row, 0.0]),
                blur,
                noise,
                k as u64,
            ))
            .markers;
            let Some((marker, error)) = nearest(&found, hidden) else {
                continue;
            };
            let normalised = normalised_square(marker, error).sqrt();
            println!(
                "blur {blur}, row {row}: off by {:.2} {:.2} px, {normalised:.2}",
                error.x, error.y
            );
            assert!(
                error.y.abs() < 1.5 && normalised < 3.0,
                "{error:?}, {normalised} standard deviations"
            );
            count += 1;
        }
    }
    assert!(count >= 6, "{count} of 8");
}
