//! Least-squares matching of two patches (Gruen 1985).
//!
//! The patch of the frame at the template's pixels, shifted and sheared by errors of the skin's slope, is the template
//! times a gain, plus an offset, ramps of light and differences of blur. Shift, gain, offset and ramps are free; the others
//! have priors.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

use super::PointRejection;
use super::patch::{GreyPatch, RowPath, sobel_gradient};
use crate::dispatch::wide;
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
pub(super) const PRIOR_SIGMAS: [f64; UNKNOWNS] =
    [4.0, 4.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.4, 0.4];
/// Standard deviation of the weights over the patch, px: the structure at the point counts more than its surroundings.
const WINDOW_SIGMA_PX: f64 = 9.0;
/// Number of residuals that estimate the noise: its standard deviation is then known to 8 %.
const NOISE_VALUES: usize = 240;
/// Number of pixels of which one counts for the start and in the first pass.
const START_STRIDE: usize = 2;
/// Step at convergence, px: half the smallest standard deviation of a shift.
const SETTLED_PX: f64 = 0.01;
/// Step below which the residuals change linearly, px: enough before more exact passes, and for the check backward.
const LINEAR_PX: f64 = 0.05;
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
    /// Step at convergence, px: at most [`LINEAR_PX`].
    settled_px: f64,
    /// Whether the weights follow the residuals; before, they are those of the window.
    robust: bool,
}

/// Passes of a match.
pub(super) const MATCH_PASSES: [AdjustmentPass; 4] = [
    AdjustmentPass {
        stride: START_STRIDE,
        steps: 3,
        settled_px: LINEAR_PX,
        robust: false,
    },
    AdjustmentPass {
        stride: START_STRIDE,
        steps: 1,
        settled_px: LINEAR_PX,
        robust: true,
    },
    AdjustmentPass {
        stride: START_STRIDE,
        steps: 1,
        settled_px: LINEAR_PX,
        robust: true,
    },
    AdjustmentPass {
        stride: 1,
        steps: 10,
        settled_px: SETTLED_PX,
        robust: true,
    },
];
/// Pass of the check backward, which only has to reach the same place: without robust weights, on half of the pixels.
pub(super) const CHECK_PASSES: [AdjustmentPass; 1] = [AdjustmentPass {
    stride: START_STRIDE,
    steps: 8,
    settled_px: LINEAR_PX,
    robust: false,
}];

pub(super) type Unknowns = SVector<f64, UNKNOWNS>;
/// Derivatives with respect to the unknowns, and a zero: registers hold four of them.
pub(super) type DesignRow = [f64; UNKNOWNS + 1];
pub(super) type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Pixel of the template with the derivatives of the grey value: two lines of the processor's cache.
#[repr(align(64))]
pub(super) struct PixelRow {
    /// Offset from the point, px.
    pub(super) at: Vector2<f64>,
    /// Derivatives with respect to the unknowns, by the template's gradient: that of the gain is the template's grey value.
    pub(super) design: DesignRow,
    pub(super) weight: f64,
    /// Weight by the distance from the point.
    pub(super) window: f64,
}

