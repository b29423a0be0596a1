//! Seeded random numbers, identical on every machine and for every number of threads.

/// Random number generator SplitMix64 (Steele, Lea, Flood 2014).
#[derive(Clone, Debug)]
pub struct SeededRandom(u64);

impl SeededRandom {
    /// Creates a separate stream for every pair of seed and purpose.
    pub fn new(seed: u64, purpose: u64) -> Self {
        let mut start = Self(seed ^ purpose.wrapping_mul(0xD1B5_4A32_D192_ED03));
        let state = start.bits();
        Self(state)
    }

    /// Returns 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        mix_bits(self.0)
    }

    /// Returns a uniform number in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns a uniform number between two bounds.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Returns a uniform integer, both bounds included.
    pub fn integer(&mut self, low: usize, high: usize) -> usize {
        low + (self.bits() % (high.saturating_sub(low) as u64 + 1)) as usize
    }

    /// Returns a standard normal number (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }

    /// Returns a nearly normal number of unit variance from 64 bits, the sum of four 16-bit uniforms: for noise.
    pub fn quick_normal(&mut self) -> f32 {
        let bits = self.bits();
        let sum = (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
        // Variance of the sum: 4 (2^32 - 1) / 12; mean 2 (2^16 - 1).
        (sum as f32 - 131_070.0) * (1.0 / 37_837.23)
    }
}

fn mix_bits(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

/// Returns smooth value noise in -1..1 with a lattice of one unit.
pub fn value_noise(x: f64, y: f64, seed: u64) -> f64 {
    let (i, j) = (x.floor(), y.floor());
    let ease = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
    let (a, b) = (ease(x - i), ease(y - j));
    let at = |di: i64, dj: i64| {
        let key =
            (i as i64 + di).wrapping_mul(0x8DA6_B343) ^ (j as i64 + dj).wrapping_mul(0xD816_3841);
        (mix_bits(seed ^ key as u64) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    let top = at(0, 0) + a * (at(1, 0) - at(0, 0));
    let bottom = at(0, 1) + a * (at(1, 1) - at(0, 1));
    top + b * (bottom - top)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_distribution() {
        let mut random = SeededRandom::new(7, 1);
        let n = 200_000;
        let (mut sum, mut square, mut quick) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let x = random.normal();
            sum += x;
            square += x * x;
            quick += f64::from(random.quick_normal()).powi(2);
        }
        let n = f64::from(n);
        assert!((sum / n).abs() < 0.01);
        assert!((square / n - 1.0).abs() < 0.02);
        assert!((quick / n - 1.0).abs() < 0.02);
    }

    #[test]
    fn streams_repeat_and_differ_by_purpose() {
        assert_eq!(
            SeededRandom::new(3, 4).bits(),
            SeededRandom::new(3, 4).bits()
        );
        assert_ne!(
            SeededRandom::new(3, 4).bits(),
            SeededRandom::new(3, 5).bits()
        );
    }
}
