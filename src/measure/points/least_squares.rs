//! Least-squares matching of two patches (Gruen 1985).
//!
//! The patch of the frame at the template's pixels, shifted and sheared by errors of the skin's slope, is the template
//! times a gain, plus an offset, ramps of light and differences of blur. Shift, gain, offset and ramps are free; the others
//! have priors.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

use super::PointRejection;
use super::patch::GreyPatch;
use crate::estimation::robust::robust_sigma;
use crate::identify::PATCH_REACH_PX;

/// Unknowns: shift, two slopes of the skin, gain, offset, two ramps, three terms of the blur.
pub(super) const UNKNOWNS: usize = 11;
/// Index of the gain among the unknowns.
pub(super) const GAIN: usize = 4;
/// Index of the offset among the unknowns.
const OFFSET: usize = 5;
/// Prior standard deviations of the shift from its start, px; of the slopes, in their standard deviations; of the variance
/// of the blur, px^2, as between two focus settings. 0: none.
pub(super) const PRIOR_SIGMAS: [f64; UNKNOWNS] = [4.0, 4.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.4, 0.4];
/// Standard deviation of the weights over the patch, px: the structure at the point counts more than its surroundings.
const WINDOW_SIGMA_PX: f64 = 9.0;
/// Number of pixels of which one estimates the noise.
const NOISE_STRIDE: usize = 4;
/// Step at convergence, px.
const SETTLED_PX: f64 = 0.005;
/// Multiple of the residuals' standard deviation beyond which weights decrease.
const ROBUST_LIMIT: f64 = 2.5;
/// Side of the blocks over which residuals are summed, px: the correlation of blur, interpolation and a block of JPEG's
/// high frequencies.
pub(super) const BLOCK_PX: usize = 5;
/// Smallest standard deviation of the residuals, grey levels: rounding of two images.
pub(super) const MIN_NOISE: f64 = 0.41;
/// Largest distance of an adjusted shift from its start, px.
const MAX_SHIFT_PX: f64 = 3.0;

/// Steps of an adjustment with constant weights, so that it converges.
#[derive(Clone, Copy, Debug)]
pub(super) struct AdjustmentPass {
    /// Number of pixels of which one is used; 2 is a chequerboard.
    stride: usize,
    steps: usize,
    /// Whether the weights follow the residuals; before, they are those of the window.
    robust: bool,
}

/// Passes of a match.
pub(super) const MATCH_PASSES: [AdjustmentPass; 4] = [
    AdjustmentPass { stride: 2, steps: 3, robust: false },
    AdjustmentPass { stride: 2, steps: 1, robust: true },
    AdjustmentPass { stride: 2, steps: 1, robust: true },
    AdjustmentPass { stride: 1, steps: 10, robust: true },
];
/// Pass of the check backward.
pub(super) const CHECK_PASSES: [AdjustmentPass; 1] = [AdjustmentPass { stride: 2, steps: 8, robust: false }];

pub(super) type Unknowns = SVector<f64, UNKNOWNS>;
pub(super) type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Pixel of the template with the derivatives of the grey value.
pub(super) struct PixelRow {
    /// Offset from the point, px.
    pub(super) at: Vector2<f64>,
    pub(super) template: f64,
    /// Derivatives with respect to the unknowns, by the template's gradient.
    pub(super) design: [f64; UNKNOWNS],
    pub(super) weight: f64,
    /// Weight by the distance from the point.
    pub(super) window: f64,
}

/// Template prepared for the adjustment.
pub(super) struct Matching {
    /// Offset from the point to the centre of the patches, px.
    pub(super) offset: Vector2<f64>,
    pub(super) slopes: [Matrix2<f64>; 2],
    pub(super) rows: Vec<PixelRow>,
}

