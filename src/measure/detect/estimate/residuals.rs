//! What a fit's residuals show: how far they hang together, and which pixels are foreign.

use nalgebra::Matrix2;

use super::gauss_newton::MarkerFit;
use super::normal_equations::biweight_roots;
use super::sandwich::{ResidualBlocks, SECTORS, pixel_sectors};
use crate::detect::appearance::parameters::{N, X, Y};
use crate::detect::sample::pixels::Pixels;
use crate::detect::simd::dispatch::wide;
use crate::detect::simd::lanes::{Lanes, each};

/// What a fit's residuals show.
pub struct ResidualAnalysis {
    /// The centre's covariance, at least that which they show, px^2.
    pub covariance: Matrix2<f64>,
    /// The greatest ratio of the two.
    pub ratio: f64,
    /// Their mean ratio in squares.
    pub mean: f64,
    /// Mean square of residuals by sectors, over that of white ones.
    pub uneven: f64,
    /// Residuals of each batch, grey levels.
    pub residuals: Vec<Lanes>,
    /// Roots of their robust weights.
    pub biweights: Vec<Lanes>,
}

wide! {
    /// What a fit's residuals show, from where it was linearised.
    pub fn analyse_residuals(pixels: &Pixels, fit: &MarkerFit, scale: f64) -> Option<ResidualAnalysis> = analyse_residuals_generic
}

#[inline(always)]
fn analyse_residuals_generic(pixels: &Pixels, fit: &MarkerFit, scale: f64) -> Option<ResidualAnalysis> {
    let m = &fit.parameters;
    let [by_x, by_y] = [X, Y].map(|k| fit.covariance.column(k).map(|v| (v / fit.variance) as f32));
    let mut list = [(0, [0.0f32; 3]); N];
    let mut count = 0;
    for k in (0..N).filter(|&k| fit.covariance[(k, k)] > 0.0 || m[k] != fit.start[k]) {
        list[count] = (k, [(m[k] - fit.start[k]) as f32, by_x[k], by_y[k]]);
        count += 1;
    }
    let mut blocks = ResidualBlocks::new(pixels, m);
    // Of each sector the sum of its weighted residuals, and of the weights' squares.
    let mut common = [[0.0f64; 2]; SECTORS];
    let mut residuals = Vec::with_capacity(pixels.batches.len());
    let mut roots = Vec::with_capacity(pixels.batches.len());
    for (batch, image) in pixels.batches.iter().zip(&fit.images) {
        let mut sums = [Lanes::of(0.0); 3];
        for (k, by) in &list[..count] {
            let gradient = image.by(*k);
            for (sum, by) in sums.iter_mut().zip(by) {
                *sum = each(|i| sum[i] + by * gradient[i]);
            }
        }
        let r = each(|i| batch.value[i] - image.value[i] - sums[0][i]);
        let tukey = biweight_roots(&r, &image.gradient[X], &image.gradient[Y], scale);
        let pull = each(|i| (batch.root[i] * tukey[i]) * (batch.root[i] * tukey[i]) * r[i]);
        blocks.add(batch, [each(|i| sums[1][i] * pull[i]), each(|i| sums[2][i] * pull[i])]);
        let sector = pixel_sectors(batch);
        for i in 0..batch.len {
            if let Some(sum) = common.get_mut(sector[i] as usize) {
                let weight = f64::from((batch.root[i] * tukey[i]).powi(4));
                *sum = [sum[0] + f64::from(pull[i]), sum[1] + weight];
            }
        }
        residuals.push(r);
        roots.push(tukey);
    }
    let free = (0..N).filter(|&k| fit.covariance[(k, k)] > 0.0).count();
    let (covariance, ratio, mean) = blocks.raise_covariance(&fit.white, free)?;
    let seen = common.iter().filter(|sum| sum[1] > 2.0);
    let (sum, count) = seen.fold((0.0, 0.0), |(s, n), [r, w]| (s + r * r / w, n + 1.0));
    let uneven = sum / (fit.variance * f64::max(count, 1.0));
    Some(ResidualAnalysis { covariance, ratio, mean, uneven, residuals, biweights: roots })
}
