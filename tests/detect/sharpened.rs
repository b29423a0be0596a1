//! Promise: sharpened images are measured like unsharpened ones, with consistent standard deviations.

use wingd::measure::detect::{Detections, detect};
use wingd::measure::raster::Raster;

use crate::common::drawn::{
    Ellipse, HEIGHT, TONE, WIDTH, blurred, discs, nearest, normalised_square, on_skin, quadrants,
};
use crate::common::random::{normal, rng};

/// Sharpens grey values as cameras do: adds `amplitude` times the difference from a blurred copy.
fn sharpened(grey: &[f64], amplitude: f64, halo_px: f64) -> Vec<f64> {
    let weights: Vec<(isize, f64)> = (-8..=8)
        .map(|k: isize| (k, (-0.5 * (k as f64 / halo_px).powi(2)).exp()))
        .collect();
    let total: f64 = weights.iter().map(|w| w.1).sum();
    let passed = |from: &[f64], along_x: bool| -> Vec<f64> {
        let at = |x: isize, y: isize| {
            from[y.clamp(0, HEIGHT as isize - 1) as usize * WIDTH
                + x.clamp(0, WIDTH as isize - 1) as usize]
        };
        let one = |i: usize| {
            let (x, y) = ((i % WIDTH) as isize, (i / WIDTH) as isize);
            let one =
                |&(k, w): &(isize, f64)| w * if along_x { at(x + k, y) } else { at(x, y + k) };
            weights.iter().map(one).sum::<f64>() / total
        };
        (0..WIDTH * HEIGHT).map(one).collect()
    };
    let copy = passed(&passed(grey, true), false);
    grey.iter()
        .zip(copy)
        .map(|(v, copy)| v + amplitude * (v - copy))
        .collect()
}

/// Renders a scene with noise, then sharpens, then rounds it, and detects its markers.
fn detect_sharpened(light: &[f64], (amplitude, halo_px): (f64, f64), seed: u64) -> Detections {
    let mut random = rng(seed);
    let grey: Vec<f64> = light
        .iter()
        .map(|v| v.powf(1.0 / TONE) + 1.2 * normal(&mut random))
        .collect();
    let luma: Vec<u8> = sharpened(&grey, amplitude, halo_px)
        .iter()
        .map(|v| v.round().clamp(0.0, 255.0) as u8)
        .collect();
    detect(&Raster::new(WIDTH, HEIGHT, luma).unwrap())
}

/// All markers are found at any strength, with consistent standard deviations, and the strength is estimated.
fn assert_consistent_when_sharpened(markers: &[Ellipse], scene: impl Fn(f64, f64) -> f64) {
    let light = blurred(scene, 0.8);
    for (amplitude, halo_px) in [(0.8, 1.4), (1.6, 1.4)] {
        let mut squares = Vec::new();
        for seed in 0..4 {
            let found = detect_sharpened(&light, (amplitude, halo_px), seed);
            let overshoot = found.overshoot.expect("it shows");
            // An edge determines the product: the difference from a slightly more blurred copy.
            let strength = |amplitude: f64, halo_px: f64| amplitude * halo_px * halo_px;
            let ratio =
                strength(overshoot.amplitude, overshoot.halo_px) / strength(amplitude, halo_px);
            assert!(
                (0.6..1.6).contains(&ratio),
                "{overshoot:?} for {amplitude}, {halo_px}"
            );
            let near = markers.iter().filter_map(|&m| nearest(&found.markers, m));
            squares.extend(near.map(|(m, error)| normalised_square(m, error)));
        }
        let normalised = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        println!(
            "sharpened by {amplitude}: {} found, normalised error {normalised:.2}",
            squares.len()
        );
        assert_eq!(squares.len(), 4 * markers.len());
        // Sharpened noise is fine-grained: structures as large as a marker keep their size, the residuals grow by up to 1 + a, and
        // with them the standard deviations.
        let least = 1.0 / (1.0 + amplitude);
        assert!(
            (least..1.4).contains(&normalised),
            "{normalised} standard deviations"
        );
    }
}

#[test]
fn sharpened_discs_have_consistent_sigmas() {
    let discs = discs().map(|[x, y, a, _, angle]| [x, y, a, 0.28 * a, angle]);
    assert_consistent_when_sharpened(&discs, on_skin(&discs, 150.0, 60.0));
}

#[test]
fn sharpened_quadrants_have_consistent_sigmas() {
    let targets: [Ellipse; 6] = std::array::from_fn(|k| {
        [
            150.3 + 290.2 * (k % 3) as f64,
            110.4 + 190.3 * (k / 3) as f64,
            80.0,
            26.0,
            0.1 - 0.03 * k as f64,
        ]
    });
    let scenes = targets.map(|target| quadrants(target, 0.4, [140.0, 60.0, 190.0]));
    assert_consistent_when_sharpened(&targets, move |x, y| {
        scenes[(x / 300.0).min(2.0) as usize + 3 * usize::from(y > 210.0)](x, y)
    });
}

#[test]
fn an_unsharpened_image_is_not_taken_for_sharpened() {
    let discs = discs();
    let light = blurred(on_skin(&discs, 190.0, 50.0), 0.8);
    for seed in 0..3 {
        assert_eq!(detect_sharpened(&light, (0.0, 1.0), seed).overshoot, None);
    }
}
