//! Analysis of the residuals of a fit: their correlation, and foreign pixels.

use nalgebra::Matrix2;

use super::gauss_newton::MarkerFit;
use super::normal_equations::biweight_roots;
use super::sandwich::{ResidualBlocks, SECTORS, pixel_sectors};
use crate::detect::appearance::parameters::{N, X, Y};
use crate::detect::sample::pixels::Pixels;
use crate::detect::simd::lanes::{Lanes, each};
use crate::dispatch::wide;

/// Correlation and weights of the residuals of a fit.
pub struct ResidualAnalysis {
    /// Covariance of the centre, raised to the one estimated from blocks of residuals, px^2.
    pub covariance: Matrix2<f64>,
    /// Largest ratio of the block covariance to that of the fit.
    pub ratio: f64,
    /// Mean ratio of the two, from square blocks.
    pub mean: f64,
    /// Mean square of the residuals by sectors, relative to uncorrelated ones.
    pub uneven: f64,
    /// Residuals of each batch, grey levels.
    pub residuals: Vec<Lanes>,
    /// Square roots of the robust weights.
    pub biweights: Vec<Lanes>,
}

wide! {
    /// Analyses the residuals of a fit, from its last linearisation. Returns `None` if the covariance is singular.
    pub fn analyse_residuals(pixels: &Pixels, fit: &MarkerFit, scale: f64) -> Option<ResidualAnalysis> = analyse_residuals_generic
}

#[inline(always)]
fn analyse_residuals_generic(
    pixels: &Pixels,
    fit: &MarkerFit,
    scale: f64,
) -> Option<ResidualAnalysis> {
    let m = &fit.parameters;
    let [by_x, by_y] = [X, Y].map(|k| fit.covariance.column(k).map(|v| (v / fit.variance) as f32));
    let mut list = [(0, [0.0f32; 3]); N];
    let mut count = 0;
    for k in (0..N).filter(|&k| fit.covariance[(k, k)] > 0.0 || m[k] != fit.start[k]) {
        list[count] = (k, [(m[k] - fit.start[k]) as f32, by_x[k], by_y[k]]);
        count += 1;
    }
    let mut blocks = ResidualBlocks::new(pixels, m);
    // For each sector: sum of weighted residuals, sum of squared weights.
    let mut common = [[0.0f64; 2]; SECTORS];
    let mut residuals = Vec::with_capacity(pixels.batches.len());
    let mut roots = Vec::with_capacity(pixels.batches.len());
    for (batch, image) in pixels.batches.iter().zip(&fit.images) {
        let mut sums = [Lanes::splat(0.0); 3];
        for (k, by) in &list[..count] {
            let gradient = image.derivative(*k);
            for (sum, by) in sums.iter_mut().zip(by) {
                *sum = each(|i| sum[i] + by * gradient[i]);
            }
        }
        let r = each(|i| batch.value[i] - image.value[i] - sums[0][i]);
        let tukey = biweight_roots(&r, &image.gradient[X], &image.gradient[Y], scale);
        let pull = each(|i| (batch.root[i] * tukey[i]) * (batch.root[i] * tukey[i]) * r[i]);
        blocks.add(
            batch,
            [
                each(|i| sums[1][i] * pull[i]),
                each(|i| sums[2][i] * pull[i]),
            ],
        );
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
    Some(ResidualAnalysis {
        covariance,
        ratio,
        mean,
        uneven,
        residuals,
        biweights: roots,
    })
}
