//! Promise: with glare partly visible discs are found and standard deviations stay consistent.

use crate::common::drawn::{
    TONE, discs, expected_discs, measured, nearest, normalised_square, on_skin, picture,
};
use nalgebra::Vector2;
use wingd::measure::detect::{Detection, detect, second_pass};

/// Adds reflected light of a grey value from a column on, with a slope of `width` px.
fn with_glare(
    scene: impl Fn(f64, f64) -> f64,
    grey: f64,
    [from, to]: [f64; 2],
    slope: f64,
) -> impl Fn(f64, f64) -> f64 {
    move |x, y| {
        let x = x + 0.3 * (y - 200.0);
        let share = 1.0 / (1.0 + (-(x - from) / slope).exp()) / (1.0 + ((x - to) / slope).exp());
        (scene(x - 0.3 * (y - 200.0), y).powf(TONE) + share * grey.powf(TONE)).powf(1.0 / TONE)
    }
}

#[test]
fn a_disc_that_ends_in_glare_is_measured_with_a_consistent_sigma() {
    let discs = discs();
    // The middle disc of the second row.
    let occluded = discs[4];
    let mut square = 0.0;
    for (seed, share) in [0.35f64, 0.2, 0.05].into_iter().enumerate() {
        let from = occluded[0] + share * occluded[2] + 0.3 * (occluded[1] - 200.0);
        let scene = with_glare(
            on_skin(&discs, 160.0, 55.0),
            420.0,
            [from, from + 80.0],
            3.0,
        );
        let markers = detect(&picture(scene, 0.9, 1.5, seed as u64)).markers;
        let (m, error) = nearest(&markers, occluded).expect("the disc is found");
        println!(
            "glare from {share}: {error:.2?}, variances {:.3?}",
            m.covariance_px2.diagonal()
        );
        assert!(error.norm() < 2.0, "glare from {share}: off by {error}");
        square += normalised_square(m, error) / 3.0;
        assert!(
            nearest(&markers, discs[3]).is_some_and(|(_, error)| error.norm() < 0.3),
            "its neighbour"
        );
    }
    assert!(
        (0.4..2.0).contains(&square.sqrt()),
        "{} standard deviations",
        square.sqrt()
    );
    // A completely hidden disc is not reported.
    let from = occluded[0] - 0.7 * occluded[2] + 0.3 * (occluded[1] - 200.0);
    let scene = with_glare(
        on_skin(&discs, 160.0, 55.0),
        420.0,
        [from, from + 90.0],
        3.0,
    );
    let markers = detect(&picture(scene, 0.9, 1.5, 9)).markers;
    let near = |m: &&Detection| {
        (m.centre_px - Vector2::new(occluded[0], occluded[1])).norm() < occluded[2]
    };
    assert_eq!(markers.iter().find(near), None);
}

#[test]
fn a_disc_that_shows_through_glare_is_measured_through_it() {
    let discs = discs();
    let mut squares = Vec::new();
    for (seed, share) in [-0.45, -0.3, 0.0, 0.2, 0.4].into_iter().enumerate() {
        // From the middle disc of the first row to that of the third.
        let veiled = discs[1 + 3 * (seed % 3)];
        let middle = veiled[0] + share * veiled[2] + 0.3 * (veiled[1] - 200.0);
        let scene = with_glare(
            on_skin(&discs, 140.0, 60.0),
            300.0,
            [middle - 12.0, middle + 12.0],
            4.0,
        );
        let markers = detect(&picture(scene, 0.9, 1.5, seed as u64)).markers;
        let (m, error) = nearest(&markers, veiled).expect("the disc is found");
        println!(
            "glare at {share}: {error:.3?}, variances {:.4?}",
            m.covariance_px2.diagonal()
        );
        assert!(error.norm() < 0.3, "glare at {share}: off by {error}");
        squares.push(normalised_square(m, error));
    }
    let square = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!(
        (0.2..1.6).contains(&square.sqrt()),
        "{} standard deviations",
        square.sqrt()
    );
}

/// Multiplies the light in a band of 120 px from a column on, with a slope in px.
fn with_light(
    scene: impl Fn(f64, f64) -> f64,
    times: f64,
    from: f64,
    slope: f64,
) -> impl Fn(f64, f64) -> f64 {
    move |x, y| {
        let along = x + 0.3 * (y - 200.0) - from;
        let share = 1.0 / (1.0 + (-along / slope).exp()) / (1.0 + ((along - 120.0) / slope).exp());
        (scene(x, y).powf(TONE) * (1.0 + (times - 1.0) * share)).powf(1.0 / TONE)
    }
}

#[test]
fn a_disc_whose_end_is_saturated_is_not_taken_for_a_shorter_one() {
    let discs = discs();
    let cut = discs[4];
    for (seed, share) in [0.5, 0.7, 0.8, 0.9, 1.0, 1.1].into_iter().enumerate() {
        let from = cut[0] + share * cut[2] + 0.3 * (cut[1] - 200.0);
        let scene = with_light(on_skin(&discs, 180.0, 62.0), 31.0, from, 3.0);
        println!("saturated from {share} on:");
        let m = measured(&picture(scene, 0.9, 1.5, seed as u64), cut, 8.0);
        assert!(
            (m.semi_major_px - cut[2]).abs() < 1.5,
            "{share}: {:.1} px long",
            m.semi_major_px
        );
    }
}

#[test]
fn a_disc_hidden_by_glare_except_for_its_ends_is_found_if_its_size_is_known() {
    let discs = discs();
    let mut square = 0.0;
    // Saturated range along the disc, in semi-axes.
    let bands = [[-0.6, 0.6], [-0.9, 0.2], [-1.3, 0.1], [-0.15, 1.2]];
    for (seed, band) in bands.into_iter().enumerate() {
        let [x, y, a, ..] = discs[4];
        let columns = band.map(|share| x + share * a + 0.3 * (y - 200.0));
        let scene = with_glare(on_skin(&discs, 160.0, 55.0), 420.0, columns, 2.0);
        let image = picture(scene, 0.9, 1.5, seed as u64);
        let mut found = detect(&image);
        second_pass(
            &image,
            &mut found,
            &expected_discs(&discs, &detect(&image).markers),
        );
        let (m, error) = nearest(&found.markers, discs[4]).expect("the disc is found");
        println!(
            "glare at {band:?}: {error:.3?}, variances {:.4?}",
            m.covariance_px2.diagonal()
        );
        assert!(error.norm() < 0.6, "glare at {band:?}: off by {error}");
        square += normalised_square(m, error) / bands.len() as f64;
    }
    assert!(
        (0.2..1.6).contains(&square.sqrt()),
        "{} standard deviations",
        square.sqrt()
    );
}

#[test]
fn a_disc_fully_hidden_by_glare_is_not_reported_even_if_its_size_is_known() {
    let discs = discs();
    let [x, y, a, ..] = discs[4];
    let columns = [-1.2, 0.9].map(|share| x + share * a + 0.3 * (y - 200.0));
    let scene = with_glare(on_skin(&discs, 160.0, 55.0), 420.0, columns, 2.0);
    let image = picture(scene, 0.9, 1.5, 1);
    let mut found = detect(&image);
    second_pass(
        &image,
        &mut found,
        &expected_discs(&discs, &detect(&image).markers),
    );
    let near = |m: &&Detection| (m.centre_px - Vector2::new(x, y)).norm() < a;
    assert_eq!(found.markers.iter().find(near), None);
    assert!(
        found.markers.len() >= 7,
        "{} others are found",
        found.markers.len()
    );
}
