//! Promise: the detector returns a result for every image, independent of the number of threads, with a reason
//! for each rejection.

use nalgebra::Vector2;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use wingd::measure::detect::{Detection, MarkerPrediction, RejectReason, detect, detect_guided};
use wingd::measure::raster::Raster;
use wingd::measure::setup::Shape;
use wingd::measure::view::search_guided;

/// An image of black ellipses on grey, anti-aliased, with noise: centre, semi-axes, direction.
fn picture(width: usize, height: usize, discs: &[[f64; 5]], seed: u64) -> Raster {
    let black: Vec<([f64; 5], f64)> = discs.iter().map(|&disc| (disc, 125.0)).collect();
    hazy_picture(width, height, 0, &black, seed)
}

/// An image with rows of bright sky above, and a separate darkness for each ellipse.
fn hazy_picture(
    width: usize,
    height: usize,
    sky: usize,
    discs: &[([f64; 5], f64)],
    seed: u64,
) -> Raster {
    let mut random = StdRng::seed_from_u64(seed);
    let mut luma = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let mut value: f64 = if y < sky { 215.0 } else { 180.0 };
            for &([cx, cy, a, b, angle], dark) in discs {
                let (dx, dy) = (x as f64 - cx, y as f64 - cy);
                let (s, t) = (
                    dx * angle.cos() + dy * angle.sin(),
                    dy * angle.cos() - dx * angle.sin(),
                );
                let r = (s / a).hypot(t / b).max(1e-9);
                let slope = (s / a / a / r).hypot(t / b / b / r);
                let share = 1.0 / (1.0 + ((r - 1.0) / slope * 2.2).exp());
                value -= dark * share;
            }
            luma.push(
                (value + random.random_range(-2.0..2.0))
                    .round()
                    .clamp(0.0, 255.0) as u8,
            );
        }
    }
    Raster::new(width, height, luma).unwrap()
}

#[test]
fn no_image_causes_a_panic() {
    let mut random = StdRng::seed_from_u64(3);
    for (width, height) in [
        (1, 1),
        (1, 300),
        (300, 1),
        (2, 2),
        (7, 5),
        (64, 64),
        (333, 217),
    ] {
        for fill in [0u8, 255, 77] {
            let found = detect(&Raster::new(width, height, vec![fill; width * height]).unwrap());
            assert!(found.markers.is_empty());
        }
        for _ in 0..4 {
            let noise = (0..width * height).map(|_| random.random::<u8>()).collect();
            let image = Raster::new(width, height, noise).unwrap();
            assert!(detect(&image).rejected.len() <= 200);
            let prediction = MarkerPrediction {
                shape: Shape::Circle,
                centre_px: Vector2::new(random.random_range(-9e3..9e3), f64::NAN),
                semi_major_px: 1e9,
                semi_minor_px: -3.0,
                angle_rad: 9.0,
                search_px: Vector2::repeat(1e9),
                seen: true,
            };
            let _ = detect_guided(&image, &[prediction]);
        }
    }
    for fill in [0u8, 255] {
        let found = detect(&Raster::new(5000, 4000, vec![fill; 20_000_000]).unwrap());
        assert!(found.markers.is_empty());
    }
}

/// Haze reduces contrast with distance: the tips of the last discs are hardly darker than the skin.
#[test]
fn flat_discs_in_haze_are_found() {
    let far = [
        [250.0, 230.0, 45.0, 3.4, 0.1],
        [560.0, 236.0, 42.0, 2.9, 0.14],
        [820.0, 240.0, 44.0, 2.9, 0.12],
    ];
    for seed in 0..20 {
        let mut discs = vec![([450.0, 520.0, 70.0, 14.0, 0.05], 60.0)];
        discs.extend(far.map(|disc| (disc, 22.0)));
        let found = detect(&hazy_picture(1000, 700, 200, &discs, seed));
        for [x, y, ..] in far {
            let off = |m: &Detection| (m.centre_px - Vector2::new(x, y)).norm();
            assert!(
                found.markers.iter().any(|m| off(m) < 1.0),
                "seed {seed}: none at {x}, {y}"
            );
        }
        assert_eq!(found.markers.len(), 4, "seed {seed}");
    }
}

