//! Small symmetric matrices: products, inverses, and a factorisation that names the undetermined parameter.

use nalgebra::{DMatrix, DVector};

use super::error::{EstimationError, EstimationResult};
use crate::dispatch::wide;

/// Smallest accepted pivot of the normal matrix scaled to a unit diagonal.
const MIN_PIVOT: f64 = 1e-13;
/// Number of columns that are squared together: a hundred unknowns of as many fit the first cache beside their square.
const SQUARED_COLUMNS: usize = 32;

/// Matrix `W` with `W' W = (B Q B')^-1`, lower triangular, kept with its `B`: the derivatives of most conditions with
/// respect to their observations are equal at every point.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Whitener {
    lower: DMatrix<f64>,
    by: DMatrix<f64>,
}

impl Whitener {
    /// Computes `W` for derivatives and covariance of the observations, unless the derivatives are unchanged.
    pub(super) fn update(
        &mut self,
        by: &DMatrix<f64>,
        covariance: &DMatrix<f64>,
    ) -> EstimationResult<()> {
        if self.by.shape() == by.shape() && self.by.as_slice() == by.as_slice() {
            return Ok(());
        }
        self.by.clone_from(by);
        congruence_product(by, covariance, &mut self.lower);
        if !factor_in_place(&mut self.lower) {
            return Err(singular_error("a condition has no observation of its own"));
        }
        invert_lower(&mut self.lower);
        Ok(())
    }

    /// Returns entry `i` of `W` times a vector.
    pub(super) fn row_times(&self, i: usize, values: &[f64]) -> f64 {
        let row = self.lower.as_slice()[i..]
            .iter()
            .step_by(self.lower.nrows().max(1));
        row.zip(&values[..=i]).map(|(w, v)| w * v).sum()
    }

    /// Returns the rows of `W` if it is `N` x `N`.
    pub(super) fn row_arrays<const N: usize>(&self) -> Option<[[f64; N]; N]> {
        let square = self.lower.nrows() == N;
        square.then(|| std::array::from_fn(|i| std::array::from_fn(|j| self.lower[(i, j)])))
    }

    /// Returns the squared length of `W` times a vector.
    pub(super) fn weighted_square(&self, values: &[f64]) -> f64 {
        (0..values.len())
            .map(|i| self.row_times(i, values).powi(2))
            .sum()
    }

    /// Multiplies a vector by `W' W` in place.
    pub(super) fn apply_weight(&self, values: &mut [f64]) {
        let n = values.len();
        for i in (0..n).rev() {
            values[i] = self.row_times(i, values);
        }
        for j in 0..n {
            values[j] = dot_product(&self.lower.as_slice()[j * n + j..(j + 1) * n], &values[j..]);
        }
    }
}

/// Computes `B Q B'`, for matrices too small for a library's product.
fn congruence_product(b: &DMatrix<f64>, q: &DMatrix<f64>, out: &mut DMatrix<f64>) {
    let (n, m) = b.shape();
    out.resize_mut(n, n, 0.0);
    out.as_mut_slice().fill(0.0);
    for l in 0..m {
        for k in (0..m).filter(|&k| q[(k, l)] != 0.0) {
            for j in (0..n).filter(|&j| b[(j, l)] != 0.0) {
                let factor = q[(k, l)] * b[(j, l)];
                for i in 0..n {
                    out[(i, j)] += b[(i, k)] * factor;
                }
            }
        }
    }
}

/// Replaces the lower triangle by its Cholesky factor. Returns `false` if a pivot is lost in rounding.
pub(super) fn factor_in_place(m: &mut DMatrix<f64>) -> bool {
    let n = m.nrows();
    factor_columns(m.as_mut_slice(), n, 1e-15).is_none()
}

wide! {
    /// Replaces the lower triangle of `n` columns by its Cholesky factor. Returns the first column, if any, whose pivot is below
    /// a fraction of its diagonal.
    fn factor_columns(m: &mut [f64], n: usize, least: f64) -> Option<usize> = factor_columns_generic
}

#[inline(always)]
fn factor_columns_generic(m: &mut [f64], n: usize, least: f64) -> Option<usize> {
    for j in 0..n {
        let (left, right) = m.split_at_mut(j * n);
        let column = &mut right[j..n];
        let all = column[0];
        add_columns(column, left, n, |k| -left[k * n + j]);
        let pivot = column[0];
        if !(all > 0.0 && pivot > all * least) {
            return Some(j);
        }
        let inverse = 1.0 / pivot.sqrt();
        column.iter_mut().for_each(|v| *v *= inverse);
    }
    None
}

wide! {
    /// Adds to each column of `into` the `columns` times the factors in a column of `factors`.
    pub(super) fn add_products(into: &mut [f64], columns: &[f64], height: usize, factors: &[f64]) = add_products_generic
}

#[inline(always)]
fn add_products_generic(into: &mut [f64], columns: &[f64], height: usize, factors: &[f64]) {
    let count = columns.len() / height.max(1);
    let factors = factors.chunks_exact(count.max(1));
    for (into, factors) in into.chunks_exact_mut(height.max(1)).zip(factors) {
        add_columns(into, columns, height, |k| factors[k]);
    }
}

wide! {
    /// Adds to the lower triangle of `into` a factor times columns of `height` times their transposes.
    pub(super) fn add_square(into: &mut [f64], factor: f64, columns: &[f64], height: usize) = add_square_generic
}