/// Template prepared for the adjustment.
pub(super) struct Matching {
    /// Offset from the point to the centre of the patches, px.
    pub(super) offset: Vector2<f64>,
    pub(super) slopes: [Matrix2<f64>; 2],
    /// Every `spacing`-th pixel of the template, row by row.
    pub(super) rows: Vec<PixelRow>,
    spacing: usize,
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
    let spacing = passes.iter().map(|pass| pass.stride).min().unwrap_or(1);
    let rows = template_rows(template, offset, &slopes, spacing);
    let mut matching = Matching {
        offset,
        slopes,
        rows,
        spacing,
    };
    let mut stride = START_STRIDE / spacing;
    let (mut unknowns, mut residuals) = matching.start_values(patch, start, stride);
    let (mut noise, mut last) = (MIN_NOISE, Vector2::repeat(f64::INFINITY));
    for pass in passes {
        if pass.stride != stride * spacing {
            stride = pass.stride / spacing;
            residuals = matching.residuals(patch, &unknowns, stride);
        }
        if pass.robust {
            noise = robust_noise(&residuals);
            matching.weight_rows((&residuals, stride), noise);
        }
        let normal = matching.normal_matrix(stride);
        for _ in 0..pass.steps {
            let change = matching.step(&normal, &unknowns, start, (&residuals, stride), noise);
            let change = change.ok_or(PointRejection::NoStructure)?;
            last = change.fixed_rows::<2>(0).into_owned();
            let is_last = last.norm() < pass.settled_px;
            if is_last {
                let grey = change.component_mul(&Matching::factors(&unknowns));
                subtract_model(&matching.rows, stride, 0, &grey.data.0[0], &mut residuals);
            }
            unknowns += change;
            if !last.norm().is_finite()
                || (unknowns.fixed_rows::<2>(0) - start).amax() > MAX_SHIFT_PX
            {
                return Err(PointRejection::NoConvergence);
            }
            if is_last {
                break;
            }
            residuals = matching.residuals(patch, &unknowns, stride);
        }
    }
    Ok(AdjustedShift {
        matching,
        unknowns,
        residuals,
        noise,
        last,
    })
}

/// Adjusted shift of a patch.
pub(super) struct AdjustedShift {
    pub(super) matching: Matching,
    pub(super) unknowns: Unknowns,
    /// Grey values of the frame less those of the model at the pixels of the last pass.
    pub(super) residuals: Vec<f64>,
    pub(super) noise: f64,
    /// Last change of the shift, px.
    pub(super) last: Vector2<f64>,
}

/// Standard deviation of residuals from their median size, grey levels.
fn robust_noise(residuals: &[f64]) -> f64 {
    let some = residuals
        .iter()
        .step_by(residuals.len().div_ceil(NOISE_VALUES));
    MIN_NOISE * robust_sigma(some.map(|r| r.abs() / MIN_NOISE).collect())
}

/// Returns every `spacing`-th pixel of a template.
fn template_rows(
    template: &GreyPatch,
    offset: Vector2<f64>,
    slopes: &[Matrix2<f64>; 2],
    spacing: usize,
) -> Vec<PixelRow> {
    let (reach, side) = (PATCH_REACH_PX as i32, 2 * PATCH_REACH_PX + 1);
    let scale = 1.0 / PATCH_REACH_PX as f64;
    let bell = |along: f64| (-0.5 * (along / WINDOW_SIGMA_PX).powi(2)).exp();
    let bells = [offset.x, offset.y].map(|at| {
        (-reach..=reach)
            .map(|x| bell(f64::from(x) + at))
            .collect::<Vec<f64>>()
    });
    let row = |index: usize| {
        let [i, j] = [index % side, index / side];
        let [x, y] = [i, j].map(|k| k as i32 - reach);
        let around = template.neighbours(x, y);
        let [above, [left, centre, right], below] = around;
        let gradient = sobel_gradient(&around);
        let (xx, yy) = (
            right + left - 2.0 * centre,
            below[1] + above[1] - 2.0 * centre,
        );
        let xy = 0.25 * (below[2] - above[2] - below[0] + above[0]);
        let at = Vector2::new(f64::from(x), f64::from(y)) + offset;
        let [a, b] = slopes.map(|by| -gradient.dot(&(by * at)));
        let [ramp_u, ramp_v] = [at.x * scale, at.y * scale];
        let design = [
            -gradient.x,
            -gradient.y,
            a,
            b,
            centre,
            1.0,
            ramp_u,
            ramp_v,
            0.5 * xx,
            0.5 * yy,
            xy,
            0.0,
        ];
        let window = bells[0][i] * bells[1][j];
        PixelRow {
            at,
            design,
            weight: window,
            window,
        }
    };
    (0..side * side).step_by(spacing).map(row).collect()
}

