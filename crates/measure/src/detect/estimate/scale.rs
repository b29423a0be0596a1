//! Scale of the residuals: their robust standard deviation.

use crate::detect::estimate::options::WEIGHT;
use crate::detect::simd::lanes::{Lanes, each, sum_lanes};
use crate::estimation::robust::SIGMA_OVER_MEDIAN;

/// Absolute residuals of a fit, of which the scale is estimated.
pub struct ResidualSizes {
    sizes: Vec<Lanes>,
    count: Lanes,
}

impl ResidualSizes {
    /// Creates an empty set with room for a number of batches.
    pub fn new(batches: usize) -> Self {
        Self {
            sizes: Vec::with_capacity(batches),
            count: Lanes::splat(0.0),
        }
    }

    /// Adds the residuals of a batch, of pixels that have at least half their weight.
    #[inline(always)]
    pub fn add(&mut self, r: &Lanes, root: &Lanes) {
        self.sizes.push(each(|i| {
            if root[i] > WEIGHT.scale_root {
                r[i].abs()
            } else {
                f32::MAX
            }
        }));
        self.count = each(|i| {
            self.count[i]
                + if root[i] > WEIGHT.scale_root {
                    1.0
                } else {
                    0.0
                }
        });
    }

    /// Returns the robust standard deviation from the median of the sizes, grey levels, to 0.001 of `scale`.
    #[inline(always)]
    pub fn sigma(&self, scale: f64) -> f64 {
        /// Upper bound of the bisection, in previous scales.
        const SCALES: f32 = 8.0;
        /// Bisections: to 1/8192 of the interval, which is 0.001 of one scale.
        const STEPS: usize = 13;
        let half = 0.5 * sum_lanes(&self.count);
        let (mut low, mut high) = (0.0, SCALES * scale as f32);
        for _ in 0..STEPS {
            let middle = 0.5 * (low + high);
            // Four parallel counts: none waits for the previous one.
            let mut below = [Lanes::splat(0.0); 4];
            let (fours, rest) = self.sizes.as_chunks::<4>();
            for four in fours {
                for k in 0..4 {
                    below[k] = each(|i| below[k][i] + if four[k][i] < middle { 1.0 } else { 0.0 });
                }
            }
            for size in rest {
                below[0] = each(|i| below[0][i] + if size[i] < middle { 1.0 } else { 0.0 });
            }
            let under = below.iter().map(sum_lanes).sum::<f64>() < half;
            (low, high) = if under { (middle, high) } else { (low, middle) };
        }
        SIGMA_OVER_MEDIAN * f64::from(0.5 * (low + high))
    }
}

/// Returns the robust standard deviation from absolute residuals.
pub fn robust_sigma(residuals: &mut [f32]) -> f64 {
    if residuals.is_empty() {
        return 0.0;
    }
    let middle = residuals.len() / 2;
    let (_, median, _) = residuals.select_nth_unstable_by(middle, f32::total_cmp);
    SIGMA_OVER_MEDIAN * f64::from(*median)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::simd::lanes::LANES;

    #[test]
    fn halving_gives_the_median() {
        let sizes: Vec<f32> = (0..4 * LANES)
            .map(|i| (i * 37 % 64) as f32 * 0.11)
            .collect();
        for scale in [2.0, 5.0, 9.0] {
            let mut halved = ResidualSizes::new(8);
            for some in sizes.chunks(LANES) {
                halved.add(
                    &each(|i| if i % 2 == 0 { some[i] } else { -some[i] }),
                    &Lanes::splat(1.0),
                );
                halved.add(&Lanes::splat(1e6), &Lanes::splat(0.5));
            }
            // Between two sizes, which are 0.11 apart, or at one of them.
            let exact = robust_sigma(&mut sizes.clone()) - SIGMA_OVER_MEDIAN * 0.055;
            let got = halved.sigma(scale);
            assert!(
                (got - exact).abs() < SIGMA_OVER_MEDIAN * 0.055 + 0.002 * scale,
                "{got} against {exact}"
            );
        }
    }
}