/// Adjusts the shift of a patch of the frame against a template, from a start. `offset`: from the point to the patches'
/// centre, px; `slopes`: changes of the map from ground frame to ground frame by the skin's slope.
///
/// # Errors
/// Returns the reason if nothing determines the shift, or the adjustment does not converge.
pub(super) fn adjust_shift(
    template: &GreyPatch,
    patch: &GreyPatch,
    start: Vector2<f64>,
    offset: Vector2<f64>,
    slopes: [Matrix2<f64>; 2],
    passes: &[AdjustmentPass],
) -> Result<AdjustedShift, PointRejection> {
    let mut matching = Matching { offset, slopes, rows: template_rows(template, offset, &slopes) };
    let mut unknowns = matching.start_values(patch, start);
    let (mut noise, mut last) = (MIN_NOISE, Vector2::repeat(f64::INFINITY));
    for pass in passes {
        if pass.robust {
            let residuals = matching.residuals(patch, &unknowns, 1);
            noise = robust_noise(&residuals);
            matching.weight_rows(&residuals, noise);
        }
        let normal = matching.normal_matrix(pass.stride);
        for _ in 0..pass.steps {
            let residuals = matching.residuals(patch, &unknowns, pass.stride);
            let change = matching.step(&normal, &unknowns, start, (&residuals, pass.stride), noise);
            let change = change.ok_or(PointRejection::NoStructure)?;
            unknowns += change;
            last = change.fixed_rows::<2>(0).into_owned();
            if !last.norm().is_finite() || (unknowns.fixed_rows::<2>(0) - start).amax() > MAX_SHIFT_PX {
                return Err(PointRejection::NoConvergence);
            }
            if last.norm() < SETTLED_PX {
                break;
            }
        }
    }
    Ok(AdjustedShift { matching, unknowns, noise, last })
}

/// Adjusted shift of a patch.
pub(super) struct AdjustedShift {
    pub(super) matching: Matching,
    pub(super) unknowns: Unknowns,
    pub(super) noise: f64,
    /// Last change of the shift, px.
    pub(super) last: Vector2<f64>,
}

/// Standard deviation of residuals from their median size, grey levels.
fn robust_noise(residuals: &[f64]) -> f64 {
    let some = residuals.iter().step_by(NOISE_STRIDE);
    MIN_NOISE * robust_sigma(some.map(|r| r.abs() / MIN_NOISE).collect())
}

fn template_rows(template: &GreyPatch, offset: Vector2<f64>, slopes: &[Matrix2<f64>; 2]) -> Vec<PixelRow> {
    let reach = PATCH_REACH_PX as isize;
    let scale = 1.0 / PATCH_REACH_PX as f64;
    let row = |x: isize, y: isize| {
        let value = |i: isize, j: isize| f64::from(template.value(x + i, y + j));
        let centre = value(0, 0);
        let gradient = template.gradient(x, y);
        let (xx, yy) = (value(1, 0) + value(-1, 0) - 2.0 * centre, value(0, 1) + value(0, -1) - 2.0 * centre);
        let xy = 0.25 * (value(1, 1) - value(1, -1) - value(-1, 1) + value(-1, -1));
        let at = Vector2::new(x as f64, y as f64) + offset;
        let [a, b] = slopes.map(|by| -gradient.dot(&(by * at)));
        let design = [-gradient.x, -gradient.y, a, b, centre, 1.0, at.x * scale, at.y * scale, 0.5 * xx, 0.5 * yy, xy];
        let window = (-0.5 * at.norm_squared() / (WINDOW_SIGMA_PX * WINDOW_SIGMA_PX)).exp();
        PixelRow { at, template: centre, design, weight: window, window }
    };
    (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| row(x, y))).collect()
}

impl Matching {
    /// Returns the values at the start: the gain and offset of equal mean and contrast.
    fn start_values(&self, patch: &GreyPatch, start: Vector2<f64>) -> Unknowns {
        let mut unknowns = Unknowns::zeros();
        unknowns.fixed_rows_mut::<2>(0).copy_from(&start);
        let sampled: Vec<f64> =
            self.rows.iter().map(|row| f64::from(self.sample_at(patch, row.at, &unknowns))).collect();
        let total: f64 = self.rows.iter().map(|row| row.weight).sum();
        let mean = |value: &dyn Fn(usize) -> f64| {
            self.rows.iter().enumerate().map(|(k, row)| row.weight * value(k)).sum::<f64>() / total
        };
        let (template, frame) = (mean(&|k| self.rows[k].template), mean(&|k| sampled[k]));
        let variance = mean(&|k| (self.rows[k].template - template).powi(2));
        let covariance = mean(&|k| (self.rows[k].template - template) * (sampled[k] - frame));
        unknowns[GAIN] = if variance > 0.0 { covariance / variance } else { 1.0 };
        unknowns[OFFSET] = frame - unknowns[GAIN] * template;
        unknowns
    }

