//! Edges next to foreign background: dirt, paint, a streak of fluid, the torn corner of a decal, a different light.
//!
//! If the background next to an edge does not belong to the marker, the edge is not reliable either, although its own
//! pixels may fit: half of them show the foreign object. The change of the centre without such edges measures the
//! uncertainty. Discs and quadrants are treated equally, for any kind of object; the only evidence used is that its pixels
//! do not fit.

use nalgebra::{Matrix2, Vector2};

use super::cholesky::CholeskyFactor;
use super::gauss_newton::MarkerFit;
use super::normal_equations::{NormalMatrix, ParameterVector};
use super::prior::FitUnknowns;
use super::residuals::ResidualAnalysis;
use crate::detect::appearance::parameters::{BLUR, N, X, Y};
use crate::detect::detection::covariance::squared_mahalanobis;
use crate::detect::estimate::options::{ITERATION, TERM};
use crate::detect::hypothesis::prior::PriorValue;
use crate::detect::sample::pixels::Pixels;

/// Minimum number of foreign pixels around a position for the foreign object to reach it; one or two are noise.
const MIN_FOREIGN_PIXELS: usize = 3;

/// Returns batch and lane of the pixels that are farther than the blur from foreign pixels, to which the fit gave no
/// weight. A line that touches the marker also darkens the pixels next to it, by too little to be noticed in each.
pub fn clean_pixels(pixels: &Pixels, seen: &ResidualAnalysis, blur: f64) -> Vec<[usize; 2]> {
    let mut foreign = Vec::new();
    for (batch, tukey) in pixels.batches.iter().zip(&seen.biweights) {
        foreign.extend((0..batch.len).filter(|&i| tukey[i] <= 0.0).map(|i| [batch.x[i], batch.y[i]]));
    }
    let reach2 = (TERM.foreign.0 * blur + TERM.foreign.1).powi(2) as f32;
    let near = |x: f32, y: f32| {
        let near = foreign.iter().filter(|f| (f[0] - x).powi(2) + (f[1] - y).powi(2) < reach2);
        near.take(MIN_FOREIGN_PIXELS).count() >= MIN_FOREIGN_PIXELS
    };
    let mut out = Vec::with_capacity(pixels.count());
    for (k, batch) in pixels.batches.iter().enumerate() {
        out.extend((0..batch.len).filter(|&i| !near(batch.x[i], batch.y[i])).map(|i| [k, i]));
    }
    out
}

/// Returns the covariance of the centre due to edges next to foreign background, px^2: the square of the change of the
/// centre without these edges, or 0 if that change is within its standard deviation. `scale` is that of the residuals, grey
/// levels.
pub fn foreign_edge_covariance(
    pixels: &Pixels,
    fit: &MarkerFit,
    seen: &ResidualAnalysis,
    unknowns: &FitUnknowns,
    scale: f64,
) -> Matrix2<f64> {
    let m = &fit.parameters;
    let own = clean_pixels(pixels, seen, m[BLUR]);
    let list: Vec<usize> = (0..N).filter(|&k| fit.covariance[(k, k)] > 0.0).collect();
    if own.len() < 3 * N {
        return Matrix2::zeros();
    }
    let (mut normal, mut right) = (NormalMatrix::zeros(), ParameterVector::zeros());
    for [batch, lane] in own {
        let (pixel, image) = (&pixels.batches[batch], &fit.images[batch]);
        let weight = f64::from(pixel.root[lane] * seen.biweights[batch][lane]).powi(2);
        let residual = f64::from(seen.residuals[batch][lane]);
        for (a, &k) in list.iter().enumerate() {
            let by = weight * f64::from(image.derivative(k)[lane]);
            right[k] += by * residual;
            list[a..].iter().for_each(|&l| normal[(k, l)] += by * f64::from(image.derivative(l)[lane]));
        }
    }
    for (a, &k) in list.iter().enumerate() {
        let PriorValue { value, sigma } = unknowns.prior[k];
        let weight = (scale / sigma).powi(2);
        normal[(k, k)] += weight;
        right[k] += weight * (value - m[k]);
        list[a..].iter().for_each(|&l| normal[(l, k)] = normal[(k, l)]);
    }
    let free = std::array::from_fn(|k| list.contains(&k));
    let Some(factor) = CholeskyFactor::new(&normal, &free, ITERATION.final_damping) else {
        return Matrix2::zeros();
    };
    let change = factor.solve(&right);
    let offset = Vector2::new(change[X], change[Y]);
    let then = factor.inverse().fixed_view::<2, 2>(X, X) * fit.variance;
    let off = squared_mahalanobis(&offset, &then);
    if off > 1.0 && off.is_finite() { offset * offset.transpose() } else { Matrix2::zeros() }
}