/// A black disc on skin with a seam, blurred by 0.8 px in light, with noise: centre, semi-axes, direction; distance
/// of the seam from the centre along the disc, its direction and its fraction of the skin's light.
fn seamed_picture(
    [cx, cy, a, b, angle]: [f64; 5],
    [beyond, turn, dark]: [f64; 3],
    seed: u64,
) -> Raster {
    const WIDTH: usize = 200;
    const HEIGHT: usize = 100;
    const TONE: f64 = 2.2;
    let (blur, half_width) = (0.8, 0.9);
    let steps: Vec<(f64, f64)> = (-11..=11)
        .map(|k| 0.3 * f64::from(k))
        .map(|z: f64| (z * blur, (-0.5 * z * z).exp()))
        .collect();
    let (sin, cos) = angle.sin_cos();
    let (across_x, across_y) = (-(angle + turn).sin(), (angle + turn).cos());
    let sharp = |x: f64, y: f64| {
        let (dx, dy) = (x - cx, y - cy);
        let (s, t) = (dx * cos + dy * sin, dy * cos - dx * sin);
        let off = (dx - beyond * cos) * across_x + (dy - beyond * sin) * across_y;
        let skin = if off.abs() < half_width {
            190.0 * (1.0 - dark)
        } else {
            190.0
        };
        let grey: f64 = if (s / a).hypot(t / b) < 1.0 {
            50.0
        } else {
            skin
        };
        grey.powf(TONE)
    };
    let mut random = StdRng::seed_from_u64(seed);
    let mut luma = Vec::with_capacity(WIDTH * HEIGHT);
    for i in 0..WIDTH * HEIGHT {
        let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
        let (mut sum, mut weights) = (0.0, 0.0);
        for &(dx, one) in &steps {
            for &(dy, other) in &steps {
                sum += one * other * sharp(x + dx, y + dy);
                weights += one * other;
            }
        }
        let noise: f64 = (0..4).map(|_| random.random_range(-1.0..1.0)).sum();
        luma.push(
            ((sum / weights).powf(1.0 / TONE) + noise)
                .round()
                .clamp(0.0, 255.0) as u8,
        );
    }
    Raster::new(WIDTH, HEIGHT, luma).unwrap()
}

#[test]
fn a_seam_that_meets_a_tip_does_not_shift_the_disc() {
    for turn in [1.0, -0.7] {
        let (mut shift, mut square, mut count) = (0.0, 0.0, 0.0);
        for seed in 0..20 {
            let angle = 0.11 + 0.01 * seed as f64;
            let centre = Vector2::new(95.3 + 0.13 * seed as f64, 46.6 + 0.07 * seed as f64);
            let image = seamed_picture(
                [centre.x, centre.y, 44.0, 5.0, angle],
                [45.0, turn, 0.16],
                seed,
            );
            let found = detect(&image);
            assert_eq!(found.markers.len(), 1, "turn {turn}, seed {seed}");
            let axis = Vector2::new(angle.cos(), angle.sin());
            let along = (found.markers[0].centre_px - centre).dot(&axis);
            let variance = axis.dot(&(*found.markers[0].covariance_px2 * axis));
            shift += along;
            square += along * along / variance;
            count += 1.0;
        }
        let (mean, normalised): (f64, f64) = (shift / count, (square / count).sqrt());
        println!("turn {turn}: mean shift {mean:.3} px, normalised {normalised:.2}");
        assert!(
            mean.abs() < 0.02,
            "turn {turn}: discs are shifted by {mean} px"
        );
        assert!(
            (0.5..1.5).contains(&normalised),
            "turn {turn}: {normalised} standard deviations"
        );
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let image = picture(
        900,
        600,
        &[
            [200.3, 150.6, 40.0, 8.0, 0.2],
            [600.0, 400.0, 30.0, 12.0, -0.4],
        ],
        5,
    );
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| detect(&image))
    };
    let one = with(1);
    assert_eq!(one.markers.len(), 2);
    for threads in [2, 5] {
        assert_eq!(one, with(threads));
    }
}

