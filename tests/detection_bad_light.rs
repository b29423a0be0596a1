//! Promise: strong noise, glare and dirt cost neither a marker nor its standard deviations their truth.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Cholesky, Vector2};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use wingd::measure::detect::{Detection, detect};
use wingd::measure::raster::Raster;
use wingd::measure::setup::Shape;

const WIDTH: usize = 900;
const HEIGHT: usize = 420;
const TONE: f64 = 2.2;
/// Samples per pixel and direction.
const FINE: usize = 3;

/// An ellipse: centre, semi-axes, direction; px, rad.
type Ellipse = [f64; 5];

/// Along and across an ellipse, in semi-axes.
fn local([cx, cy, a, b, angle]: Ellipse, x: f64, y: f64) -> (f64, f64) {
    let (sin, cos) = angle.sin_cos();
    let (dx, dy) = (x - cx, y - cy);
    ((dx * cos + dy * sin) / a, (dy * cos - dx * sin) / b)
}

fn within(ellipse: Ellipse, x: f64, y: f64) -> bool {
    let (s, t) = local(ellipse, x, y);
    s.hypot(t) < 1.0
}

/// A sharp scene of grey values, blurred in light (px), with normal noise (grey levels).
fn picture(scene: impl Fn(f64, f64) -> f64, blur: f64, noise: f64, seed: u64) -> Raster {
    let mut light = vec![0.0; WIDTH * HEIGHT];
    for (i, light) in light.iter_mut().enumerate() {
        for k in 0..FINE * FINE {
            let part = |k: usize| (k as f64 + 0.5) / FINE as f64 - 0.5;
            let (x, y) = ((i % WIDTH) as f64 + part(k % FINE), (i / WIDTH) as f64 + part(k / FINE));
            *light += scene(x, y).powf(TONE) / (FINE * FINE) as f64;
        }
    }
    let weights: Vec<(isize, f64)> =
        (-8..=8).map(|k: isize| (k, (-0.5 * (k as f64 / blur).powi(2)).exp())).collect();
    let total: f64 = weights.iter().map(|w| w.1).sum();
    let passed = |from: &[f64], along_x: bool| -> Vec<f64> {
        let at = |x: isize, y: isize| {
            from[y.clamp(0, HEIGHT as isize - 1) as usize * WIDTH + x.clamp(0, WIDTH as isize - 1) as usize]
        };
        (0..WIDTH * HEIGHT)
            .map(|i| {
                let (x, y) = ((i % WIDTH) as isize, (i / WIDTH) as isize);
                let one = |&(k, w): &(isize, f64)| w * if along_x { at(x + k, y) } else { at(x, y + k) };
                weights.iter().map(one).sum::<f64>() / total
            })
            .collect()
    };
    let blurred = passed(&passed(&light, true), false);
    let mut random = StdRng::seed_from_u64(seed);
    let luma = blurred.iter().map(|v| {
        let normal: f64 = (0..12).map(|_| random.random_range(-0.5..0.5)).sum();
        (v.powf(1.0 / TONE) + noise * normal).round().clamp(0.0, 255.0) as u8
    });
    Raster::new(WIDTH, HEIGHT, luma.collect()).unwrap()
}

fn nearest(found: &[Detection], ellipse: Ellipse) -> Option<(&Detection, Vector2<f64>)> {
    let off = |m: &Detection| m.centre_px - Vector2::new(ellipse[0], ellipse[1]);
    let best = found.iter().min_by(|a, b| off(a).norm().total_cmp(&off(b).norm()))?;
    (off(best).norm() < 5.0).then(|| (best, off(best)))
}

/// The error's square over what is stated, per coordinate.
fn normalised_square(m: &Detection, error: Vector2<f64>) -> f64 {
    0.5 * error.dot(&Cholesky::new(m.covariance_px2).unwrap().solve(&error))
}

/// Discs that shrink upwards and to the right, as on a wing.
fn discs() -> [Ellipse; 9] {
    std::array::from_fn(|k| {
        let (x, y) = (130.3 + 300.1 * (k % 3) as f64, 80.4 + 120.2 * (k / 3) as f64);
        let a = 36.0 + 0.05 * y - 0.006 * x;
        [x, y, a, 0.12 * a, 0.12 - 0.02 * (k % 3) as f64]
    })
}

