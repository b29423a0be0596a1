//! Promise: with strong noise, blur and dirt all markers are found and their standard deviations stay consistent.

use crate::common::drawn::{
    Ellipse, WIDTH, assert_consistent, blurred, discs, errors_in_images, errors_in_scene,
    is_within, measured, nearest, normalised, normalised_square, on_skin, place_on_skin, quadrants,
    read_part_on_skin, soft, with_noise,
};
use nalgebra::Vector2;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use wingd::measure::detect::detect;
use wingd::measure::setup::Shape;

#[test]
fn discs_whose_outline_noise_frays_are_found() {
    let flat = discs().map(|[x, y, a, _, angle]| [x, y, a, 0.095 * a, angle]);
    assert_consistent(
        &errors_in_scene(&flat, on_skin(&flat, 76.0, 30.0), 1.5, 8.0),
        51,
    );
}

#[test]
fn discs_are_found_in_the_noisier_part_of_a_frame() {
    // Nearly all of the frame is even: its noise is that of rounding.
    let light = blurred(on_skin(&discs(), 140.0, 104.0), 0.8);
    let placed = discs().map(|[x, y, a, b, angle]| [x + 1000.0, y + 800.0, a, b, angle]);
    let squares = errors_in_images(&placed, |seed| {
        place_on_skin(WIDTH, with_noise(&light, 4.0, seed).luma(), 140)
    });
    assert_consistent(&squares, 53);
}

#[test]
fn markers_that_are_all_faint_are_found() {
    // Veiling glare leaves 10 % of the contrast: at the default thresholds nothing is visible.
    let discs = discs();
    assert_consistent(
        &errors_in_scene(&discs, on_skin(&discs, 180.0, 163.0), 1.0, 1.0),
        54,
    );
}

#[test]
fn dirt_next_to_a_disc_does_not_shift_it() {
    let discs = discs();
    let stained = |x: f64, y: f64| {
        // A soft spot above the middle of each.
        let spot = |d: &Ellipse| {
            let (sin, cos) = f64::sin_cos(d[4]);
            let (along, across) = (0.3 * 16.0, -1.9 * 4.0);
            soft(
                [
                    d[0] + along * cos - across * sin,
                    d[1] + along * sin + across * cos,
                    16.0,
                    4.0,
                    d[4],
                ],
                x,
                y,
            )
        };
        let skin = 165.0 - 16.0 * discs.iter().map(spot).sum::<f64>();
        if discs.iter().any(|&d| is_within(d, x, y)) {
            60.0
        } else {
            skin
        }
    };
    let (mut sum, mut square, mut count) = (Vector2::zeros(), 0.0, 0.0);
    let light = blurred(stained, 1.0);
    for seed in 0..4 {
        let markers = detect(&with_noise(&light, 2.0, seed)).markers;
        for &disc in &discs {
            let (m, error) = nearest(&markers, disc).expect("the disc is found");
            sum += error;
            square += normalised_square(m, error);
            count += 1.0;
        }
    }
    let (mean, normalised) = (sum / count, f64::sqrt(square / count));
    println!(
        "mean shift {:.3} {:.3} px, normalised {normalised:.2}",
        mean.x, mean.y
    );
    assert!(mean.y.abs() < 0.02, "shifted by {} px across", mean.y);
    assert!(
        (0.4..1.6).contains(&normalised),
        "{normalised} standard deviations"
    );
}

#[test]
fn the_white_determines_the_length_of_flat_quadrants() {
    // Two thin crescents along the outline are black.
    let target: Ellipse = [450.2, 200.7, 70.0, 8.5, -0.1];
    let scene = quadrants(target, 0.877, [160.0, 45.0, 225.0]);
    let light = blurred(scene, 1.7);
    for seed in 0..3 {
        let m = measured(&with_noise(&light, 2.0, seed), target, 9.0);
        assert!(
            (m.semi_major_px / 70.0 - 1.0).abs() < 0.1,
            "{} px long",
            m.semi_major_px
        );
    }
}

#[test]
fn quadrants_seen_against_two_thresholds_are_found() {
    // The right black part is a blob of 450 px, the left one of 600.
    measured(
        &read_part_on_skin("quadrants.png", 195),
        [1119.774, 880.201, 83.5, 12.2, -0.1],
        12.0,
    );
}

