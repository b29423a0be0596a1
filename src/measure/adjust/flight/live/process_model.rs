//! What is known of unknowns, by mean and information matrix, as time goes by: it walks, fades, is forgotten.

use nalgebra::{DMatrix, DVector};

use crate::adjust::AdjustError;
use crate::estimation::InformationPrior;

/// Adds noise of a covariance to some unknowns (Woodbury's identity).
pub fn add_process_noise(
    known: &mut InformationPrior,
    columns: &[usize],
    noise: DMatrix<f64>,
) -> Result<(), AdjustError> {
    let of = known.information.select_columns(columns);
    let inner = inverse(noise)? + of.select_rows(columns);
    known.information -= &of * inverse(inner)? * of.transpose();
    Ok(())
}

/// Leaves a share of what is known beyond the base.
pub fn apply_forgetting(
    known: &mut InformationPrior,
    base: &InformationPrior,
    share: f64,
) -> Result<(), AdjustError> {
    let beyond = &known.information - &base.information;
    let fixed = &base.information * &base.mean;
    let right = &fixed + (&known.information * &known.mean - &fixed) * share;
    known.information = &base.information + beyond * share;
    let factor = known.information.clone().cholesky().ok_or_else(lost)?;
    known.mean = factor.solve(&right);
    Ok(())
}

/// Replaces what is known of the unknowns from `first` on.
pub fn reset_parameters(
    known: &mut InformationPrior,
    first: usize,
    mean: &DVector<f64>,
    covariance: DMatrix<f64>,
) -> Result<(), AdjustError> {
    let count = mean.len();
    let of = known.information.columns(first, count).into_owned();
    known.information -= &of * inverse(of.rows(first, count).into_owned())? * of.transpose();
    known.information.columns_mut(first, count).fill(0.0);
    known.information.rows_mut(first, count).fill(0.0);
    known.information.view_mut((first, first), (count, count)).copy_from(&inverse(covariance)?);
    known.mean.rows_mut(first, count).copy_from(mean);
    Ok(())
}

fn inverse(matrix: DMatrix<f64>) -> Result<DMatrix<f64>, AdjustError> {
    matrix.cholesky().map(|c| c.inverse()).ok_or_else(lost)
}

fn lost() -> AdjustError {
    AdjustError::Input("the state of the live adjustment has lost its numerical meaning".into())
}