/// Black on skin, grey levels.
fn on_skin(discs: &[Ellipse], skin: f64, black: f64) -> impl Fn(f64, f64) -> f64 {
    move |x, y| if discs.iter().any(|&d| within(d, x, y)) { black } else { skin }
}

/// The squares of the normalised errors of the markers that are found in a scene, drawn with six seeds, which shows nothing
/// else.
fn found_of(markers: &[Ellipse], scene: impl Fn(f64, f64) -> f64, blur: f64, noise: f64) -> Vec<f64> {
    let mut squares = Vec::new();
    for seed in 0..6 {
        let found = detect(&picture(&scene, blur, noise, seed)).markers;
        assert!(found.len() <= markers.len(), "seed {seed}: {} markers", found.len());
        let near = markers.iter().filter_map(|&marker| nearest(&found, marker));
        squares.extend(near.map(|(m, error)| normalised_square(m, error)));
    }
    squares
}

/// The normalised error of those that are found, at least so many.
fn normalised(squares: &[f64], least: usize) -> f64 {
    let found = squares.len();
    let normalised = (squares.iter().sum::<f64>() / found as f64).sqrt();
    println!("{found} found, normalised error {normalised:.2}");
    assert!(found >= least, "{found} are found");
    normalised
}

/// At least so many are found, and what they state is what they are off.
fn hold(squares: &[f64], least: usize) {
    let normalised = normalised(squares, least);
    assert!((0.7..1.3).contains(&normalised), "{normalised} standard deviations");
}

/// The marker at a place, whose normalised error's square is less than `most`.
fn measured(image: &Raster, marker: Ellipse, most: f64) -> Detection {
    let markers = detect(image).markers;
    let (m, error) = nearest(&markers, marker).expect("it is found");
    println!("{:.1} x {:.1} px, off by {:.3} {:.3} px", m.semi_major_px, m.semi_minor_px, error.x, error.y);
    assert!(normalised_square(m, error) < most, "off by {error}");
    m.clone()
}

#[test]
fn discs_whose_outline_noise_frays_are_found() {
    let flat = discs().map(|[x, y, a, _, angle]| [x, y, a, 0.095 * a, angle]);
    hold(&found_of(&flat, on_skin(&flat, 76.0, 30.0), 1.5, 8.0), 51);
}

/// Light that is mirrored, as much as of a grey value: added to everything from some column on, with a slope of so many px.
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
fn a_disc_that_ends_in_glare_is_measured_and_says_how_well() {
    let discs = discs();
    // The middle one of the second row.
    let drowned = discs[4];
    let mut square = 0.0;
    for (seed, share) in [0.35f64, 0.2, 0.05].into_iter().enumerate() {
        let from = drowned[0] + share * drowned[2] + 0.3 * (drowned[1] - 200.0);
        let scene = with_glare(on_skin(&discs, 160.0, 55.0), 420.0, [from, from + 80.0], 3.0);
        let markers = detect(&picture(scene, 0.9, 1.5, seed as u64)).markers;
        let (m, error) = nearest(&markers, drowned).expect("the disc is found");
        println!("glare from {share}: {error:.2?}, variances {:.3?}", m.covariance_px2.diagonal());
        assert!(error.norm() < 2.0, "glare from {share}: off by {error}");
        square += normalised_square(m, error) / 3.0;
        assert!(nearest(&markers, discs[3]).is_some_and(|(_, error)| error.norm() < 0.3), "its neighbour");
    }
    assert!(square.sqrt() < 2.0, "{} standard deviations", square.sqrt());
    // Of what is drowned as a whole, nothing is said.
    let from = drowned[0] - 0.7 * drowned[2] + 0.3 * (drowned[1] - 200.0);
    let scene = with_glare(on_skin(&discs, 160.0, 55.0), 420.0, [from, from + 90.0], 3.0);
    let markers = detect(&picture(scene, 0.9, 1.5, 9)).markers;
    let near = |m: &&Detection| (m.centre_px - Vector2::new(drowned[0], drowned[1])).norm() < drowned[2];
    assert_eq!(markers.iter().find(near), None);
}