#[test]
fn quadrants_with_thin_black_ends_far_from_the_middle_are_found() {
    // Next to the white the skin looks dark, and the dark region in the reduced image is half as long as the black.
    measured(
        &read_part_on_skin("line.png", 146),
        [1080.441, 841.469, 38.0, 4.8, -0.12],
        9.0,
    );
}

#[test]
fn a_disc_whose_tip_a_line_touches_is_found_in_back_light() {
    // The line lowers the background there, and the threshold with it: the blob looks cut.
    measured(
        &read_part_on_skin("disc.png", 116),
        [1175.604, 918.340, 68.2, 6.9, -0.1],
        12.0,
    );
}

#[test]
fn two_discs_in_a_row_are_not_taken_for_narrow_quadrants() {
    let image = read_part_on_skin("row.png", 205);
    for [x, y] in [[1138.604, 860.410], [1220.763, 853.861]] {
        let m = measured(&image, [x, y, 34.4, 3.9, -0.07], 9.0);
        assert!((m.semi_major_px - 34.4).abs() < 0.5 && m.shape == Shape::Circle);
    }
}

#[test]
fn two_discs_in_a_row_with_no_white_between_them_are_not_taken_for_narrow_quadrants() {
    // Dirt next to the second disc, which therefore does not look like a complete disc.
    let image = read_part_on_skin("stained.png", 190);
    for [x, y, a, angle] in [
        [1146.685, 934.559, 40.4, -0.13],
        [1244.795, 918.556, 39.8, -0.07],
    ] {
        let m = measured(&image, [x, y, a, 3.7, angle], 12.0);
        assert_eq!(m.shape, Shape::Circle);
    }
}

#[test]
fn a_disc_between_the_sky_and_white_is_found_in_haze() {
    // The background changes between sky, skin and white from pixel to pixel.
    let m = measured(
        &read_part_on_skin("sky.png", 177),
        [1130.454, 939.438, 74.6, 5.7, -0.13],
        9.0,
    );
    assert_eq!(m.shape, Shape::Circle);
}

#[test]
fn quadrants_as_flat_as_one_to_seventeen_are_found() {
    let target: Ellipse = [450.2, 200.7, 60.0, 3.6, 0.12];
    let scene = quadrants(target, 0.785, [170.0, 100.0, 225.0]);
    let light = blurred(scene, 0.9);
    for seed in 0..3 {
        let m = measured(&with_noise(&light, 1.5, seed), target, 9.0);
        assert_eq!(m.shape, Shape::Quadrant);
    }
}

#[test]
fn quadrants_are_found_if_blur_leaves_black_only_in_the_middle() {
    let target: Ellipse = [450.2, 200.7, 60.0, 5.6, 0.12];
    let mut squares = Vec::new();
    for (turn, noise) in [(0.785, 2.0), (0.785, 5.0), (0.85, 3.0), (0.72, 3.0)] {
        let scene = quadrants(target, turn, [165.0, 60.0, 215.0]);
        squares.extend(errors_in_scene(&[target], scene, 1.9, noise));
    }
    assert_consistent(&squares, 22);
}

#[test]
fn narrow_quadrants_that_a_seam_crosses_are_found() {
    // One edge is as long as the target, the other a few pixels: its curvature must be known in advance.
    let m = measured(
        &read_part_on_skin("seam.png", 171),
        [1122.526, 865.279, 49.2, 3.1, -0.095],
        9.0,
    );
    assert_eq!(m.shape, Shape::Quadrant);
}

#[test]
fn quadrants_with_white_far_from_the_remaining_black_are_found() {
    // Blur has left 20 px of black in the middle of 117.
    let m = measured(
        &read_part_on_skin("middle.png", 167),
        [1123.979, 866.028, 58.0, 4.0, -0.09],
        9.0,
    );
    assert_eq!(m.shape, Shape::Quadrant);
}

#[test]
fn quadrants_that_blur_makes_narrow_are_found() {
    // Plain to the eye, but black is two slivers, two lobes joined by white, or the middle only.
    let sizes = [[73.0, 10.0], [58.0, 6.5], [40.0, 10.0], [40.0, 7.0]];
    // Too few to estimate a common blur.
    let mut squares = Vec::new();
    for first in [0.25, 0.6, 0.95, 1.3] {
        let targets: [(Ellipse, f64); 4] = std::array::from_fn(|k| {
            let (x, y) = (
                225.3 + 446.1 * (k % 2) as f64,
                110.4 + 200.2 * (k / 2) as f64,
            );
            let [a, b] = sizes[k];
            ([x, y, a, b, 0.17 - 0.08 * k as f64], first + 0.1 * k as f64)
        });
        let scene = |x: f64, y: f64| {
            let target = targets.iter().find(|(target, _)| is_within(*target, x, y));
            target.map_or(165.0, |&(target, turn)| {
                quadrants(target, turn, [165.0, 60.0, 215.0])(x, y)
            })
        };
        squares.extend(errors_in_scene(&targets.map(|t| t.0), scene, 2.0, 2.0));
    }
    assert_consistent(&squares, 93);
}

