//! Small symmetric matrices: products, inverses, and a factor that names what is missing.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::measure::adjust::AdjustError;

/// Smallest pivot of the normal matrix scaled to a unit diagonal.
const SMALLEST_PIVOT: f64 = 1e-13;

/// `target[rows, columns] += a' b` for few and short rows of a and b (`None`: all of them).
pub(super) fn add_product(
    target: &mut DMatrix<f64>,
    rows: Option<&[usize]>,
    columns: Option<&[usize]>,
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
) {
    match a.nrows() {
        // Images: the bulk of the work.
        2 => add_product_of::<2>(target, rows, columns, a.as_slice(), b.as_slice()),
        4 => add_product_of::<4>(target, rows, columns, a.as_slice(), b.as_slice()),
        n => {
            for k in 0..n {
                let (a, b) = (a.row(k).transpose(), b.row(k).transpose());
                add_product_of::<1>(target, rows, columns, a.as_slice(), b.as_slice());
            }
        }
    }
}

fn add_product_of<const N: usize>(
    target: &mut DMatrix<f64>,
    rows: Option<&[usize]>,
    columns: Option<&[usize]>,
    a: &[f64],
    b: &[f64],
) {
    let (left, right) = (a.as_chunks::<N>().0, b.as_chunks::<N>().0);
    let dot = |x: &[f64; N], y: &[f64; N]| (0..N).map(|k| x[k] * y[k]).sum::<f64>();
    for (j, y) in right.iter().enumerate() {
        let mut column = target.column_mut(columns.map_or(j, |c| c[j]));
        match rows {
            None => column.iter_mut().zip(left).for_each(|(t, x)| *t += dot(x, y)),
            Some(rows) => rows.iter().zip(left).for_each(|(&i, x)| column[i] += dot(x, y)),
        }
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
