//! Means of shapes with their covariance.

use nalgebra::{DMatrix, DVector};

use super::joint_shape::{FrameShape, JointShape};

impl JointShape {
    /// Returns the mean of frames, at least one, given by their indices.
    pub fn mean(&self, frames: &[usize]) -> FrameShape {
        let chosen = || frames.iter().filter_map(|k| self.frames.get(*k));
        let share = 1.0 / frames.len().max(1) as f64;
        let sum = |kind: usize| {
            let factors = chosen().map(|frame| frame.factors[kind].clone());
            factors.reduce(|sum, factor| sum + factor)
        };
        let values = chosen().map(|frame| frame.values.clone());
        let values = values.reduce(|sum, one| sum + one).unwrap_or_default() * share;
        let none = || DMatrix::zeros(values.len(), 0);
        let [lasting, shared] = [0, 1].map(|kind| sum(kind).map_or_else(none, |sum| sum * share));
        // The errors of the frames are independent of each other.
        let own: Vec<_> = chosen().flat_map(|f| f.factors[2].column_iter()).collect();
        let own = match own.is_empty() {
            true => none(),
            false => DMatrix::from_columns(&own) * share,
        };
        FrameShape {
            values,
            factors: [lasting, shared, own],
        }
    }

    /// Returns the standard deviation of frames about their mean; `None` for a single frame.
    pub fn scatter(&self, frames: &[usize], mean: &FrameShape) -> Option<DVector<f64>> {
        let chosen = frames.iter().filter_map(|k| self.frames.get(*k));
        let squares = chosen.map(|frame| (&frame.values - &mean.values).map(|off| off * off));
        let sum = squares.reduce(|sum, square| sum + square)?;
        let freedom = frames.len() - 1;
        (freedom > 0).then(|| sum.map(|square| (square / freedom as f64).sqrt()))
    }
}

impl FrameShape {
    /// Returns the standard deviations of the functions.
    pub fn sigmas(&self) -> DVector<f64> {
        let row_variance = |k: usize| {
            let parts = self
                .factors
                .iter()
                .map(|factor| factor.row(k).norm_squared());
            parts.sum::<f64>()
        };
        DVector::from_fn(self.values.len(), |k, _| row_variance(k).sqrt())
    }
}
