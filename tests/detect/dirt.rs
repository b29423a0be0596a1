//! Promise: dirt dragged along a disc's edge by the air is covered by its standard deviation, and clean discs keep theirs.

use crate::common::drawn::{Ellipse, discs, local, nearest, on_skin, picture};
use nalgebra::Vector2;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use wingd::measure::detect::{CovarianceSource, Detection, detect};

/// A streak along a disc: distance from its edge, width (px, one standard deviation) and darkness.
#[derive(Clone, Copy)]
struct Streak {
    disc: Ellipse,
    distance: f64,
    width: f64,
    depth: f64,
}

impl Streak {
    fn random_on(disc: Ellipse, random: &mut StdRng) -> Self {
        let [distance, width] = [random.random_range(0.0..5.0), random.random_range(1.0..4.0)];
        let side = if random.random_bool(0.5) { 1.0 } else { -1.0 };
        Self {
            disc,
            distance: side * (disc[3] + distance),
            width,
            depth: random.random_range(0.05..0.25),
        }
    }

    /// Transmitted fraction of the light at a position.
    fn transmittance(&self, x: f64, y: f64) -> f64 {
        if (x - self.disc[0]).abs() > 400.0 || (y - self.disc[1]).abs() > 60.0 {
            return 1.0;
        }
        let (s, t) = local(self.disc, x, y);
        let (s, t) = (s / 2.0, (t * self.disc[3] - self.distance) / self.width);
        1.0 - self.depth * (-0.5 * (s * s + t * t)).exp()
    }
}

/// Squared error of a disc across its axis, px^2, and its variance.
fn squared_error_across(marker: &Detection, error: Vector2<f64>) -> [f64; 2] {
    let axis = Vector2::new(-marker.angle_rad.sin(), marker.angle_rad.cos());
    [
        error.dot(&axis).powi(2),
        axis.dot(&(*marker.covariance_px2 * axis)),
    ]
}

/// Sums over discs: normalised squares across of dirty discs, of those without the added variance, of clean discs; number of clean
/// discs with added variance; number of discs.
fn sum_errors(seed: u64) -> [f64; 5] {
    let (blur, noise) = (
        [0.8, 1.3][seed as usize % 2],
        [1.5, 2.5][seed as usize / 2 % 2],
    );
    let mut random = StdRng::seed_from_u64(seed);
    let discs = discs();
    let streaks: Vec<Streak> = discs
        .iter()
        .map(|&disc| Streak::random_on(disc, &mut random))
        .collect();
    let skin = on_skin(&discs, 170.0, 50.0);
    let dirty = |x, y| {
        skin(x, y)
            * streaks
                .iter()
                .map(|s| s.transmittance(x, y))
                .product::<f64>()
    };
    let dirty = detect(&picture(dirty, blur, noise, seed)).markers;
    let clean = detect(&picture(&skin, blur, noise, seed)).markers;
    let mut out = [0.0; 5];
    for disc in discs {
        let (marker, error) = nearest(&dirty, disc).expect("found");
        let [square, variance] = squared_error_across(marker, error);
        out[0] += square / variance;
        out[1] += square
            / (variance
                - marker
                    .covariance_px2
                    .contribution(CovarianceSource::Contamination)
                    .trace());
        let (marker, error) = nearest(&clean, disc).expect("found");
        let [square, variance] = squared_error_across(marker, error);
        out[2] += square / variance;
        out[3] += if marker
            .covariance_px2
            .contribution(CovarianceSource::Contamination)
            .trace()
            > 0.1 * variance
        {
            1.0
        } else {
            0.0
        };
        out[4] += 1.0;
    }
    out
}

#[test]
fn dirt_along_a_disc_is_in_its_standard_deviation() {
    let all: Vec<[f64; 5]> = (0..8u64).into_par_iter().map(sum_errors).collect();
    let [with, without, clean, with_dirt_variance, count] =
        std::array::from_fn(|k| all.iter().map(|sums| sums[k]).sum::<f64>());
    let [with, without, clean] = [with, without, clean].map(|sum| (sum / count).sqrt());
    println!(
        "{with:.2} standard deviations, {without:.2} without the doubt; clean {clean:.2}, {with_dirt_variance} doubted"
    );
    assert!((0.7..1.4).contains(&with), "{with} standard deviations");
    assert!(without > 2.0, "{without}: too little dirt for the test");
    assert!(
        (0.7..1.4).contains(&clean) && with_dirt_variance <= 2.0,
        "{clean} standard deviations, {with_dirt_variance} doubted"
    );
}