#[test]
fn a_disc_that_shows_through_glare_is_measured_through_it() {
    let discs = discs();
    let mut squares = Vec::new();
    for (seed, share) in [-0.45, -0.3, 0.0, 0.2, 0.4].into_iter().enumerate() {
        // The middle one of the first row to that of the third.
        let veiled = discs[1 + 3 * (seed % 3)];
        let middle = veiled[0] + share * veiled[2] + 0.3 * (veiled[1] - 200.0);
        let scene = with_glare(on_skin(&discs, 140.0, 60.0), 300.0, [middle - 12.0, middle + 12.0], 4.0);
        let markers = detect(&picture(scene, 0.9, 1.5, seed as u64)).markers;
        let (m, error) = nearest(&markers, veiled).expect("the disc is found");
        println!("glare at {share}: {error:.3?}, variances {:.4?}", m.covariance_px2.diagonal());
        assert!(error.norm() < 0.3, "glare at {share}: off by {error}");
        squares.push(normalised_square(m, error));
    }
    let square = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!(square.sqrt() < 1.6, "{} standard deviations", square.sqrt());
}

/// Light that is so many times stronger in a band of 120 px from some column on, with a slope of so many px.
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
        assert!((m.semi_major_px - cut[2]).abs() < 1.5, "{share}: {:.1} px long", m.semi_major_px);
    }
}

#[test]
fn dirt_beside_a_disc_does_not_shift_it() {
    let discs = discs();
    let stained = |x: f64, y: f64| {
        // A soft spot above the middle of each.
        let spot = |d: &Ellipse| {
            let (s, t) = local([d[0], d[1], 16.0, 4.0, d[4]], x, y);
            (-(s - 0.3).powi(2) - (t + 1.9).powi(2)).exp()
        };
        let skin = 165.0 - 16.0 * discs.iter().map(spot).sum::<f64>();
        if discs.iter().any(|&d| within(d, x, y)) { 60.0 } else { skin }
    };
    let (mut sum, mut square, mut count) = (Vector2::zeros(), 0.0, 0.0);
    for seed in 0..4 {
        let markers = detect(&picture(stained, 1.0, 2.0, seed)).markers;
        for &disc in &discs {
            let (m, error) = nearest(&markers, disc).expect("the disc is found");
            sum += error;
            square += normalised_square(m, error);
            count += 1.0;
        }
    }
    let (mean, normalised) = (sum / count, f64::sqrt(square / count));
    println!("mean shift {:.3} {:.3} px, normalised {normalised:.2}", mean.x, mean.y);
    assert!(mean.y.abs() < 0.02, "shifted by {} px across", mean.y);
    assert!(normalised < 1.6, "{normalised} standard deviations");
}

/// Grey values: skin, black, white.
type Greys = [f64; 3];

/// Quadrants on skin: black where both coordinates of the sheet, turned by an angle, have one sign.
fn quadrants(target: Ellipse, turn: f64, [skin, black, white]: Greys) -> impl Fn(f64, f64) -> f64 {
    let (sin, cos) = turn.sin_cos();
    move |x, y| {
        let (s, t) = local(target, x, y);
        let turned = (s * cos + t * sin, t * cos - s * sin);
        match (s.hypot(t) < 1.0, turned.0 * turned.1 > 0.0) {
            (false, _) => skin,
            (true, true) => black,
            (true, false) => white,
        }
    }
}

#[test]
fn the_white_tells_the_length_of_flat_quadrants() {
    // Two thin crescents along the outline are black.
    let target: Ellipse = [450.2, 200.7, 70.0, 8.5, -0.1];
    let scene = quadrants(target, 0.877, [160.0, 45.0, 225.0]);
    for seed in 0..3 {
        let m = measured(&picture(&scene, 1.7, 2.0, seed), target, 9.0);
        assert!((m.semi_major_px / 70.0 - 1.0).abs() < 0.1, "{} px long", m.semi_major_px);
    }
}

/// Part of a rendered frame (see the README beside it) on even skin, its corner at (1000, 800).
fn on_even_skin(name: &str, skin: u8) -> Raster {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/pictures").join(name);
    let part = image::open(path).expect("a picture of the tests").to_luma8();
    framed(part.width() as usize, part.as_raw(), skin)
}

