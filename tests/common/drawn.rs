//! Synthetic scenes: ellipses on skin, blurred in light, and detections compared with the true ellipses.

use nalgebra::{Cholesky, Vector2};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use wingd::measure::detect::{Detection, ExpectedMarker, MarkerPrediction, detect};
use wingd::measure::raster::Raster;
use wingd::measure::setup::Shape;

pub const WIDTH: usize = 900;
pub const HEIGHT: usize = 420;
pub const TONE: f64 = 2.2;
/// Samples per pixel: a Fibonacci lattice, with no two samples in one row or column, so edges of flat discs are sampled evenly.
const SAMPLES: usize = 21;
const NEXT_ROW: usize = 13;

/// An ellipse: centre, semi-axes, direction; px, rad.
pub type Ellipse = [f64; 5];

/// Coordinates along and across an ellipse, in semi-axes.
pub fn local([cx, cy, a, b, angle]: Ellipse, x: f64, y: f64) -> (f64, f64) {
    let (sin, cos) = angle.sin_cos();
    let (dx, dy) = (x - cx, y - cy);
    ((dx * cos + dy * sin) / a, (dy * cos - dx * sin) / b)
}

/// Whether a point is farther from the centre than `times` the larger semi-axis; needs no angle.
fn is_beyond([cx, cy, a, b, _]: Ellipse, x: f64, y: f64, times: f64) -> bool {
    (x - cx).powi(2) + (y - cy).powi(2) > (times * a.max(b)).powi(2)
}

pub fn is_within(ellipse: Ellipse, x: f64, y: f64) -> bool {
    let inside = |(s, t): (f64, f64)| s.hypot(t) < 1.0;
    !is_beyond(ellipse, x, y, 1.0) && inside(local(ellipse, x, y))
}

/// A soft spot: 1 in its middle, invisible beyond five of its axes.
pub fn soft(spot: Ellipse, x: f64, y: f64) -> f64 {
    if is_beyond(spot, x, y, 5.0) {
        return 0.0;
    }
    let (s, t) = local(spot, x, y);
    (-s * s - t * t).exp()
}

/// Renders a sharp scene of grey values, blurred in light (px), with normal noise (grey levels).
pub fn picture(scene: impl Fn(f64, f64) -> f64, blur: f64, noise: f64, seed: u64) -> Raster {
    with_noise(&blurred(scene, blur), noise, seed)
}

/// The light of a scene of grey values, blurred (px).
pub fn blurred(scene: impl Fn(f64, f64) -> f64, blur: f64) -> Vec<f64> {
    let mut light = vec![0.0; WIDTH * HEIGHT];
    for (i, light) in light.iter_mut().enumerate() {
        for k in 0..SAMPLES {
            let part = |k: usize| ((k % SAMPLES) as f64 + 0.5) / SAMPLES as f64 - 0.5;
            let (x, y) = (
                (i % WIDTH) as f64 + part(k),
                (i / WIDTH) as f64 + part(NEXT_ROW * k),
            );
            *light += scene(x, y).powf(TONE) / SAMPLES as f64;
        }
    }
    let weights: Vec<(isize, f64)> = (-8..=8)
        .map(|k: isize| (k, (-0.5 * (k as f64 / blur).powi(2)).exp()))
        .collect();
    let total: f64 = weights.iter().map(|w| w.1).sum();
    let passed = |from: &[f64], along_x: bool| -> Vec<f64> {
        let at = |x: isize, y: isize| {
            from[y.clamp(0, HEIGHT as isize - 1) as usize * WIDTH
                + x.clamp(0, WIDTH as isize - 1) as usize]
        };
        (0..WIDTH * HEIGHT)
            .map(|i| {
                let (x, y) = ((i % WIDTH) as isize, (i / WIDTH) as isize);
                let one =
                    |&(k, w): &(isize, f64)| w * if along_x { at(x + k, y) } else { at(x, y + k) };
                weights.iter().map(one).sum::<f64>() / total
            })
            .collect()
    };
    passed(&passed(&light, true), false)
}

/// Grey values of light, with normal noise (grey levels).
pub fn with_noise(light: &[f64], noise: f64, seed: u64) -> Raster {
    let mut random = StdRng::seed_from_u64(seed);
    let luma = light.iter().map(|v| {
        let normal: f64 = (0..12).map(|_| random.random_range(-0.5..0.5)).sum();
        (v.powf(1.0 / TONE) + noise * normal)
            .round()
            .clamp(0.0, 255.0) as u8
    });
    Raster::new(WIDTH, HEIGHT, luma.collect()).unwrap()
}

pub fn nearest(found: &[Detection], ellipse: Ellipse) -> Option<(&Detection, Vector2<f64>)> {
    let off = |m: &Detection| m.centre_px - Vector2::new(ellipse[0], ellipse[1]);
    let best = found
        .iter()
        .min_by(|a, b| off(a).norm().total_cmp(&off(b).norm()))?;
    (off(best).norm() < 5.0).then(|| (best, off(best)))
}

