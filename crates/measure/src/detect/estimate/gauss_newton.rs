//! Robust fit of the image model to grey values, with covariance.

use nalgebra::Matrix2;

use super::bounds::{is_plausible, limit_step};
use super::cholesky::CholeskyFactor;
use super::normal_equations::{
    BatchImages, Linearisation, NormalMatrix, ParameterVector, linearise_model,
};
use super::prior::FitUnknowns;
use crate::detect::appearance::parameters::{
    LENGTH, MAJOR, MarkerParameters, MarkerPattern, N, X, Y, grey_contrast,
};
use crate::detect::estimate::options::{HopelessFit, ITERATION, WEIGHT};
use crate::detect::sample::pixels::Pixels;

/// A converged fit.
#[derive(Clone, Debug)]
pub struct MarkerFit {
    pub parameters: MarkerParameters,
    /// Covariance of the parameters; zero for fixed ones.
    pub covariance: NormalMatrix,
    /// Weighted variance of the residuals, by which the covariance is scaled, grey levels squared.
    pub variance: f64,
    /// Weighted root mean square of the residuals, grey levels.
    pub rms: f64,
    /// Mean robust weight, 0 to 1.
    pub inliers: f64,
    /// Parameters at which the model was linearised last.
    pub start: MarkerParameters,
    /// Grey values and derivatives of the model at `start`.
    pub images: BatchImages,
    /// Ratio of the variance of the centre from blocks of residuals to that of the fit.
    pub correlation: f64,
    /// Covariance of the centre for uncorrelated residuals, px^2.
    pub white: Matrix2<f64>,
    /// True if residuals are correlated along the outline or many pixels do not fit, so that noise alone does not explain
    /// them.
    pub is_systematic: bool,
}

impl MarkerFit {
    /// Creates a fit from the parameters of a coarse one, with half of its residual scale and a given standard deviation of
    /// the position, px.
    pub fn from_coarse(parameters: MarkerParameters, scale: f64, sigma_px: f64) -> Self {
        let white = Matrix2::identity() * sigma_px * sigma_px;
        let mut covariance = NormalMatrix::zeros();
        covariance.fixed_view_mut::<2, 2>(X, X).copy_from(&white);
        let rms = 0.5 * scale;
        Self {
            parameters,
            covariance,
            variance: rms * rms,
            rms,
            inliers: 1.0,
            start: parameters,
            images: BatchImages::new(),
            correlation: 1.0,
            white,
            is_systematic: false,
        }
    }

    /// Returns the fit under the condition that the parameters `zero` are 0. Exact for a linear model; the parameters
    /// concerned are small.
    pub fn with_zero(self, zero: &[usize]) -> Self {
        let mut out = self;
        for &k in zero {
            let (column, variance) = (
                out.covariance.column(k).into_owned(),
                out.covariance[(k, k)],
            );
            if variance > 0.0 {
                let value = out.parameters[k];
                for i in 0..N {
                    out.parameters[i] -= column[i] * value / variance;
                }
                out.covariance -= column * column.transpose() / variance;
            }
            out.parameters[k] = 0.0;
        }
        out.white = out.covariance.fixed_view::<2, 2>(X, X).into_owned();
        out
    }
}

/// Input of a fit.
struct FitProblem<'a> {
    pixels: &'a Pixels,
    images: Option<BatchImages>,
    unknowns: &'a FitUnknowns,
    floor: f64,
}

/// Result of a converged iteration: the parameters, and the linearisation from which the last step was computed.
struct ConvergedIteration {
    parameters: MarkerParameters,
    start: MarkerParameters,
    scale: f64,
    step: Linearisation,
    factor: CholeskyFactor,
}

/// Convergence criterion of an iteration.
#[derive(Clone, Copy, PartialEq)]
enum Tolerance {
    /// Step of the centre below 0.01 px.
    Coarse,
    /// Step of the centre below a small fraction of its standard deviation.
    Final,
}

/// Fits the free parameters from `start` to 0.01 px. Returns the parameters and the scale of the residuals, grey levels.
pub fn fit_coarse(
    pixels: &Pixels,
    start: &MarkerParameters,
    unknowns: &FitUnknowns,
    floor: f64,
) -> Option<(MarkerParameters, f64)> {
    let mut problem = FitProblem::new(pixels, start, unknowns, floor)?;
    // Most pixels are flat and contain no information on an edge that is still misplaced: reduce the scale slowly.
    let end = problem.solve(
        *start,
        ITERATION.first_scale * grey_contrast(start),
        Tolerance::Coarse,
    )?;
    Some((end.parameters, end.scale))
}