#[test]
fn pale_quadrants_before_skin_that_is_darker_than_their_white_are_found() {
    let target: Ellipse = [450.2, 200.7, 186.0, 55.0, -0.1];
    let scene = quadrants(target, 0.6, [125.0, 105.0, 149.0]);
    let light = blurred(scene, 2.0);
    for seed in 0..3 {
        measured(&with_noise(&light, 2.0, seed), target, 9.0);
    }
}

/// None of them is determined to a third of a pixel.
#[test]
fn discs_thinner_than_their_blur_are_found_in_strong_noise() {
    let thin = discs().map(|[x, y, a, _, angle]| [x, y, a, 0.05 * a, angle]);
    let squares = errors_in_scene(&thin, on_skin(&thin, 165.0, 60.0), 2.0, 7.0);
    assert_consistent(&squares, 53);
}

#[test]
fn discs_thinner_than_their_blur_are_found() {
    let thin = discs().map(|[x, y, a, _, angle]| [x, y, a, 0.05 * a, angle]);
    assert_consistent(
        &errors_in_scene(&thin, on_skin(&thin, 165.0, 60.0), 2.0, 4.0),
        53,
    );
}

/// Soft spots as foreshortened as the discs, 8 to 11 px from their outline.
#[test]
fn dirt_near_thin_discs_hardly_shifts_them() {
    let thin = discs().map(|[x, y, a, _, angle]| [x, y, 1.2 * a, 0.08 * a, angle]);
    let mut random = StdRng::seed_from_u64(11);
    let mut squares = Vec::new();
    for _ in 0..4 {
        let spots = thin.map(|[x, y, a, b, angle]| {
            let mut between = |low: f64, high: f64| random.random_range(low..high);
            let side = if between(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
            let (along, across) = (between(-0.8, 0.8) * a, side * (b + between(8.0, 11.0)));
            let (sin, cos) = f64::sin_cos(angle);
            let (x, y) = (
                x + along * cos - across * sin,
                y + along * sin + across * cos,
            );
            (
                [x, y, between(0.4, 1.0) * a, 3.0, angle],
                between(0.03, 0.15),
            )
        });
        let stained = |x: f64, y: f64| {
            let dark = |(spot, depth): &(Ellipse, f64)| 1.0 - depth * soft(*spot, x, y);
            let skin = 165.0 * spots.iter().map(dark).product::<f64>();
            if thin.iter().any(|&d| is_within(d, x, y)) {
                60.0
            } else {
                skin
            }
        };
        squares.extend(errors_in_scene(&thin, stained, 1.5, 2.0));
    }
    // The edges of the spots still reach the skin samples.
    let normalised = normalised(&squares, 214);
    assert!(
        (0.4..1.6).contains(&normalised),
        "{normalised} standard deviations"
    );
}

#[test]
fn a_thin_disc_lengthened_by_a_smear_is_measured_longer() {
    let thin = discs().map(|[x, y, a, _, angle]| [x, y, a, 0.06 * a, angle]);
    let [x, y, a, b, angle] = thin[4];
    // As dark as the disc and adjacent to its end.
    let smear = [x + 5.0, y + 5.0 * angle, a, b, angle];
    let both: Vec<Ellipse> = thin.into_iter().chain([smear]).collect();
    let light = blurred(on_skin(&both, 165.0, 60.0), 2.0);
    for seed in 0..4 {
        let m = measured(&with_noise(&light, 2.0, seed), thin[4], 4.0);
        assert!(m.semi_major_px > a + 1.5, "the smear shows");
    }
}

/// Blur removes the region between the black parts: the remaining ones are four semi-minor axes apart.
#[test]
fn quadrants_whose_black_parts_are_separated_by_blur_are_found() {
    let target = [450.4, 210.3, 78.0, 7.0, 0.1];
    let squares = errors_in_scene(
        &[target],
        quadrants(target, 0.12, [190.0, 60.0, 235.0]),
        2.0,
        1.0,
    );
    assert_consistent(&squares, 6);
}