impl Matching {
    /// Returns the values at the start, with the gain and offset of equal mean and contrast, and the residuals at every
    /// `stride`-th row.
    fn start_values(
        &self,
        patch: &GreyPatch,
        start: Vector2<f64>,
        stride: usize,
    ) -> (Unknowns, Vec<f64>) {
        let mut unknowns = Unknowns::zeros();
        unknowns.fixed_rows_mut::<2>(0).copy_from(&start);
        let mut residuals = self.sample(patch, &unknowns, stride);
        let sampled = &residuals;
        let rows = || self.rows.iter().step_by(stride).zip(sampled);
        let total: f64 = rows().map(|(row, _)| row.weight).sum();
        let mean = |value: &dyn Fn(f64, f64) -> f64| {
            rows()
                .map(|(row, frame)| row.weight * value(row.design[GAIN], *frame))
                .sum::<f64>()
                / total
        };
        let (template, frame) = (mean(&|template, _| template), mean(&|_, frame| frame));
        let variance = mean(&|other, _| (other - template).powi(2));
        let covariance = mean(&|other, value| (other - template) * (value - frame));
        unknowns[GAIN] = if variance > 0.0 {
            covariance / variance
        } else {
            1.0
        };
        unknowns[OFFSET] = frame - unknowns[GAIN] * template;
        subtract_model(
            &self.rows,
            stride,
            GAIN,
            &unknowns.data.0[0],
            &mut residuals,
        );
        (unknowns, residuals)
    }

    /// Returns the positions in the frame's patch of the template's row `y` px from its centre.
    pub(super) fn row_path(&self, y: f64, unknowns: &Unknowns) -> RowPath {
        let shear = self.slopes[0] * unknowns[2] + self.slopes[1] * unknowns[3];
        let start = shear * (self.offset + Vector2::new(0.0, y))
            + Vector2::new(unknowns[0], unknowns[1] + y);
        [
            [start.x, 1.0 + shear[(0, 0)], 0.0],
            [start.y, shear[(1, 0)], 0.0],
        ]
    }

    /// Returns the grey values of the frame at every `stride`-th row.
    fn sample(&self, patch: &GreyPatch, unknowns: &Unknowns, stride: usize) -> Vec<f64> {
        let stride = stride * self.spacing;
        let side = 2 * PATCH_REACH_PX + 1;
        let mut values = vec![0.0; (side * side).div_ceil(stride)];
        let (mut filled, reach) = (0, PATCH_REACH_PX as f64);
        for j in 0..side {
            let skipped = (filled * stride) - j * side;
            let end = ((j + 1) * side).div_ceil(stride);
            let path = self.row_path(j as f64 - reach, unknowns);
            patch.sample_row(
                &path,
                skipped as f64 - reach,
                stride as f64,
                &mut values[filled..end],
            );
            filled = end;
        }
        values.into_iter().map(f64::from).collect()
    }

    /// Returns the grey values of the frame less those of the model, at every `stride`-th row.
    fn residuals(&self, patch: &GreyPatch, unknowns: &Unknowns, stride: usize) -> Vec<f64> {
        let mut residuals = self.sample(patch, unknowns, stride);
        subtract_model(
            &self.rows,
            stride,
            GAIN,
            &unknowns.data.0[0],
            &mut residuals,
        );
        residuals
    }

    /// Returns the normal matrix of the design as it is, for a gain of 1, of every `stride`-th row.
    fn normal_matrix(&self, stride: usize) -> Normal {
        let mut weighted = vec![[0.0; UNKNOWNS + 1]; self.rows.len().div_ceil(stride)];
        for (weighted, row) in weighted.iter_mut().zip(self.rows.iter().step_by(stride)) {
            weighted
                .iter_mut()
                .zip(&row.design)
                .for_each(|(weighted, own)| *weighted = own * row.weight);
        }
        self.sum_products(&weighted, stride)
    }

    /// Returns the sums of products of derivatives at every `stride`-th row with other rows of as many.
    pub(super) fn sum_products(&self, left: &[DesignRow], stride: usize) -> Normal {
        let mut sums = [[0.0; UNKNOWNS + 1]; UNKNOWNS + 1];
        sum_products(&self.rows, stride, left, &mut sums);
        Normal::from_fn(|i, k| sums[i][k])
    }