    /// Returns the grey value of the frame's patch at an offset from the point in the template.
    pub(super) fn sample_at(&self, patch: &GreyPatch, at: Vector2<f64>, unknowns: &Unknowns) -> f32 {
        let sheared = (self.slopes[0] * unknowns[2] + self.slopes[1] * unknowns[3]) * at;
        let on_grid = at - self.offset + sheared;
        patch.sample(on_grid.x + unknowns[0], on_grid.y + unknowns[1])
    }

    /// Returns the grey values of the frame less those of the model, at every `stride`-th pixel.
    pub(super) fn residuals(&self, patch: &GreyPatch, unknowns: &Unknowns, stride: usize) -> Vec<f64> {
        let one = |row: &PixelRow| {
            let model: f64 = (GAIN..UNKNOWNS).map(|k| row.design[k] * unknowns[k]).sum();
            f64::from(self.sample_at(patch, row.at, unknowns)) - model
        };
        self.rows.iter().step_by(stride).map(one).collect()
    }

    /// Returns the normal matrix of the design as it is, for a gain of 1, of every `stride`-th pixel.
    fn normal_matrix(&self, stride: usize) -> Normal {
        let mut sums = [[0.0; UNKNOWNS]; UNKNOWNS];
        for row in self.rows.iter().step_by(stride) {
            for (own, sums) in row.design.iter().zip(&mut sums) {
                let weighted = own * row.weight;
                sums.iter_mut().zip(&row.design).for_each(|(sum, other)| *sum += weighted * other);
            }
        }
        Normal::from(sums)
    }

    fn weight_rows(&mut self, residuals: &[f64], noise: f64) {
        for (row, residual) in self.rows.iter_mut().zip(residuals) {
            let size = residual.abs() / (ROBUST_LIMIT * noise);
            row.weight = if size > 1.0 { row.window / (size * size) } else { row.window };
        }
    }

    /// Returns the information of the priors, in units of the residuals' weights.
    pub(super) fn prior_information(&self, noise: f64) -> Unknowns {
        let block = (BLOCK_PX * BLOCK_PX) as f64;
        let information = |sigma: f64| if sigma > 0.0 { 0.25 * block * (noise / sigma).powi(2) } else { 0.0 };
        Unknowns::from(PRIOR_SIGMAS).map(information)
    }

    /// Returns the factors of the derivatives: those with respect to place and blur grow with the gain.
    pub(super) fn factors(unknowns: &Unknowns) -> Unknowns {
        let gain = unknowns[GAIN];
        Unknowns::from([gain, gain, gain, gain, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    }

    /// Returns the next change of the unknowns.
    fn step(
        &self,
        normal: &Normal,
        unknowns: &Unknowns,
        start: Vector2<f64>,
        (residuals, stride): (&[f64], usize),
        noise: f64,
    ) -> Option<Unknowns> {
        let factors = Self::factors(unknowns);
        let mut sums = [0.0; UNKNOWNS];
        for (row, residual) in self.rows.iter().step_by(stride).zip(residuals) {
            let weighted = row.weight * residual;
            sums.iter_mut().zip(&row.design).for_each(|(sum, own)| *sum += weighted * own);
        }
        let mut from_prior = *unknowns;
        from_prior[0] -= start.x;
        from_prior[1] -= start.y;
        let prior = self.prior_information(noise);
        let right = Unknowns::from(sums).component_mul(&factors) - prior.component_mul(&from_prior);
        let scaled = Normal::from_fn(|i, k| normal[(i, k)] * factors[i] * factors[k]) + Normal::from_diagonal(&prior);
        Some(scaled.cholesky()?.solve(&right))
    }
}
