//! Least-squares matching of two patches (Gruen 1985).
//!
//! The patch of the frame at the template's pixels, shifted and sheared by errors of the skin's slope, is the template
//! times a gain, plus an offset, ramps of light and differences of blur. Shift, gain, offset and ramps are free; the others
//! have priors.
//!
//! Weights and unknowns follow from the template's gradients, the information from the products of the gradients of **both**
//! patches: noise, which adds to the squares of each, has no part in them. A patch with an edge alone is so determined
//! across it only. The covariance is that of the residuals summed over blocks, which has the correlation of neighbouring
//! pixels by interpolation, JPEG and errors of the model.

use nalgebra::{Matrix2, SMatrix, SVector, SymmetricEigen, Vector2};

use super::PointRejection;
use super::patch::Patch;
use crate::estimation::robust::robust_sigma;
use crate::identify::PATCH_REACH_PX;

/// Unknowns: shift, two slopes of the skin, gain, offset, two ramps, three terms of the blur.
const UNKNOWNS: usize = 11;
const GAIN: usize = 4;
const OFFSET: usize = 5;
/// Prior standard deviations of the shift from its start, px; of the slopes, in their standard deviations; of the variance
/// of the blur, px^2, as between two focus settings. 0: none.
const PRIOR_SIGMAS: [f64; UNKNOWNS] = [4.0, 4.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.4, 0.4];
/// Standard deviation of the weights over the patch, px: the structure at the point counts more than its surroundings.
const WINDOW_SIGMA_PX: f64 = 9.0;
/// Number of pixels of which one estimates the noise.
const NOISE_STRIDE: usize = 4;
/// Step at convergence: px, and in standard deviations for a direction that is poorly determined.
const SETTLED_PX: f64 = 0.005;
const SETTLED_SIGMAS: f64 = 0.3;
/// Multiple of the residuals' standard deviation beyond which weights decrease.
const ROBUST_LIMIT: f64 = 2.5;
/// Side of the blocks over which residuals are summed, px: the correlation of blur, interpolation and a block of JPEG's
/// high frequencies.
const BLOCK_PX: usize = 5;
/// Smallest standard deviation of the residuals, grey levels: rounding of two images.
const MIN_NOISE: f64 = 0.41;
/// Number of neighbouring pixels whose interpolated gradients have one independent value.
const CORRELATED_GRADIENTS: f64 = 3.0;
/// Largest factor on a standard deviation in a direction without structure.
const MAX_RAISE: f64 = 100.0;
/// Smallest standard deviation of a shift, px: errors of the interpolation and of the map within the patch.
const MIN_SIGMA_PX: f64 = 0.02;
/// Largest standard deviation of a shift along its well-determined direction, px: the correlation finds nothing sharper.
const MAX_SIGMA_PX: f64 = 0.4;
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

type Unknowns = SVector<f64, UNKNOWNS>;
type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Shift of a patch.
#[derive(Clone, Debug)]
pub(super) struct PatchShift {
    /// Shift on the grid of the ground frame, px.
    pub(super) shift: Vector2<f64>,
    /// Covariance, px^2.
    pub(super) covariance: Matrix2<f64>,
    /// Share of the frame's contrast that the template explains, without uncorrelated noise.
    pub(super) explained: f64,
}

/// Pixel of the template with the derivatives of the grey value.
struct PixelRow {
    /// Offset from the point, px.
    at: Vector2<f64>,
    template: f64,
    /// Derivatives with respect to the unknowns, by the template's gradient.
    design: [f64; UNKNOWNS],
    weight: f64,
    /// Weight by the distance from the point.
    window: f64,
}

/// Template prepared for the adjustment.
struct Matching {
    /// Offset from the point to the centre of the patches, px.
    offset: Vector2<f64>,
    slopes: [Matrix2<f64>; 2],
    rows: Vec<PixelRow>,
}

/// Adjusts the shift of a patch of the frame against a template, from a start. `offset`: from the point to the patches'
/// centre, px; `slopes`: changes of the map from ground frame to ground frame by the skin's slope.
///
/// # Errors
/// Returns the reason if nothing determines the shift, or the adjustment does not converge.
pub(super) fn adjust_shift(
    template: &Patch,
    patch: &Patch,
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
    matching: Matching,
    unknowns: Unknowns,
    noise: f64,
    /// Last change of the shift, px.
    last: Vector2<f64>,
}

/// Standard deviation of residuals from their median size, grey levels.
fn robust_noise(residuals: &[f64]) -> f64 {
    let some = residuals.iter().step_by(NOISE_STRIDE);
    MIN_NOISE * robust_sigma(some.map(|r| r.abs() / MIN_NOISE).collect())
}

