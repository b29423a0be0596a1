//! Small symmetric matrices: products, inverses, and a factorisation that names the undetermined parameter.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::error::{EstimationError, EstimationResult};

/// Smallest accepted pivot of the normal matrix scaled to a unit diagonal.
const MIN_PIVOT: f64 = 1e-13;

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
        let regular = factor_in_place(&mut self.lower);
        if regular {
            invert_lower(&mut self.lower);
        }
        regular
            .then_some(())
            .ok_or_else(|| singular_error("a condition has no observation of its own"))
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
    for j in 0..n {
        let all = m[(j, j)];
        let (left, right) = m.as_mut_slice().split_at_mut(j * n);
        let column = &mut right[j..n];
        for done in left.chunks_exact(n) {
            add_scaled(column, -done[j], &done[j..]);
        }
        let pivot = column[0];
        if !(all > 0.0 && pivot > all * 1e-15) {
            return false;
        }
        let inverse = 1.0 / pivot.sqrt();
        column.iter_mut().for_each(|v| *v *= inverse);
    }
    true
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

/// Inverts a small symmetric positive definite matrix; 1 x 1 and 2 x 2 in closed form.
pub(super) fn inverse_spd(m: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    match m.nrows() {
        1 => (m[(0, 0)] > 0.0).then(|| DMatrix::from_element(1, 1, 1.0 / m[(0, 0)])),
        2 => {
            let (a, b, d) = (m[(0, 0)], m[(1, 0)], m[(1, 1)]);
            let det = a * d - b * b;
            (a > 0.0 && det > a * d * 1e-15)
                .then(|| DMatrix::from_row_slice(2, 2, &[d / det, -b / det, -b / det, a / det]))
        }
        _ => Cholesky::new(m.clone()).map(|c| c.inverse()),
    }
}

/// Cholesky factor of the normal matrix, scaled to a unit diagonal so that pivots are comparable.
pub(super) struct NormalFactor {
    scale: DVector<f64>,
    cholesky: Cholesky<f64, Dyn>,
}

impl NormalFactor {
    pub(super) fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        self.cholesky
            .solve(&right.component_mul(&self.scale))
            .component_mul(&self.scale)
    }

    /// Computes `(L^-1 S)' (L^-1 S)`. Inverting the factor costs a sixth of solving for all columns, and a library does the
    /// product.
    pub(super) fn inverse(&self) -> DMatrix<f64> {
        let lower = self.cholesky.l_dirty();
        let n = lower.nrows();
        let mut root = DMatrix::from_diagonal(&self.scale);
        for (j, column) in root.as_mut_slice().chunks_exact_mut(n.max(1)).enumerate() {
            for k in j..n {
                column[k] /= lower[(k, k)];
                let value = column[k];
                add_scaled(
                    &mut column[k + 1..],
                    -value,
                    &lower.as_slice()[k * n + k + 1..(k + 1) * n],
                );
            }
        }
        root.transpose() * &root
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
    if normal.as_slice().iter().any(|v| !v.is_finite()) {
        return Err(EstimationError::Input(
            "a number in the adjustment is not finite; check survey, camera and observations"
                .into(),
        ));
    }
    let scale = normal
        .diagonal()
        .map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
    let scaled = || {
        let mut scaled = normal.clone();
        for (mut column, by) in scaled.column_iter_mut().zip(scale.iter()) {
            column.component_mul_assign(&scale);
            column *= *by;
        }
        scaled
    };
    let undetermined = |column: usize| {
        let text = missing
            .get(column)
            .copied()
            .unwrap_or("a parameter has no observation");
        singular_error(text)
    };
    if let Some(column) = scale.iter().position(|&s| s == 0.0) {
        return Err(undetermined(column));
    }
    match Cholesky::new(scaled()) {
        Some(cholesky) => {
            let l = cholesky.l_dirty();
            match (0..n).find(|&i| l[(i, i)] * l[(i, i)] < MIN_PIVOT) {
                Some(column) => Err(undetermined(column)),
                None => Ok(NormalFactor { scale, cholesky }),
            }
        }
        None => Err(undetermined(failing_column(&scaled()))),
    }
}

/// Returns the index of the first leading minor that is not positive definite.
fn failing_column(scaled: &DMatrix<f64>) -> usize {
    let fails = |k: usize| Cholesky::new(scaled.view((0, 0), (k, k)).into_owned()).is_none();
    (1..=scaled.nrows()).find(|&k| fails(k)).unwrap_or(1) - 1
}
