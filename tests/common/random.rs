//! Normal deviates for the synthetic worlds of the tests.

use nalgebra::{Vector2, Vector3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

pub fn rng(seed: u64) -> StdRng {
    StdRng::seed_from_u64(seed)
}

/// Box and Muller.
pub fn normal(rng: &mut StdRng) -> f64 {
    let (a, b): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

pub fn normal2(rng: &mut StdRng) -> Vector2<f64> {
    Vector2::new(normal(rng), normal(rng))
}

pub fn normal3(rng: &mut StdRng) -> Vector3<f64> {
    Vector3::new(normal(rng), normal(rng), normal(rng))
}
