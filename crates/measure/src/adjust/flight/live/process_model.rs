//! Process model of the live state, given as mean and information matrix: process noise, forgetting and reset of
//! parameters.

use nalgebra::{DMatrix, DVector};

use crate::adjust::{AdjustError, AdjustResult};
use crate::estimation::InformationPrior;

/// Adds process noise with this covariance to some unknowns (Woodbury's identity).
///
/// # Errors
/// Returns an error if a matrix is not positive definite.
pub fn add_process_noise(
    known: &mut InformationPrior,
    columns: &[usize],
    noise: DMatrix<f64>,
) -> AdjustResult<()> {
    let coupling = known.information.select_columns(columns);
    let inner = invert_matrix(noise)? + coupling.select_rows(columns);
    known.information -= &coupling * invert_matrix(inner)? * coupling.transpose();
    Ok(())
}

/// Keeps only the fraction `share` of the information beyond `base`.
///
/// # Errors
/// Returns an error if the information matrix is not positive definite.
pub fn apply_forgetting(
    known: &mut InformationPrior,
    base: &InformationPrior,
    share: f64,
) -> AdjustResult<()> {
    let beyond = &known.information - &base.information;
    let fixed = &base.information * &base.mean;
    let right = &fixed + (&known.information * &known.mean - &fixed) * share;
    known.information = &base.information + beyond * share;
    let factor = known
        .information
        .clone()
        .cholesky()
        .ok_or_else(singular_state_error)?;
    known.mean = factor.solve(&right);
    Ok(())
}

/// Replaces the information about the unknowns from column `first` on.
///
/// # Errors
/// Returns an error if a matrix is not positive definite.
pub fn reset_parameters(
    known: &mut InformationPrior,
    first: usize,
    mean: &DVector<f64>,
    covariance: DMatrix<f64>,
) -> AdjustResult<()> {
    let count = mean.len();
    let coupling = known.information.columns(first, count).into_owned();
    known.information -=
        &coupling * invert_matrix(coupling.rows(first, count).into_owned())? * coupling.transpose();
    known.information.columns_mut(first, count).fill(0.0);
    known.information.rows_mut(first, count).fill(0.0);
    known
        .information
        .view_mut((first, first), (count, count))
        .copy_from(&invert_matrix(covariance)?);
    known.mean.rows_mut(first, count).copy_from(mean);
    Ok(())
}

fn invert_matrix(matrix: DMatrix<f64>) -> AdjustResult<DMatrix<f64>> {
    matrix
        .cholesky()
        .map(|c| c.inverse())
        .ok_or_else(singular_state_error)
}

fn singular_state_error() -> AdjustError {
    AdjustError::Input(
        "the information matrix of the live adjustment is not positive definite".into(),
    )
}