/// A part of a frame on even skin, its corner at (1000, 800).
fn framed(columns: usize, part: &[u8], skin: u8) -> Raster {
    let (width, height) = (2400, 1600);
    let mut luma = vec![skin; width * height];
    for (y, row) in part.chunks(columns).enumerate() {
        luma[(y + 800) * width + 1000..][..columns].copy_from_slice(row);
    }
    Raster::new(width, height, luma).expect("a picture")
}

#[test]
fn quadrants_thicker_than_the_near_background_reaches_are_found() {
    let target: Ellipse = [450.2, 210.7, 229.0, 71.0, -0.09];
    let scene = quadrants(target, 0.8, [165.0, 60.0, 230.0]);
    for seed in 0..2 {
        let part = picture(&scene, 1.1, 1.5, seed);
        let pixels: Vec<u8> = (0..HEIGHT).flat_map(|y| part.row(y).to_vec()).collect();
        let [x, y, a, b, angle] = target;
        let m = measured(&framed(WIDTH, &pixels, 165), [x + 1000.0, y + 800.0, a, b, angle], 9.0);
        assert!((m.semi_major_px / a - 1.0).abs() < 0.05, "{} px long", m.semi_major_px);
    }
}

#[test]
fn quadrants_seen_against_two_thresholds_are_found() {
    // The right black part is a blob of 450 px, the left one of 600.
    measured(&on_even_skin("quadrants.png", 195), [1119.774, 880.201, 83.5, 12.2, -0.1], 12.0);
}

#[test]
fn a_disc_whose_tip_a_line_touches_is_found_in_back_light() {
    // The line lowers the background there, and the threshold with it: the blob looks cut.
    measured(&on_even_skin("disc.png", 116), [1175.604, 918.340, 68.2, 6.9, -0.1], 12.0);
}

#[test]
fn two_discs_in_a_row_are_not_taken_for_narrow_quadrants() {
    let image = on_even_skin("row.png", 205);
    for [x, y] in [[1138.604, 860.410], [1220.763, 853.861]] {
        let m = measured(&image, [x, y, 34.4, 3.9, -0.07], 9.0);
        assert!((m.semi_major_px - 34.4).abs() < 0.5 && m.shape == Shape::Circle);
    }
}

#[test]
fn a_disc_between_the_sky_and_white_is_found_in_haze() {
    // From pixel to pixel its background is the sky, or the skin, or the white.
    let m = measured(&on_even_skin("sky.png", 177), [1130.454, 939.438, 74.6, 5.7, -0.13], 9.0);
    assert_eq!(m.shape, Shape::Circle);
}

#[test]
fn quadrants_as_flat_as_one_to_seventeen_are_found() {
    let target: Ellipse = [450.2, 200.7, 60.0, 3.6, 0.12];
    let scene = quadrants(target, 0.785, [170.0, 100.0, 225.0]);
    for seed in 0..3 {
        let m = measured(&picture(&scene, 0.9, 1.5, seed), target, 9.0);
        assert_eq!(m.shape, Shape::Quadrant);
    }
}

#[test]
fn quadrants_of_whose_black_blur_leaves_the_middle_are_found() {
    let target: Ellipse = [450.2, 200.7, 60.0, 5.6, 0.12];
    let mut squares = Vec::new();
    for (turn, noise) in [(0.785, 2.0), (0.785, 5.0), (0.85, 3.0), (0.72, 3.0)] {
        let scene = quadrants(target, turn, [165.0, 60.0, 215.0]);
        squares.extend(found_of(&[target], scene, 1.9, noise));
    }
    hold(&squares, 22);
}

#[test]
fn narrow_quadrants_that_a_seam_crosses_are_found() {
    // One edge is as long as the target, the other a few pixels: its bend must be known beforehand.
    let m = measured(&on_even_skin("seam.png", 171), [1122.526, 865.279, 49.2, 3.1, -0.095], 9.0);
    assert_eq!(m.shape, Shape::Quadrant);
}

