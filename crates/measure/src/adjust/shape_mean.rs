//! Means of shapes with their covariance.

use nalgebra::{DMatrix, DVector};

use super::joint_shape::JointShape;

/// Mean of frames that were adjusted together, with the factors of its covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeMean {
    /// Values of the functions, as in [`super::FrameShape`].
    pub values: DVector<f64>,
    pub lasting: DMatrix<f64>,
    pub shared: DMatrix<f64>,
    pub own: DMatrix<f64>,
    /// Standard deviation of the frames about their mean; `None` for a single frame.
    pub scatter: Option<DVector<f64>>,
}

impl JointShape {
    /// Returns the mean of frames, at least one, given by their indices.
    pub fn mean(&self, frames: &[usize]) -> ShapeMean {
        let chosen: Vec<_> = frames.iter().filter_map(|k| self.frames.get(*k)).collect();
        let share = 1.0 / chosen.len().max(1) as f64;
        let functions = chosen.first().map_or(0, |frame| frame.values.len());
        let values = chosen
            .iter()
            .fold(DVector::zeros(functions), |sum, frame| sum + &frame.values)
            * share;
        let squares = chosen.iter().fold(DVector::zeros(functions), |sum, frame| {
            sum + (&frame.values - &values).map(|off| off * off)
        });
        let count = chosen.len();
        ShapeMean {
            lasting: add_factors(functions, chosen.iter().map(|frame| &frame.lasting)) * share,
            shared: add_factors(functions, chosen.iter().map(|frame| &frame.shared)) * share,
            own: join_columns(functions, chosen.iter().map(|frame| &frame.own * share)),
            scatter: (count > 1)
                .then(|| squares.map(|square| (square / (count - 1) as f64).sqrt())),
            values,
        }
    }
}

/// Adds factors of the same sources.
fn add_factors<'a>(rows: usize, factors: impl Iterator<Item = &'a DMatrix<f64>>) -> DMatrix<f64> {
    let sum = factors.cloned().reduce(|sum, factor| sum + factor);
    sum.unwrap_or_else(|| DMatrix::zeros(rows, 0))
}

/// Places factors side by side: their sources are independent.
fn join_columns(rows: usize, factors: impl Iterator<Item = DMatrix<f64>>) -> DMatrix<f64> {
    factors.fold(DMatrix::zeros(rows, 0), |joined, factor| {
        let at = joined.ncols();
        let mut wider = joined.insert_columns(at, factor.ncols(), 0.0);
        wider.columns_mut(at, factor.ncols()).copy_from(&factor);
        wider
    })
}

impl ShapeMean {
    /// Returns the standard deviations of the functions.
    pub fn sigmas(&self) -> DVector<f64> {
        let mut variances = DVector::zeros(self.values.len());
        for factor in [&self.lasting, &self.shared, &self.own] {
            let columns = factor.column_iter();
            columns.for_each(|column| variances += column.component_mul(&column));
        }
        variances.map(f64::sqrt)
    }
}