#[inline(always)]
fn add_square_generic(into: &mut [f64], factor: f64, columns: &[f64], height: usize) {
    for columns in columns.chunks(SQUARED_COLUMNS * height.max(1)) {
        for (j, into) in into.chunks_exact_mut(height).enumerate() {
            let own = |k: usize| factor * columns[k * height + j];
            add_columns(&mut into[j..], columns, height, own);
        }
    }
}

/// Adds the last rows of columns of `height`, each times its factor, four columns at a time.
#[inline(always)]
fn add_columns(into: &mut [f64], columns: &[f64], height: usize, factor: impl Fn(usize) -> f64) {
    let from = height - into.len();
    let mut fours = columns.chunks_exact(4 * height);
    let mut k = 0;
    for four in &mut fours {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| &four[i * height + from..(i + 1) * height]);
        let by = [0, 1, 2, 3].map(|i| factor(k + i));
        let rows = a.iter().zip(b).zip(c.iter().zip(d));
        for (target, ((a, b), (c, d))) in into.iter_mut().zip(rows) {
            *target = *target + by[0] * a + by[1] * b + by[2] * c + by[3] * d;
        }
        k += 4;
    }
    for (i, column) in fours.remainder().chunks_exact(height).enumerate() {
        add_scaled(into, factor(k + i), &column[from..]);
    }
}

/// Inverts a lower triangular matrix in place and clears the part above the diagonal.
pub(super) fn invert_lower(m: &mut DMatrix<f64>) {
    let n = m.nrows();
    for j in 0..n {
        for i in 0..j {
            m[(i, j)] = 0.0;
        }
        m[(j, j)] = 1.0 / m[(j, j)];
        for i in j + 1..n {
            // Row i still holds the factor, rows above it the inverse.
            let sum: f64 = (j..i).map(|k| m[(i, k)] * m[(k, j)]).sum();
            m[(i, j)] = -sum / m[(i, i)];
        }
    }
}

/// Adds `factor * column` to `into`.
#[inline(always)]
pub(super) fn add_scaled(into: &mut [f64], factor: f64, column: &[f64]) {
    for (target, value) in into.iter_mut().zip(column) {
        *target += factor * value;
    }
}

/// Returns the scalar product.
pub(super) fn dot_product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub(super) fn singular_error(missing: &str) -> EstimationError {
    EstimationError::Singular {
        missing: missing.into(),
    }
}

/// Returns `W` with `W' W` the inverse of a small symmetric positive definite matrix.
pub(super) fn whitening_matrix(m: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let mut lower = m.clone();
    factor_in_place(&mut lower).then(|| {
        invert_lower(&mut lower);
        lower
    })
}

/// Inverts a small symmetric positive definite matrix.
pub(super) fn inverse_spd(m: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    whitening_matrix(m).map(|white| white.tr_mul(&white))
}

/// Cholesky factor of the normal matrix, scaled to a unit diagonal so that pivots are comparable.
pub(super) struct NormalFactor {
    scale: DVector<f64>,
    lower: DMatrix<f64>,
}

impl NormalFactor {
    pub(super) fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        let mut solution = right.component_mul(&self.scale);
        self.lower.solve_lower_triangular_mut(&mut solution);
        self.lower.tr_solve_lower_triangular_mut(&mut solution);
        solution.component_mul(&self.scale)
    }

    /// Computes `(L^-1 S)' (L^-1 S)`. Inverting the factor costs a sixth of solving for all columns, and a library does the
    /// product.
    pub(super) fn inverse(&self) -> DMatrix<f64> {
        let mut root = DMatrix::from_diagonal(&self.scale);
        solve_columns(self.lower.as_slice(), self.scale.len(), root.as_mut_slice());
        root.transpose() * &root
    }
}

wide! {
    /// Solves `L X = R` in place for the columns of a lower triangular matrix `R`.
    fn solve_columns(lower: &[f64], n: usize, right: &mut [f64]) = solve_columns_generic
}

#[inline(always)]
fn solve_columns_generic(lower: &[f64], n: usize, right: &mut [f64]) {
    for (j, column) in right.chunks_exact_mut(n.max(1)).enumerate() {
        for k in j..n {
            let (done, rest) = column.split_at_mut(k + 1);
            done[k] /= lower[k * n + k];
            add_scaled(rest, -done[k], &lower[k * n + k + 1..(k + 1) * n]);
        }
    }
}

/// Factors the normal matrix.
///
/// # Errors
/// Returns an error if a number is not finite, or one that names the missing information if the matrix is singular.
pub(super) fn factor_normal_matrix(
    normal: &DMatrix<f64>,
    missing: &[&'static str],
) -> EstimationResult<NormalFactor> {
    let n = normal.nrows();
    let scale = normal
        .diagonal()
        .map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
    let mut lower = normal.clone();
    for (mut column, by) in lower.column_iter_mut().zip(scale.iter()) {
        column.component_mul_assign(&scale);
        column *= *by;
    }
    match factor_columns(lower.as_mut_slice(), n, MIN_PIVOT) {
        None => Ok(NormalFactor { scale, lower }),
        Some(_) if normal.iter().any(|v| !v.is_finite()) => Err(EstimationError::Input(
            "a number in the adjustment is not finite; check survey, camera and observations"
                .into(),
        )),
        Some(column) => Err(singular_error(
            missing
                .get(column)
                .copied()
                .unwrap_or("a parameter has no observation"),
        )),
    }
}
