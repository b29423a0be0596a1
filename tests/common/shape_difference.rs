//! Differences of shapes with their covariance, and the test of a difference: as an analyst computes them from exported
//! factors.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use wingd::measure::adjust::FrameShape;
use wingd::measure::estimation::quality::chi_square_tail;

/// Smallest variance of a combination of functions that a test uses, in units of the variance of a single function.
const MIN_TESTED_VARIANCE: f64 = 1e-3;

/// Errors that two means have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommonErrors {
    None,
    Installation,
    Flight,
}

/// Difference of two shapes with a factor of its covariance (functions x sources).
pub struct ShapeDifference {
    pub values: DVector<f64>,
    pub factor: DMatrix<f64>,
}

fn join_columns(rows: usize, factors: Vec<DMatrix<f64>>) -> DMatrix<f64> {
    let columns: Vec<_> = factors.iter().flat_map(DMatrix::column_iter).collect();
    match columns.is_empty() {
        true => DMatrix::zeros(rows, 0),
        false => DMatrix::from_columns(&columns),
    }
}

/// Returns a mean minus values without errors.
pub fn difference_from(mean: &FrameShape, predicted: &DVector<f64>) -> ShapeDifference {
    let rows = predicted.len();
    let cut = mean
        .factors
        .each_ref()
        .map(|factor| factor.rows(0, rows).into_owned());
    ShapeDifference {
        values: mean.values.rows(0, rows) - predicted,
        factor: join_columns(rows, cut.into()),
    }
}

/// Returns a mean minus another of the same functions, whose frames are others.
pub fn minus(a: &FrameShape, b: &FrameShape, common: CommonErrors) -> ShapeDifference {
    let part = |kind: usize, is_common: bool| {
        let (a, b) = (&a.factors[kind], &b.factors[kind]);
        match is_common {
            true => vec![a - b],
            false => vec![a.clone(), b.clone()],
        }
    };
    let factors = [
        part(0, common != CommonErrors::None),
        part(1, common == CommonErrors::Flight),
        part(2, false),
    ];
    ShapeDifference {
        values: &a.values - &b.values,
        factor: join_columns(a.values.len(), factors.concat()),
    }
}

impl ShapeDifference {
    pub fn sigmas(&self) -> DVector<f64> {
        let rows = self.factor.row_iter();
        DVector::from_iterator(self.factor.nrows(), rows.map(|row| row.norm()))
    }

    /// Returns the probability of a chi-square at least as large if the difference of these functions is 0, by the
    /// combinations of them whose variance is not negligible.
    pub fn probability(&self, functions: &[usize]) -> f64 {
        let sigmas = self.sigmas();
        let is_known = |k: &usize| !self.values[*k].is_nan() && sigmas[*k] > 0.0;
        let known: Vec<usize> = functions.iter().copied().filter(is_known).collect();
        let scaled = DMatrix::from_fn(known.len(), self.factor.ncols(), |i, j| {
            self.factor[(known[i], j)] / sigmas[known[i]]
        });
        let ratios = known.iter().map(|k| self.values[*k] / sigmas[*k]);
        let difference = DVector::from_iterator(known.len(), ratios);
        let SymmetricEigen {
            eigenvectors,
            eigenvalues,
        } = SymmetricEigen::new(&scaled * scaled.transpose());
        let tested = (0..known.len()).filter(|k| eigenvalues[*k] > MIN_TESTED_VARIANCE);
        let (freedom, chi_square) = tested.fold((0.0, 0.0), |(freedom, sum), k| {
            let along = eigenvectors.column(k).dot(&difference);
            (freedom + 1.0, sum + along * along / eigenvalues[k])
        });
        chi_square_tail(freedom, chi_square)
    }
}