    fn weight_rows(&mut self, (residuals, stride): (&[f64], usize), noise: f64) {
        for (row, residual) in self.rows.iter_mut().step_by(stride).zip(residuals) {
            let size = residual.abs() / (ROBUST_LIMIT * noise);
            row.weight = if size > 1.0 {
                row.window / (size * size)
            } else {
                row.window
            };
        }
    }

    /// Returns the information of the priors, in units of the residuals' weights.
    pub(super) fn prior_information(&self, noise: f64) -> Unknowns {
        let block = (BLOCK_PX * BLOCK_PX) as f64;
        let information = |sigma: f64| {
            if sigma > 0.0 {
                0.25 * block * (noise / sigma).powi(2)
            } else {
                0.0
            }
        };
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
        let mut sums = [0.0; UNKNOWNS + 1];
        add_right_side(&self.rows, stride, residuals, &mut sums);
        let mut from_prior = *unknowns;
        from_prior[0] -= start.x;
        from_prior[1] -= start.y;
        let prior = self.prior_information(noise);
        let right = Unknowns::from_fn(|k, _| sums[k]).component_mul(&factors)
            - prior.component_mul(&from_prior);
        let scaled = Normal::from_fn(|i, k| normal[(i, k)] * factors[i] * factors[k])
            + Normal::from_diagonal(&prior);
        Some(scaled.cholesky()?.solve(&right))
    }
}

wide! {
    /// Subtracts the products of derivatives and unknowns, from unknown `first` on, at every `stride`-th row.
    fn subtract_model(rows: &[PixelRow], stride: usize, first: usize, unknowns: &[f64; UNKNOWNS], out: &mut [f64])
        = subtract_model_inline
}

#[inline(always)]
fn subtract_model_inline(
    rows: &[PixelRow],
    stride: usize,
    first: usize,
    unknowns: &[f64; UNKNOWNS],
    out: &mut [f64],
) {
    let mut padded = [0.0; UNKNOWNS + 1];
    padded
        .iter_mut()
        .zip(unknowns)
        .skip(first)
        .for_each(|(own, value)| *own = *value);
    for (row, out) in rows.iter().step_by(stride).zip(out) {
        let mut sums = [0.0; 4];
        for (a, b) in row.design.chunks_exact(4).zip(padded.chunks_exact(4)) {
            sums.iter_mut()
                .zip(a.iter().zip(b))
                .for_each(|(sum, (a, b))| *sum += a * b);
        }
        *out -= (sums[0] + sums[1]) + (sums[2] + sums[3]);
    }
}

wide! {
    /// Sums the products of derivatives at every `stride`-th row with other rows of as many.
    fn sum_products(rows: &[PixelRow], stride: usize, left: &[DesignRow], sums: &mut [DesignRow; UNKNOWNS + 1])
        = sum_products_inline
}

/// Four rows of sums at a time stay in registers.
#[inline(always)]
fn sum_products_inline(
    rows: &[PixelRow],
    stride: usize,
    left: &[DesignRow],
    sums: &mut [DesignRow; UNKNOWNS + 1],
) {
    for (k, sums) in sums.chunks_exact_mut(4).enumerate() {
        let mut own = [[0.0; UNKNOWNS + 1]; 4];
        for (row, left) in rows.iter().step_by(stride).zip(left) {
            let left = [0, 1, 2, 3].map(|i| left[4 * k + i]);
            for (own, left) in own.iter_mut().zip(left) {
                own.iter_mut()
                    .zip(&row.design)
                    .for_each(|(sum, right)| *sum += left * right);
            }
        }
        sums.copy_from_slice(&own);
    }
}

wide! {
    /// Adds the weighted products of derivatives and residuals at every `stride`-th row.
    fn add_right_side(rows: &[PixelRow], stride: usize, residuals: &[f64], sums: &mut DesignRow) = add_right_side_inline
}

#[inline(always)]
fn add_right_side_inline(
    rows: &[PixelRow],
    stride: usize,
    residuals: &[f64],
    sums: &mut DesignRow,
) {
    for (row, residual) in rows.iter().step_by(stride).zip(residuals) {
        let weighted = row.weight * residual;
        sums.iter_mut()
            .zip(&row.design)
            .for_each(|(sum, own)| *sum += weighted * own);
    }
}