#[test]
fn a_marker_at_the_edge_of_the_frame_is_rejected_with_the_reason() {
    let image = picture(
        500,
        400,
        &[
            [10.0, 200.0, 40.0, 9.0, 0.1],
            [300.0, 200.0, 40.0, 9.0, 0.1],
        ],
        6,
    );
    let found = detect(&image);
    assert_eq!(found.markers.len(), 1);
    assert!((found.markers[0].centre_px - Vector2::new(300.0, 200.0)).norm() < 0.1);
    let edge = found
        .rejected
        .iter()
        .find(|r| r.centre_px.x < 60.0)
        .expect("the cut marker is named");
    assert_eq!(edge.reason, RejectReason::TouchesEdge);
}

#[test]
fn squares_and_letters_are_not_markers() {
    let mut luma = vec![180u8; 600 * 400];
    for (x0, y0, w, h) in [
        (50, 50, 30, 18),
        (120, 60, 16, 8),
        (300, 200, 60, 14),
        (400, 300, 12, 12),
    ] {
        for y in y0..y0 + h {
            luma[y * 600 + x0..y * 600 + x0 + w].fill(60);
        }
    }
    let found = detect(&Raster::new(600, 400, luma).unwrap());
    assert!(found.markers.is_empty(), "{:?}", found.markers);
}

/// Prediction of a marker that is present, with a small error.
fn offset_prediction(marker: &Detection) -> MarkerPrediction {
    MarkerPrediction {
        shape: marker.shape,
        centre_px: marker.centre_px + Vector2::new(6.0, -4.0),
        semi_major_px: marker.semi_major_px * 1.03,
        semi_minor_px: marker.semi_minor_px * 0.95,
        angle_rad: marker.angle_rad,
        search_px: Vector2::repeat(12.0),
        seen: true,
    }
}

#[test]
fn a_failed_prediction_causes_a_full_search() {
    let image = picture(
        900,
        600,
        &[
            [200.3, 150.6, 40.0, 8.0, 0.2],
            [600.0, 400.0, 30.0, 12.0, -0.4],
        ],
        5,
    );
    let whole = detect(&image);
    let guided_or_full = |predictions: &[MarkerPrediction]| {
        search_guided(&mut &image, predictions, |_| None, &mut |_| ()).0
    };
    let mut predictions: Vec<MarkerPrediction> =
        whole.markers.iter().map(offset_prediction).collect();
    assert_eq!(
        guided_or_full(&predictions),
        detect_guided(&image, &predictions)
    );
    predictions[1].centre_px.y -= 150.0;
    assert_eq!(detect_guided(&image, &predictions).markers.len(), 1);
    assert_eq!(guided_or_full(&predictions), whole);
    assert_eq!(guided_or_full(&[]), whole);
}

#[test]
fn search_windows_give_the_results_of_the_full_search() {
    let discs = [
        [400.4, 350.6, 60.0, 12.0, 0.2],
        [1500.2, 800.7, 45.0, 6.0, -0.1],
        [2100.0, 1500.5, 30.0, 4.0, 0.0],
    ];
    let image = picture(2400, 1800, &discs, 8);
    let whole = detect(&image);
    assert_eq!(whole.markers.len(), 3);
    let predictions: Vec<MarkerPrediction> = whole.markers.iter().map(offset_prediction).collect();
    let guided = detect_guided(&image, &predictions);
    assert_eq!(guided.markers.len(), 3);
    for (one, other) in whole.markers.iter().zip(&guided.markers) {
        for k in 0..2 {
            let sigma = one.covariance_px2[(k, k)].sqrt();
            let off = (one.centre_px[k] - other.centre_px[k]).abs() / sigma;
            assert!(off < 0.01, "{:?}: {off} standard deviations", one.centre_px);
        }
    }
}
