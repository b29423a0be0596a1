//! Small symmetric matrices: products, inverses, and a factor that names what is missing.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::measure::adjust::AdjustError;

/// Smallest pivot of the normal matrix scaled to a unit diagonal.
const SMALLEST_PIVOT: f64 = 1e-13;

/// `B Q B'`, for matrices too small for a library's product.
pub(super) fn sandwich(b: &DMatrix<f64>, q: &DMatrix<f64>) -> DMatrix<f64> {
    let (n, m) = b.shape();
    let mut out = DMatrix::zeros(n, n);
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
    out
}

/// `W` with `W' W = M^-1`, lower triangular.
pub(super) fn whitener(m: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = m.nrows();
    if n == 2 {
        let first = m[(0, 0)].sqrt();
        let mixed = m[(1, 0)] / first;
        let rest = m[(1, 1)] - mixed * mixed;
        let regular = m[(0, 0)] > 0.0 && rest > m[(1, 1)] * 1e-15;
        let second = rest.sqrt();
        return regular.then(|| {
            DMatrix::from_column_slice(2, 2, &[1.0 / first, -mixed / (first * second), 0.0, 1.0 / second])
        });
    }
    let factor = Cholesky::new(m.clone())?;
    factor.l_dirty().solve_lower_triangular(&DMatrix::identity(n, n))
}

/// `into = lower * column`; images come in pairs.
pub(super) fn lower_times(lower: &DMatrix<f64>, column: &[f64], into: &mut [f64]) {
    if let ([a, b], [x, y], &[first, mixed, _, second]) = (column, &mut *into, lower.as_slice()) {
        (*x, *y) = (first * a, mixed * a + second * b);
        return;
    }
    for (i, target) in into.iter_mut().enumerate() {
        *target = (0..=i).map(|j| lower[(i, j)] * column[j]).sum();
    }
}

pub(super) fn singular(missing: &str) -> AdjustError {
    AdjustError::Singular { missing: missing.into() }
}

/// Inverse of a small symmetric positive definite matrix; 1 x 1 and 2 x 2 in closed form.
pub(super) fn inverse(m: &DMatrix<f64>) -> Option<DMatrix<f64>> {
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

/// Cholesky factor of the normal matrix, scaled to a unit diagonal so that pivots can be judged.
pub(super) struct Factor {
    scale: DVector<f64>,
    cholesky: Cholesky<f64, Dyn>,
}

impl Factor {
    pub(super) fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        self.cholesky.solve(&right.component_mul(&self.scale)).component_mul(&self.scale)
    }

    pub(super) fn inverse(&self) -> DMatrix<f64> {
        let mut inverse = self.cholesky.inverse();
        for j in 0..inverse.ncols() {
            for i in 0..inverse.nrows() {
                inverse[(i, j)] *= self.scale[i] * self.scale[j];
            }
        }
        inverse
    }
}

/// Factors the normal matrix, or names the datum that is missing.
pub(super) fn factor(normal: &DMatrix<f64>, missing: &[&'static str]) -> Result<Factor, AdjustError> {
    let n = normal.nrows();
    if normal.iter().any(|v| !v.is_finite()) {
        return Err(AdjustError::Input(
            "a number in the adjustment is not finite; check survey, camera and observations".into(),
        ));
    }
    let scale = normal.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
    let scaled = DMatrix::from_fn(n, n, |i, j| normal[(i, j)] * scale[i] * scale[j]);
    let culprit = |column: usize| {
        let text = missing.get(column).copied().unwrap_or("a parameter has no observation");
        singular(text)
    };
    if let Some(column) = scale.iter().position(|&s| s == 0.0) {
        return Err(culprit(column));
    }
    match Cholesky::new(scaled.clone()) {
        Some(cholesky) => {
            let l = cholesky.l_dirty();
            match (0..n).find(|&i| l[(i, i)] * l[(i, i)] < SMALLEST_PIVOT) {
                Some(column) => Err(culprit(column)),
                None => Ok(Factor { scale, cholesky }),
            }
        }
        None => Err(culprit(failing_column(&scaled))),
    }
}

/// First leading minor that is not positive definite.
fn failing_column(scaled: &DMatrix<f64>) -> usize {
    let fails = |k: usize| Cholesky::new(scaled.view((0, 0), (k, k)).into_owned()).is_none();
    (1..=scaled.nrows()).find(|&k| fails(k)).unwrap_or(1) - 1
}