/// Fits the free parameters to full precision, from a first solution with residuals of about this `scale`, grey levels.
pub fn fit_final(
    pixels: &Pixels,
    start: &MarkerParameters,
    scale: f64,
    unknowns: &FitUnknowns,
    floor: f64,
) -> Option<MarkerFit> {
    let mut problem = FitProblem::new(pixels, start, unknowns, floor)?;
    problem.images = Some(BatchImages::new());
    let count = problem.unknowns.free.iter().filter(|&&f| f).count();
    let ConvergedIteration {
        parameters,
        start,
        step,
        factor,
        ..
    } = problem.solve(*start, scale.max(problem.floor), Tolerance::Final)?;
    let variance = step.variance(count);
    let covariance = factor.inverse() * variance;
    let (rms, inliers) = (step.rms(), step.weight / problem.pixels.weight());
    let images = problem.images.unwrap_or_default();
    let white = covariance.fixed_view::<2, 2>(X, X).into_owned();
    Some(MarkerFit {
        parameters,
        covariance,
        variance,
        rms,
        inliers,
        start,
        images,
        correlation: 1.0,
        white,
        is_systematic: false,
    })
}

impl<'a> FitProblem<'a> {
    fn new(
        pixels: &'a Pixels,
        start: &MarkerParameters,
        unknowns: &'a FitUnknowns,
        floor: f64,
    ) -> Option<Self> {
        let count = unknowns.free.iter().filter(|&&f| f).count();
        let enough = pixels.count() >= 2 * count;
        let floor = floor.max(WEIGHT.floor * grey_contrast(start));
        enough.then_some(Self {
            pixels,
            images: None,
            unknowns,
            floor,
        })
    }

    /// Repeats the linear solution until the centre is stationary.
    fn solve(
        &mut self,
        mut m: MarkerParameters,
        mut scale: f64,
        until: Tolerance,
    ) -> Option<ConvergedIteration> {
        let (mut last, near_px) = (scale, ITERATION.coarse_tolerance_px);
        let most = if until == Tolerance::Coarse {
            ITERATION.max_coarse_steps
        } else {
            ITERATION.max_final_steps
        };
        for iteration in 0..most {
            let step = linearise_model(
                self.pixels,
                &m,
                self.unknowns,
                scale,
                self.floor,
                self.images.as_mut(),
            );
            let damped = until == Tolerance::Coarse && iteration < ITERATION.damped_steps;
            let damping = if damped {
                ITERATION.damping
            } else {
                ITERATION.final_damping
            };
            let factor = CholeskyFactor::new(&step.normal, &self.unknowns.free, damping)?;
            let mut change = factor.solve(&step.right);
            let moved = change[X].hypot(change[Y]);
            if moved < ITERATION.gain_px {
                change *= step.step_gain();
            }
            let change = limit_step(change, &m, self.pixels);
            let start = m;
            for i in 0..N {
                m[i] += change[i];
            }
            if !is_plausible(self.pixels, &m) {
                return None;
            }
            let ratio = (step.scale / scale - 1.0).abs();
            // Either the scale was stationary before this step, or the step hardly reduces the residuals.
            let steady = (step.scale / last - 1.0).abs() < ITERATION.coarse_scale_change
                || step.predicted_reduction(&change) < ITERATION.min_reduction;
            last = step.scale;
            scale = step.scale.max(ITERATION.min_scale_ratio * scale);
            let settled = match until {
                Tolerance::Coarse => {
                    moved < near_px && steady && self.is_length_steady(&change, near_px)
                }
                // The tolerance is relative to the standard deviation, which may be as large as a pixel.
                Tolerance::Final => {
                    ratio < ITERATION.final_scale_change && {
                        let most = ITERATION.final_tolerance * self.centre_sigma(&step, &factor);
                        moved < most && self.is_length_steady(&change, most.max(near_px))
                    }
                }
            };
            if settled || (iteration + 1 == most && moved < near_px) {
                return Some(ConvergedIteration {
                    parameters: m,
                    start,
                    scale,
                    step,
                    factor,
                });
            }
            if until == Tolerance::Coarse
                && self.is_hopeless(iteration, step.scale / grey_contrast(&m))
            {
                return None;
            }
        }
        None
    }

    /// Returns true if the residuals, as a fraction of the contrast, are too large for a marker after the first iterations
    /// of a coarse fit.
    fn is_hopeless(&self, iteration: usize, scale: f64) -> bool {
        let HopelessFit { after, residuals } = match self.pixels.pattern {
            MarkerPattern::Disc => ITERATION.hopeless,
            _ if self.pixels.outlined => ITERATION.hopeless_outlined,
            _ => ITERATION.hopeless_crossing,
        };
        iteration >= after && scale > residuals
    }

    /// Returns true if the length of a disc or of an outline changes by less than `most` px, or if the pattern has none.
    fn is_length_steady(&self, change: &ParameterVector, most: f64) -> bool {
        let length = match self.pixels.pattern {
            MarkerPattern::Disc => MAJOR,
            _ if self.pixels.outlined => LENGTH,
            _ => return true,
        };
        change[length].abs() < most
    }

    /// Returns the standard deviation of the centre, px.
    fn centre_sigma(&self, step: &Linearisation, factor: &CholeskyFactor) -> f64 {
        let count = self.unknowns.free.iter().filter(|&&f| f).count();
        let along = |k: usize| factor.solve(&ParameterVector::ith(k, 1.0))[k];
        ((along(X) + along(Y)) * step.variance(count))
            .max(0.0)
            .sqrt()
    }
}
