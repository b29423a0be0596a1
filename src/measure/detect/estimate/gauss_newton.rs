//! The image model fitted to grey values, robustly, with covariance.

use nalgebra::Matrix2;

use super::bounds::{is_plausible, limit};
use super::cholesky::Factor;
use super::normal_equations::{Column, Images, Square, Step, linearise};
use super::prior::Unknowns;
use crate::detect::appearance::parameters::{LENGTH, MAJOR, N, Parameters, Pattern, X, Y, contrast};
use crate::detect::estimate::options::{ITERATION, WEIGHT};
use crate::detect::sample::pixels::Pixels;

/// A converged fit.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Parameters.
    pub parameters: Parameters,
    /// Their covariance; zero for those held fixed.
    pub covariance: Square,
    /// Weighted variance of the residuals, by which the covariance is scaled, grey levels squared.
    pub variance: f64,
    /// Weighted root mean square of the residuals, grey levels.
    pub rms: f64,
    /// Mean robust weight, 0 to 1.
    pub inliers: f64,
    /// Where it was linearised.
    pub start: Parameters,
    /// What the model says there.
    pub images: Images,
    /// The centre's variance from blocks of residuals over that of the fit.
    pub correlation: f64,
    /// The centre's covariance if no residuals hung together, px^2.
    pub white: Matrix2<f64>,
    /// What foreign ground beside its edges makes doubtful, px^2.
    pub beside: Matrix2<f64>,
    /// Whether residuals hang together along the outline, or pixels do not fit: they are no noise alone.
    pub is_systematic: bool,
}

impl Fit {
    /// From a rough one, which leaves twice what the last one does, whose place is known to some standard deviation, px.
    pub fn coarse(parameters: Parameters, scale: f64, sigma_px: f64) -> Self {
        let white = Matrix2::identity() * sigma_px * sigma_px;
        let mut covariance = Square::zeros();
        covariance.fixed_view_mut::<2, 2>(X, X).copy_from(&white);
        let rms = 0.5 * scale;
        Self {
            parameters,
            covariance,
            variance: rms * rms,
            rms,
            inliers: 1.0,
            start: parameters,
            images: Images::new(),
            correlation: 1.0,
            white,
            beside: Matrix2::zeros(),
            is_systematic: false,
        }
    }

