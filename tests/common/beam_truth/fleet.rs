//! Randomly sampled wings and mountings.

use nalgebra::Vector3;
use rand::Rng;
use rand::rngs::StdRng;
use wingd::measure::setup::Setup;

use super::Wing;
use crate::common::random::normal3;

/// A mounting rotated within the configured repeatability.
pub fn remounted(rng: &mut StdRng, setup: &Setup) -> Vector3<f64> {
    normal3(rng) * (setup.mount_repeatability_px / setup.lens.focal_px())
}

/// Samples wings, loads and sides of a beam fleet.
pub fn random_wing(rng: &mut StdRng) -> Wing {
    Wing {
        taper: rng.random_range(0.22..0.4),
        power: rng.random_range(2.8..4.0),
        fuel: rng.random_range(0.0..0.35),
        fuel_reach: rng.random_range(0.55..0.8),
        skew: rng.random_range(-0.1..0.3),
        dihedral_rad: rng.random_range(0.03..0.1),
        twist_tip_rad: rng.random_range(-0.05..0.05),
        twist_power: rng.random_range(1.0..2.0),
        length_m: rng.random_range(28.0..34.0),
        side: if rng.random::<bool>() { 1.0 } else { -1.0 },
        ..Wing::default()
    }
}
