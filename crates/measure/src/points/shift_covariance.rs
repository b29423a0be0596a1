//! Covariance of an adjusted shift.
//!
//! The information is that of the products of the gradients of **both** patches: noise, which adds to the squares of each,
//! has no part in them. A patch with an edge alone is so determined across it only. The covariance is that of the residuals
//! summed over blocks, which has the correlation of neighbouring pixels by interpolation, JPEG and errors of the model.

use nalgebra::{Matrix2, SymmetricEigen, Vector2};

use super::PointRejection;
use super::least_squares::{
    AdjustedShift, BLOCK_PX, DesignRow, GAIN, MIN_NOISE, Matching, Normal, PRIOR_SIGMAS, PixelRow,
    UNKNOWNS, Unknowns,
};
use super::patch::{GreyPatch, sobel_gradient};
use crate::identify::PATCH_REACH_PX;

/// Number of neighbouring pixels whose interpolated gradients have one independent value.
const CORRELATED_GRADIENTS: f64 = 3.0;
/// Number of standard deviations of the products of noise that are subtracted from a direction's information: noise alone
/// exceeds them in 1 of 40.
const NOISE_SIGMAS: f64 = 2.0;
/// Largest factor on a standard deviation in a direction without structure.
const MAX_RAISE: f64 = 100.0;
/// Smallest standard deviation of a shift, px: errors of the interpolation and of the map within the patch.
const MIN_SIGMA_PX: f64 = 0.02;
/// Largest standard deviation of a shift along its well-determined direction, px: the correlation finds nothing sharper.
const MAX_SIGMA_PX: f64 = 0.4;
/// Largest last step of an adjustment, in standard deviations.
const SETTLED_SIGMAS: f64 = 0.3;

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

impl Matching {
    /// Returns the products of the gradients of both patches, with the priors of all unknowns but the shift.
    fn information(&self, gradients: &[Vector2<f64>], factors: &Unknowns, noise: f64) -> Normal {
        let seen = |(row, gradient): (&PixelRow, &Vector2<f64>)| {
            let mut seen = row.design;
            seen.iter_mut()
                .zip(factors)
                .for_each(|(own, factor)| *own *= factor);
            [seen[0], seen[1]] = [-gradient.x, -gradient.y];
            [seen[2], seen[3]] = self.slopes.map(|by| -gradient.dot(&(by * row.at)));
            seen.map(|seen| seen * row.weight)
        };
        let seen: Vec<DesignRow> = self.rows.iter().zip(gradients).map(seen).collect();
        let products = self.sum_products(&seen, 1) * Normal::from_diagonal(factors);
        // The shift's own prior only keeps the adjustment from drifting: it is no observation.
        let mut prior = self.prior_information(noise);
        prior.fixed_rows_mut::<2>(0).fill(0.0);
        products + Normal::from_diagonal(&prior)
    }

    /// Returns the factors by which standard deviations of the shift are raised because noise may feign information: that of
    /// each direction less some standard deviations of the products of noise over itself. `None` if no direction has any.
    fn raise_weak_directions(
        &self,
        inverse: &Normal,
        gradients: &[Vector2<f64>],
        gain: f64,
    ) -> Option<Matrix2<f64>> {
        let products = inverse.fixed_view::<2, 2>(0, 0).try_inverse()?;
        let axes = SymmetricEigen::new((products + products.transpose()) * 0.5);
        let (mut of_template, mut of_frame) = (Vector2::zeros(), Vector2::zeros());
        for (row, gradient) in self.rows.iter().zip(gradients) {
            let seen = axes.eigenvectors.tr_mul(gradient);
            let own = axes
                .eigenvectors
                .tr_mul(&Vector2::new(row.design[0], row.design[1]))
                * gain;
            of_template += own.component_mul(&own) * row.weight;
            of_frame += seen.component_mul(&seen) * row.weight;
        }
        let sum = |power: i32| {
            self.rows
                .iter()
                .map(|row| row.weight.powi(power))
                .sum::<f64>()
        };
        let independent = sum(1).powi(2) / (CORRELATED_GRADIENTS * sum(2));
        let factors = axes.eigenvalues.zip_zip_map(
            &of_template,
            &of_frame,
            |information, template, frame| {
                let noise = (template - information).max(0.0) * (frame - information).max(0.0)
                    / independent;
                (information
                    / (information - NOISE_SIGMAS * noise.sqrt())
                        .max(information.abs() / MAX_RAISE))
                .max(1.0)
            },
        );
        let is_weak = axes.eigenvalues.map(|information| information <= 0.0);
        let factors = factors.zip_map(
            &is_weak,
            |factor, weak| if weak { MAX_RAISE } else { factor },
        );
        let raise =
            axes.eigenvectors * Matrix2::from_diagonal(&factors) * axes.eigenvectors.transpose();
        (!is_weak.iter().all(|weak| *weak)).then_some(raise)
    }