fn template_rows(template: &Patch, offset: Vector2<f64>, slopes: &[Matrix2<f64>; 2]) -> Vec<PixelRow> {
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
    fn start_values(&self, patch: &Patch, start: Vector2<f64>) -> Unknowns {
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
    fn sample_at(&self, patch: &Patch, at: Vector2<f64>, unknowns: &Unknowns) -> f32 {
        let sheared = (self.slopes[0] * unknowns[2] + self.slopes[1] * unknowns[3]) * at;
        let on_grid = at - self.offset + sheared;
        patch.sample(on_grid.x + unknowns[0], on_grid.y + unknowns[1])
    }

    /// Returns the grey values of the frame less those of the model, at every `stride`-th pixel.
    fn residuals(&self, patch: &Patch, unknowns: &Unknowns, stride: usize) -> Vec<f64> {
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
    fn prior_information(&self, noise: f64) -> Unknowns {
        let block = (BLOCK_PX * BLOCK_PX) as f64;
        let information = |sigma: f64| if sigma > 0.0 { 0.25 * block * (noise / sigma).powi(2) } else { 0.0 };
        Unknowns::from(PRIOR_SIGMAS).map(information)
    }

    /// Returns the factors of the derivatives: those with respect to place and blur grow with the gain.
    fn factors(unknowns: &Unknowns) -> Unknowns {
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

    /// Returns the products of the gradients of both patches, with the priors of all unknowns but the shift.
    fn information(&self, shifted: &Patch, factors: &Unknowns, noise: f64) -> Normal {
        let reach = PATCH_REACH_PX as isize;
        let side = 2 * reach + 1;
        let mut sums = [[0.0; UNKNOWNS]; UNKNOWNS];
        for (k, row) in self.rows.iter().enumerate() {
            let (x, y) = (k as isize % side - reach, k as isize / side - reach);
            let gradient = shifted.gradient(x, y);
            let mut seen: [f64; UNKNOWNS] = std::array::from_fn(|i| row.design[i] * factors[i]);
            let own = seen;
            [seen[0], seen[1]] = [-gradient.x, -gradient.y];
            [seen[2], seen[3]] = self.slopes.map(|by| -gradient.dot(&(by * row.at)));
            for (seen, sums) in seen.iter().zip(&mut sums) {
                let weighted = seen * row.weight;
                sums.iter_mut().zip(&own).for_each(|(sum, own)| *sum += weighted * own);
            }
        }
        // The shift's own prior only keeps the adjustment from drifting: it is no observation.
        let mut prior = self.prior_information(noise);
        prior.fixed_rows_mut::<2>(0).fill(0.0);
        Normal::from(sums) + Normal::from_diagonal(&prior)
    }

    /// Returns the factors by which standard deviations of the shift are raised because noise may feign information: that of
    /// each direction less three standard deviations of the products of noise over itself. `None` if no direction has any.
    fn raise_weak_directions(&self, inverse: &Normal, shifted: &Patch, gain: f64) -> Option<Matrix2<f64>> {
        let products = inverse.fixed_view::<2, 2>(0, 0).try_inverse()?;
        let axes = SymmetricEigen::new((products + products.transpose()) * 0.5);
        let reach = PATCH_REACH_PX as isize;
        let (mut of_template, mut of_frame) = (Vector2::zeros(), Vector2::zeros());
        for (k, row) in self.rows.iter().enumerate() {
            let (x, y) = (k as isize % (2 * reach + 1) - reach, k as isize / (2 * reach + 1) - reach);
            let seen = axes.eigenvectors.tr_mul(&shifted.gradient(x, y));
            let own = axes.eigenvectors.tr_mul(&Vector2::new(row.design[0], row.design[1])) * gain;
            of_template += own.component_mul(&own) * row.weight;
            of_frame += seen.component_mul(&seen) * row.weight;
        }
        let sum = |power: i32| self.rows.iter().map(|row| row.weight.powi(power)).sum::<f64>();
        let independent = sum(1).powi(2) / (CORRELATED_GRADIENTS * sum(2));
        let factors = axes.eigenvalues.zip_zip_map(&of_template, &of_frame, |information, template, frame| {
            let noise = (template - information).max(0.0) * (frame - information).max(0.0) / independent;
            (information / (information - 3.0 * noise.sqrt()).max(information.abs() / MAX_RAISE)).max(1.0)
        });
        let is_weak = axes.eigenvalues.map(|information| information <= 0.0);
        let factors = factors.zip_map(&is_weak, |factor, weak| if weak { MAX_RAISE } else { factor });
        let raise = axes.eigenvectors * Matrix2::from_diagonal(&factors) * axes.eigenvectors.transpose();
        (!is_weak.iter().all(|weak| *weak)).then_some(raise)
    }

    /// Returns the share of the frame's contrast that the template explains, without uncorrelated noise.
    fn explained_share(&self, unknowns: &Unknowns, residuals: &[f64]) -> f64 {
        let weights: f64 = self.rows.iter().map(|row| row.window).sum();
        let mean = self.rows.iter().map(|row| row.window * row.template).sum::<f64>() / weights;
        let contrast: f64 = self.rows.iter().map(|row| row.window * (row.template - mean).powi(2)).sum();
        let weighted = |(row, r): (&PixelRow, &f64)| Vector2::new(row.window.sqrt() * r, 0.0);
        let weighted: Vec<Vector2<f64>> = self.rows.iter().zip(residuals).map(weighted).collect();
        // Blocks of uncorrelated residuals, smoothed by the interpolation, have about twice their variance.
        let white = 2.0 * weighted.iter().map(|r| r.x * r.x).sum::<f64>();
        let structured = (block_covariance(&weighted)[(0, 0)] - white).max(0.0) / (BLOCK_PX * BLOCK_PX) as f64;
        let signal = unknowns[GAIN].powi(2) * contrast;
        signal / (signal + structured)
    }
}

impl AdjustedShift {
    /// Returns the shift, px.
    pub(super) fn shift(&self) -> Vector2<f64> {
        self.unknowns.fixed_rows::<2>(0).into_owned()
    }

    /// Returns the mean square of the residuals, weighted by the distance from the point, grey levels squared.
    pub(super) fn misfit(&self, patch: &Patch) -> f64 {
        let residuals = self.matching.residuals(patch, &self.unknowns, 1);
        let rows = || self.matching.rows.iter();
        let squares: f64 = rows().zip(&residuals).map(|(row, r)| row.window * r * r).sum();
        (squares / rows().map(|row| row.window).sum::<f64>()).max(MIN_NOISE * MIN_NOISE)
    }

    /// Returns the patch at the shift.
    pub(super) fn shifted_patch(&self, patch: &Patch) -> Patch {
        let at = |x: f64, y: f64| self.matching.offset + Vector2::new(x, y);
        Patch::from_values([PATCH_REACH_PX + 1; 2], |x, y| self.matching.sample_at(patch, at(x, y), &self.unknowns))
    }

    /// Returns the shift with its covariance.
    ///
    /// # Errors
    /// Returns the reason if no direction is well determined, or the adjustment did not converge.
    pub(super) fn conclude(&self, patch: &Patch) -> Result<PatchShift, PointRejection> {
        let Self { matching, unknowns, noise, last } = self;
        let shifted = self.shifted_patch(patch);
        let factors = Matching::factors(unknowns);
        let residuals = matching.residuals(patch, unknowns, 1);
        let information = matching.information(&shifted, &factors, *noise);
        let inverse = information.try_inverse().ok_or(PointRejection::NoStructure)?;
        let influence = inverse.fixed_rows::<2>(0) * Normal::from_diagonal(&factors);
        let mut rounding = Matrix2::zeros();
        let effect = |(row, residual): (&PixelRow, &f64)| {
            let by_grey = influence * Unknowns::from(row.design) * row.weight;
            rounding += by_grey * by_grey.transpose() * (MIN_NOISE * MIN_NOISE);
            by_grey * *residual
        };
        let effects: Vec<Vector2<f64>> = matching.rows.iter().zip(&residuals).map(effect).collect();
        let prior = matching.prior_information(*noise);
        let by_prior = Unknowns::from_fn(|k, _| if k < 2 { 0.0 } else { (prior[k] * PRIOR_SIGMAS[k]).powi(2) });
        let of_shift = inverse.fixed_rows::<2>(0);
        let priors = of_shift * Normal::from_diagonal(&by_prior) * of_shift.transpose();
        // Each unknown takes the residuals of a block.
        let lost = 1.0 / (1.0 - (UNKNOWNS * BLOCK_PX * BLOCK_PX) as f64 / matching.rows.len() as f64);
        let raised =
            matching.raise_weak_directions(&inverse, &shifted, factors[0]).ok_or(PointRejection::NoStructure)?;
        let covariance = raised * (block_covariance(&effects) * lost + rounding + priors) * raised
            + Matrix2::identity() * MIN_SIGMA_PX.powi(2);
        let axes = SymmetricEigen::new(covariance).eigenvalues;
        if !axes.iter().all(|v| v.is_finite()) || axes.min() > MAX_SIGMA_PX.powi(2) {
            return Err(PointRejection::NoStructure);
        }
        let weight = covariance.try_inverse().ok_or(PointRejection::NoStructure)?;
        if last.dot(&(weight * last)) > SETTLED_SIGMAS * SETTLED_SIGMAS {
            return Err(PointRejection::NoConvergence);
        }
        let explained = matching.explained_share(unknowns, &residuals);
        Ok(PatchShift { shift: self.shift(), covariance, explained })
    }
}

/// Covariance of the sum of effects that are correlated over blocks of pixels: the mean over all positions of the blocks.
fn block_covariance(effects: &[Vector2<f64>]) -> Matrix2<f64> {
    let side = 2 * PATCH_REACH_PX + 1;
    let (block, count) = (BLOCK_PX, side + BLOCK_PX - 1);
    // Sums along the rows, then down the columns; blocks reach over the patch's edge.
    let window = |k: usize| k.saturating_sub(block - 1)..(k + 1).min(side);
    let along: Vec<Vec<Vector2<f64>>> =
        effects.chunks_exact(side).map(|row| (0..count).map(|k| row[window(k)].iter().sum()).collect()).collect();
    let mut sum = Matrix2::zeros();
    for j in 0..count {
        for k in 0..count {
            let total: Vector2<f64> = along[window(j)].iter().map(|row| row[k]).sum();
            sum += total * total.transpose();
        }
    }
    sum / (block * block) as f64
}