#[test]
fn quadrants_whose_white_begins_far_from_what_is_left_of_their_black_are_found() {
    // Blur has left 20 px of black in the middle of 117.
    let m = measured(&on_even_skin("middle.png", 167), [1123.979, 866.028, 58.0, 4.0, -0.09], 9.0);
    assert_eq!(m.shape, Shape::Quadrant);
}

#[test]
fn quadrants_that_blur_makes_narrow_are_found() {
    // Plain to the eye, but black is two slivers, two lobes that white joins, or the middle only.
    let sizes = [[73.0, 10.0], [58.0, 6.5], [40.0, 10.0], [40.0, 7.0]];
    // Too few to tell one another's blur.
    let mut squares = Vec::new();
    for first in [0.25, 0.6, 0.95, 1.3] {
        let targets: [(Ellipse, f64); 4] = std::array::from_fn(|k| {
            let (x, y) = (225.3 + 446.1 * (k % 2) as f64, 110.4 + 200.2 * (k / 2) as f64);
            let [a, b] = sizes[k];
            ([x, y, a, b, 0.17 - 0.08 * k as f64], first + 0.1 * k as f64)
        });
        let scene = |x: f64, y: f64| {
            let target = targets.iter().find(|(target, _)| within(*target, x, y));
            target.map_or(165.0, |&(target, turn)| quadrants(target, turn, [165.0, 60.0, 215.0])(x, y))
        };
        squares.extend(found_of(&targets.map(|t| t.0), scene, 2.0, 2.0));
    }
    hold(&squares, 93);
}

#[test]
fn pale_quadrants_before_skin_that_is_darker_than_their_white_are_found() {
    let target: Ellipse = [450.2, 200.7, 186.0, 55.0, -0.1];
    let scene = quadrants(target, 0.6, [125.0, 105.0, 149.0]);
    for seed in 0..3 {
        measured(&picture(&scene, 2.0, 2.0, seed), target, 9.0);
    }
}

/// Not one of them tells its place to a third of a pixel.
#[test]
fn discs_thinner_than_their_blur_are_found_in_strong_noise() {
    let thin = discs().map(|[x, y, a, _, angle]| [x, y, a, 0.05 * a, angle]);
    let squares = found_of(&thin, on_skin(&thin, 165.0, 60.0), 2.0, 7.0);
    hold(&squares, 53);
}

#[test]
fn discs_thinner_than_their_blur_are_found() {
    let thin = discs().map(|[x, y, a, _, angle]| [x, y, a, 0.05 * a, angle]);
    hold(&found_of(&thin, on_skin(&thin, 165.0, 60.0), 2.0, 4.0), 53);
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
            let (x, y) = (x + along * cos - across * sin, y + along * sin + across * cos);
            ([x, y, between(0.4, 1.0) * a, 3.0, angle], between(0.03, 0.15))
        });
        let stained = |x: f64, y: f64| {
            let dark = |(spot, depth): &(Ellipse, f64)| {
                let (s, t) = local(*spot, x, y);
                1.0 - depth * (-s * s - t * t).exp()
            };
            let skin = 165.0 * spots.iter().map(dark).product::<f64>();
            if thin.iter().any(|&d| within(d, x, y)) { 60.0 } else { skin }
        };
        squares.extend(found_of(&thin, stained, 1.5, 2.0));
    }
    // The spots' edges still reach the skin that is used.
    let normalised = normalised(&squares, 214);
    assert!(normalised < 1.6, "{normalised} standard deviations");
}

#[test]
fn a_thin_disc_that_a_smear_lengthens_says_so() {
    let thin = discs().map(|[x, y, a, _, angle]| [x, y, a, 0.06 * a, angle]);
    let [x, y, a, b, angle] = thin[4];
    // As dark as the disc, of which it looks like an end.
    let smear = [x + 5.0, y + 5.0 * angle, a, b, angle];
    let both: Vec<Ellipse> = thin.into_iter().chain([smear]).collect();
    for seed in 0..4 {
        let m = measured(&picture(on_skin(&both, 165.0, 60.0), 2.0, 2.0, seed), thin[4], 4.0);
        assert!(m.semi_major_px > a + 1.5, "the smear shows");
    }
}
