//! Promise: a target that moves during the exposure is measured like a static one.

use crate::common::drawn::{
    Ellipse, TONE, discs, nearest, normalised_square, on_skin, picture, quadrants,
};
use wingd::measure::detect::detect;

/// A scene that moves along rows by `by` px during the exposure.
fn blur_along_rows(scene: impl Fn(f64, f64) -> f64, by: f64) -> impl Fn(f64, f64) -> f64 {
    const PARTS: u32 = 8;
    move |x, y| {
        let part = |k: u32| by * ((f64::from(k) + 0.5) / f64::from(PARTS) - 0.5);
        let light: f64 = (0..PARTS).map(|k| scene(x + part(k), y).powf(TONE)).sum();
        (light / f64::from(PARTS)).powf(1.0 / TONE)
    }
}

/// Normalised error of the markers of a moving scene; all are found, and nothing else.
fn normalised(markers: &[Ellipse], scene: impl Fn(f64, f64) -> f64) -> f64 {
    let (mut squares, mut count) = (0.0, 0);
    for seed in 0..3 {
        let found = detect(&picture(blur_along_rows(&scene, 5.0), 0.8, 1.5, seed)).markers;
        assert_eq!(found.len(), markers.len(), "seed {seed}");
        for &marker in markers {
            let (m, error) = nearest(&found, marker).expect("it is found");
            assert!(error.norm() < 0.3, "{marker:?} is off by {error}");
            squares += normalised_square(m, error);
            count += 1;
        }
    }
    let normalised = (squares / f64::from(count)).sqrt();
    println!("normalised error {normalised:.2}");
    normalised
}

/// One edge is nearly parallel to the motion, the other perpendicular: 0.85 px and 1.7 px of blur.
#[test]
fn quadrants_are_measured_whatever_the_blur_of_each_edge() {
    let targets: [Ellipse; 2] = [
        [260.3, 210.6, 112.0, 20.0, 0.1],
        [640.7, 205.2, 112.0, 24.0, 0.1],
    ];
    let scenes = targets.map(|target| quadrants(target, 0.1, [160.0, 60.0, 235.0]));
    let scene = move |x: f64, y: f64| {
        if x < 450.0 {
            scenes[0](x, y)
        } else {
            scenes[1](x, y)
        }
    };
    // The remaining effect of the motion's shape makes standard deviations of 0.02 px too large rather than too small.
    let normalised = normalised(&targets, scene);
    assert!(
        (0.25..1.4).contains(&normalised),
        "{normalised} standard deviations"
    );
}

#[test]
fn flat_discs_are_found() {
    let discs = discs();
    // Their ends are softer than their sides, unlike the single blur of the model.
    let normalised = normalised(&discs, on_skin(&discs, 190.0, 50.0));
    assert!(
        (0.6..2.0).contains(&normalised),
        "{normalised} standard deviations"
    );
}