    /// The same fit under the condition that the parameters `zero` are 0: exact for a linear model,
    /// and the parameters in question are small.
    pub fn without(self, zero: &[usize]) -> Self {
        let mut out = self;
        for &k in zero {
            let (column, variance) = (out.covariance.column(k).into_owned(), out.covariance[(k, k)]);
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

/// What a fit is made of.
struct Problem<'a> {
    pixels: &'a Pixels,
    images: Option<Images>,
    unknowns: &'a Unknowns,
    floor: f64,
}

/// Where an iteration ended: the parameters, and the linearisation that the last step came from.
struct End {
    parameters: Parameters,
    start: Parameters,
    scale: f64,
    step: Step,
    factor: Factor,
}

/// When an iteration ends.
#[derive(Clone, Copy, PartialEq)]
enum Tolerance {
    /// Within a hundredth of a pixel.
    Coarse,
    /// Within a small part of the centre's standard deviation.
    Final,
}

/// Fits the `free` parameters from `start` to a hundredth of a pixel; with the residuals' scale.
pub fn rough(
    pixels: &Pixels,
    start: &Parameters,
    unknowns: &Unknowns,
    floor: f64,
) -> Option<(Parameters, f64)> {
    let mut problem = Problem::new(pixels, start, unknowns, floor)?;
    // Most pixels are flat and say nothing of an edge that is still off: the scale comes down slowly.
    let end = problem.solve(*start, ITERATION.first_scale * contrast(start), Tolerance::Coarse)?;
    Some((end.parameters, end.scale))
}

/// The answer, from a first geometry in whose solution residuals had about this scale.
pub fn fit(pixels: &Pixels, start: &Parameters, scale: f64, unknowns: &Unknowns, floor: f64) -> Option<Fit> {
    let mut problem = Problem::new(pixels, start, unknowns, floor)?;
    problem.images = Some(Images::new());
    let count = problem.unknowns.free.iter().filter(|&&f| f).count();
    let End { parameters, start, step, factor, .. } =
        problem.solve(*start, scale.max(problem.floor), Tolerance::Final)?;
    let variance = step.variance(count);
    let covariance = factor.inverse() * variance;
    let (rms, inliers) = (step.rms(), step.weight / problem.pixels.weight());
    let images = problem.images.unwrap_or_default();
    let (white, beside) = (covariance.fixed_view::<2, 2>(X, X).into_owned(), Matrix2::zeros());
    Some(Fit {
        parameters,
        covariance,
        variance,
        rms,
        inliers,
        start,
        images,
        correlation: 1.0,
        white,
        beside,
        is_systematic: false,
    })
}

impl<'a> Problem<'a> {
    fn new(pixels: &'a Pixels, start: &Parameters, unknowns: &'a Unknowns, floor: f64) -> Option<Self> {
        let count = unknowns.free.iter().filter(|&&f| f).count();
        let enough = pixels.count() >= 2 * count;
        let floor = floor.max(WEIGHT.floor * contrast(start));
        enough.then_some(Self { pixels, images: None, unknowns, floor })
    }

    /// Repeats the linear solution until the centre stands still.
    fn solve(&mut self, mut m: Parameters, mut scale: f64, until: Tolerance) -> Option<End> {
        let (mut last, near_px) = (scale, ITERATION.near_px);
        let most = if until == Tolerance::Coarse { ITERATION.most_rough } else { ITERATION.most_last };
        for iteration in 0..most {
            let step = linearise(self.pixels, &m, self.unknowns, scale, self.floor, self.images.as_mut());
            let damped = until == Tolerance::Coarse && iteration < ITERATION.damped;
            let damping = if damped { ITERATION.damping } else { ITERATION.undamped };
            let factor = Factor::new(&step.normal, &self.unknowns.free, damping)?;
            let mut change = factor.solve(&step.right);
            let moved = change[X].hypot(change[Y]);
            if moved < ITERATION.gain_px {
                change *= step.gain();
            }
            let change = limit(change, &m, self.pixels);
            let start = m;
            for i in 0..N {
                m[i] += change[i];
            }
            if !is_plausible(self.pixels, &m) {
                return None;
            }
            let ratio = (step.scale / scale - 1.0).abs();
            // Either it stood still before this step, or the step takes next to nothing off the residuals.
            let steady = (step.scale / last - 1.0).abs() < ITERATION.steady
                || step.promise(&change) < ITERATION.hardly;
            last = step.scale;
            scale = step.scale.max(ITERATION.fall * scale);
            let settled = match until {
                Tolerance::Coarse => moved < near_px && steady && self.is_calm(&change, near_px),
                // What is known to a pixel only need not stand as still.
                Tolerance::Final => {
                    ratio < ITERATION.steady_last && {
                        let most = ITERATION.still * self.sigma(&step, &factor);
                        moved < most && self.is_calm(&change, most.max(near_px))
                    }
                }
            };
            if settled || (iteration + 1 == most && moved < near_px) {
                return Some(End { parameters: m, start, scale, step, factor });
            }
            if until == Tolerance::Final && iteration + 1 >= ITERATION.slow && moved > ITERATION.slow_px {
                return None;
            }
            let leaves = |share: f64| step.scale > share * contrast(&m);
            let is_far = moved > ITERATION.late_px && leaves(ITERATION.late_left);
            if (is_far && iteration >= ITERATION.late)
                || (iteration >= ITERATION.early && leaves(ITERATION.early_left))
                || (until == Tolerance::Coarse && self.is_hopeless(iteration, step.scale / contrast(&m)))
            {
                return None;
            }
        }
        None
    }

    /// Whether residuals, as a share of the contrast, are so large after some steps of a rough fit that it is none of a marker's.
    fn is_hopeless(&self, iteration: usize, scale: f64) -> bool {
        let (after, most) = match self.pixels.pattern {
            Pattern::Disc => ITERATION.hopeless,
            _ if self.pixels.outlined => ITERATION.hopeless_outlined,
            _ => ITERATION.hopeless_crossing,
        };
        iteration >= after && scale > most
    }

    /// Whether the length, px, of what has an outline hardly changes.
    fn is_calm(&self, change: &Column, most: f64) -> bool {
        let length = match self.pixels.pattern {
            Pattern::Disc => MAJOR,
            _ if self.pixels.outlined => LENGTH,
            _ => return true,
        };
        change[length].abs() < most
    }

    /// The centre's standard deviation, px.
    fn sigma(&self, step: &Step, factor: &Factor) -> f64 {
        let count = self.unknowns.free.iter().filter(|&&f| f).count();
        let along = |k: usize| factor.solve(&Column::ith(k, 1.0))[k];
        ((along(X) + along(Y)) * step.variance(count)).max(0.0).sqrt()
    }
}
