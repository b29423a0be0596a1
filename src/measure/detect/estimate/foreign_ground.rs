//! Edges beside which something foreign lies: dirt, paint, a streak of fluid, a decal's torn corner, another light.
//!
//! Where the ground beside an edge is none of the marker's, the edge is not to be trusted either, though its own pixels may fit:
//! half of them show the foreign thing. What the centre would be without such edges tells by how much it is in doubt. It is one
//! question for discs and quadrants, whatever the thing is; nothing is known of it but that its pixels do not fit.

use nalgebra::{Matrix2, Vector2};

use super::cholesky::CholeskyFactor;
use super::gauss_newton::MarkerFit;
use super::normal_equations::{ParameterVector, NormalMatrix};
use super::prior::FitUnknowns;
use super::residuals::ResidualAnalysis;
use crate::detect::appearance::parameters::{BLUR, N, X, Y};
use crate::detect::detection::covariance::mahalanobis;
use crate::detect::estimate::options::{ITERATION, TERM};
use crate::detect::hypothesis::prior::PriorValue;
use crate::detect::sample::pixels::Pixels;

/// Foreign pixels about a place that tell that the thing reaches it: one or two are noise.
const MIN_FOREIGN_PIXELS: usize = 3;

/// Batch and lane of the pixels that are not within the blur of foreign ones, which the fit gave no weight:
/// a line that touches the marker also darkens the pixels beside it, too little to be seen in each.
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

/// By how much the centre is in doubt for edges beside foreign ground, px^2: the square of the step that it makes without them,
/// where that is more than its standard deviation then. `scale`: of the residuals, grey levels.
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
            let by = weight * f64::from(image.by(k)[lane]);
            right[k] += by * residual;
            list[a..].iter().for_each(|&l| normal[(k, l)] += by * f64::from(image.by(l)[lane]));
        }
    }
    for (a, &k) in list.iter().enumerate() {
        let PriorValue { value, sigma } = unknowns.prior[k];
        let weight = (scale / sigma).powi(2);
        normal[(k, k)] += weight;
        right[k] += weight * (value - m[k]);
        list[a..].iter().for_each(|&l| normal[(l, k)] = normal[(k, l)]);
    }
    let sought = std::array::from_fn(|k| list.contains(&k));
    let Some(factor) = CholeskyFactor::new(&normal, &sought, ITERATION.final_damping) else { return Matrix2::zeros() };
    let change = factor.solve(&right);
    let apart = Vector2::new(change[X], change[Y]);
    let then = factor.inverse().fixed_view::<2, 2>(X, X) * fit.variance;
    let off = mahalanobis(&apart, &then);
    if off > 1.0 && off.is_finite() { apart * apart.transpose() } else { Matrix2::zeros() }
}
