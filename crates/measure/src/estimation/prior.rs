//! Priors in the normal equations.

use nalgebra::{DMatrix, DVector};

use super::error::{EstimationError, EstimationResult};
use super::linear::inverse_spd;
use super::problem::Prior;

/// Returns the weights of the priors, in their order.
///
/// # Errors
/// Returns an error if a covariance is not positive definite.
pub(super) fn prior_weights(priors: &[Prior]) -> EstimationResult<Vec<DMatrix<f64>>> {
    let weight = |prior: &Prior| {
        inverse_spd(&prior.covariance).ok_or_else(|| {
            EstimationError::Input(format!(
                "the covariance of the prior of {} is not positive definite; check its standard deviations",
                prior.name.unknown
            ))
        })
    };
    priors.iter().map(weight).collect()
}

/// Adds a prior to normal equations and returns its contribution to the sum of squares.
pub(super) fn add_prior(
    prior: &Prior,
    weight: &DMatrix<f64>,
    values: &DVector<f64>,
    normal: &mut DMatrix<f64>,
    right: &mut DVector<f64>,
) -> f64 {
    let off = |k: usize| values[prior.columns[k]] - prior.mean[k];
    let mut omega = 0.0;
    for (i, &ci) in prior.columns.iter().enumerate() {
        let mut weighted = 0.0;
        for (j, &cj) in prior.columns.iter().enumerate() {
            normal[(ci, cj)] += weight[(i, j)];
            weighted += weight[(i, j)] * off(j);
        }
        right[ci] -= weighted;
        omega += off(i) * weighted;
    }
    omega
}