/// Squared normalised error per coordinate.
pub fn normalised_square(m: &Detection, error: Vector2<f64>) -> f64 {
    0.5 * error.dot(&Cholesky::new(*m.covariance_px2).unwrap().solve(&error))
}

/// Discs that shrink upwards and to the right, as on a wing.
pub fn discs() -> [Ellipse; 9] {
    std::array::from_fn(|k| {
        let (x, y) = (
            130.3 + 300.1 * (k % 3) as f64,
            80.4 + 120.2 * (k / 3) as f64,
        );
        let a = 36.0 + 0.05 * y - 0.006 * x;
        [x, y, a, 0.12 * a, 0.12 - 0.02 * (k % 3) as f64]
    })
}

/// Black on skin, grey levels.
pub fn on_skin(discs: &[Ellipse], skin: f64, black: f64) -> impl Fn(f64, f64) -> f64 {
    move |x, y| {
        if discs.iter().any(|&d| is_within(d, x, y)) {
            black
        } else {
            skin
        }
    }
}

/// Grey values: skin, black, white.
pub type Greys = [f64; 3];

/// Quadrants on skin: black where both coordinates of the sheet, turned by an angle, have the same sign.
pub fn quadrants(
    target: Ellipse,
    turn: f64,
    [skin, black, white]: Greys,
) -> impl Fn(f64, f64) -> f64 {
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

/// Places a part of a frame on even skin, with its corner at (1000, 800).
pub fn place_on_skin(columns: usize, part: &[u8], skin: u8) -> Raster {
    let (width, height) = (2400, 1600);
    let mut luma = vec![skin; width * height];
    for (y, row) in part.chunks(columns).enumerate() {
        luma[(y + 800) * width + 1000..][..columns].copy_from_slice(row);
    }
    Raster::new(width, height, luma).unwrap()
}

/// Reads part of a rendered frame (see the README next to the images) on even skin, with its corner at (1000, 800).
pub fn read_part_on_skin(name: &str, skin: u8) -> Raster {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/pictures")
        .join(name);
    let part = image::open(path).expect("an image of the tests").to_luma8();
    place_on_skin(part.width() as usize, part.as_raw(), skin)
}

/// Squared normalised errors of the detected markers of a scene, rendered with six seeds; nothing else may be
/// detected.
pub fn errors_in_scene(
    markers: &[Ellipse],
    scene: impl Fn(f64, f64) -> f64,
    blur: f64,
    noise: f64,
) -> Vec<f64> {
    let light = blurred(scene, blur);
    errors_in_images(markers, |seed| with_noise(&light, noise, seed))
}

/// Squared normalised errors of the detected markers of images rendered from a seed.
pub fn errors_in_images(markers: &[Ellipse], drawn: impl Fn(u64) -> Raster) -> Vec<f64> {
    let mut squares = Vec::new();
    for seed in 0..6 {
        let found = detect(&drawn(seed)).markers;
        assert!(
            found.len() <= markers.len(),
            "seed {seed}: {} markers",
            found.len()
        );
        let near = markers.iter().filter_map(|&marker| nearest(&found, marker));
        squares.extend(near.map(|(m, error)| normalised_square(m, error)));
    }
    squares
}

/// Rms normalised error of the detected markers, at least `least` of them.
pub fn normalised(squares: &[f64], least: usize) -> f64 {
    let found = squares.len();
    let normalised = (squares.iter().sum::<f64>() / found as f64).sqrt();
    println!("{found} found, normalised error {normalised:.2}");
    assert!(found >= least, "{found} are found");
    normalised
}

/// Asserts that at least `least` markers are found and their standard deviations are consistent with the errors.
pub fn assert_consistent(squares: &[f64], least: usize) {
    let normalised = normalised(squares, least);
    assert!(
        (0.7..1.3).contains(&normalised),
        "{normalised} standard deviations"
    );
}

/// The marker at a position, with a squared normalised error below `most`.
pub fn measured(image: &Raster, marker: Ellipse, most: f64) -> Detection {
    let markers = detect(image).markers;
    let (m, error) = nearest(&markers, marker).expect("it is found");
    println!(
        "{:.1} x {:.1} px, off by {:.3} {:.3} px",
        m.semi_major_px, m.semi_minor_px, error.x, error.y
    );
    assert!(normalised_square(m, error) < most, "off by {error}");
    m.clone()
}

/// Predictions of discs, as from an orientation, to a pixel.
pub fn expected_discs(discs: &[Ellipse], found: &[Detection]) -> Vec<ExpectedMarker> {
    let expected = |&[x, y, a, b, angle]: &Ellipse| {
        let at = Vector2::new(x, y);
        let prediction = MarkerPrediction {
            shape: Shape::Circle,
            centre_px: at + Vector2::new(0.7, -0.4),
            semi_major_px: a,
            semi_minor_px: b,
            angle_rad: angle,
            search_px: Vector2::repeat(4.0),
            seen: false,
        };
        ExpectedMarker {
            prediction,
            marker: 0,
            found: found.iter().position(|m| (m.centre_px - at).norm() < 3.0),
        }
    };
    discs.iter().map(expected).collect()
}