    /// Returns the share of the frame's contrast that the template explains, without uncorrelated noise.
    fn explained_share(&self, unknowns: &Unknowns, residuals: &[f64]) -> f64 {
        let weights: f64 = self.rows.iter().map(|row| row.window).sum();
        let mean = self
            .rows
            .iter()
            .map(|row| row.window * row.design[GAIN])
            .sum::<f64>()
            / weights;
        let contrast: f64 = self
            .rows
            .iter()
            .map(|row| row.window * (row.design[GAIN] - mean).powi(2))
            .sum();
        let weighted = |(row, r): (&PixelRow, &f64)| Vector2::new(row.window.sqrt() * r, 0.0);
        let weighted: Vec<Vector2<f64>> = self.rows.iter().zip(residuals).map(weighted).collect();
        // Blocks of uncorrelated residuals, smoothed by the interpolation, have about twice their variance.
        let white = 2.0 * weighted.iter().map(|r| r.x * r.x).sum::<f64>();
        let structured =
            (block_covariance(&weighted)[(0, 0)] - white).max(0.0) / (BLOCK_PX * BLOCK_PX) as f64;
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
    pub(super) fn misfit(&self) -> f64 {
        let rows = || self.matching.rows.iter();
        let squares: f64 = rows()
            .zip(&self.residuals)
            .map(|(row, r)| row.window * r * r)
            .sum();
        (squares / rows().map(|row| row.window).sum::<f64>()).max(MIN_NOISE * MIN_NOISE)
    }

    /// Returns the patch at the shift.
    pub(super) fn shifted_patch(&self, patch: &GreyPatch) -> GreyPatch {
        let reach = PATCH_REACH_PX + 1;
        GreyPatch::from_rows([reach; 2], |y, row| {
            let path = self.matching.row_path(f64::from(y), &self.unknowns);
            patch.sample_row(&path, -(reach as f64), 1.0, row);
        })
    }

    /// Returns the shift with its covariance; `shifted`: the frame's patch at the shift.
    ///
    /// # Errors
    /// Returns the reason if no direction is well determined, or the adjustment did not converge.
    pub(super) fn conclude(&self, shifted: &GreyPatch) -> Result<PatchShift, PointRejection> {
        let Self {
            matching,
            unknowns,
            residuals,
            noise,
            last,
        } = self;
        let reach = PATCH_REACH_PX as i32;
        let pixels = (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| (x, y)));
        let gradients: Vec<Vector2<f64>> = pixels
            .map(|(x, y)| sobel_gradient(&shifted.neighbours(x, y)))
            .collect();
        let factors = Matching::factors(unknowns);
        let information = matching.information(&gradients, &factors, *noise);
        let inverse = information
            .try_inverse()
            .ok_or(PointRejection::NoStructure)?;
        let influence = inverse.fixed_rows::<2>(0) * Normal::from_diagonal(&factors);
        let mut rounding = Matrix2::zeros();
        let effect = |(row, residual): (&PixelRow, &f64)| {
            let by_grey = influence * Unknowns::from_fn(|k, _| row.design[k]) * row.weight;
            rounding += by_grey * by_grey.transpose() * (MIN_NOISE * MIN_NOISE);
            by_grey * *residual
        };
        let effects: Vec<Vector2<f64>> = matching.rows.iter().zip(residuals).map(effect).collect();
        let prior = matching.prior_information(*noise);
        let by_prior = Unknowns::from_fn(|k, _| {
            if k < 2 {
                0.0
            } else {
                (prior[k] * PRIOR_SIGMAS[k]).powi(2)
            }
        });
        let of_shift = inverse.fixed_rows::<2>(0);
        let priors = of_shift * Normal::from_diagonal(&by_prior) * of_shift.transpose();
        // Each unknown takes the residuals of a block.
        let lost =
            1.0 / (1.0 - (UNKNOWNS * BLOCK_PX * BLOCK_PX) as f64 / matching.rows.len() as f64);
        let raised = matching
            .raise_weak_directions(&inverse, &gradients, factors[0])
            .ok_or(PointRejection::NoStructure)?;
        let covariance = raised * (block_covariance(&effects) * lost + rounding + priors) * raised
            + Matrix2::identity() * MIN_SIGMA_PX.powi(2);
        let axes = SymmetricEigen::new(covariance).eigenvalues;
        if !axes.iter().all(|v| v.is_finite()) || axes.min() > MAX_SIGMA_PX.powi(2) {
            return Err(PointRejection::NoStructure);
        }
        let weight = covariance
            .try_inverse()
            .ok_or(PointRejection::NoStructure)?;
        if last.dot(&(weight * last)) > SETTLED_SIGMAS * SETTLED_SIGMAS {
            return Err(PointRejection::NoConvergence);
        }
        let explained = matching.explained_share(unknowns, residuals);
        Ok(PatchShift {
            shift: self.shift(),
            covariance,
            explained,
        })
    }
}

/// Covariance of the sum of effects that are correlated over blocks of pixels: the mean over all positions of the blocks.
fn block_covariance(effects: &[Vector2<f64>]) -> Matrix2<f64> {
    let side = 2 * PATCH_REACH_PX + 1;
    let (block, count) = (BLOCK_PX, side + BLOCK_PX - 1);
    // Sums along the rows, then down the columns; blocks reach over the patch's edge.
    let window = |k: usize| k.saturating_sub(block - 1)..(k + 1).min(side);
    let along: Vec<Vec<Vector2<f64>>> = effects
        .chunks_exact(side)
        .map(|row| (0..count).map(|k| row[window(k)].iter().sum()).collect())
        .collect();
    let mut sum = Matrix2::zeros();
    for j in 0..count {
        for k in 0..count {
            let total: Vector2<f64> = along[window(j)].iter().map(|row| row[k]).sum();
            sum += total * total.transpose();
        }
    }
    sum / (block * block) as f64
}
