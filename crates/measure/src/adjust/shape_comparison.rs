//! Means and differences of shapes with their covariance, and the test of a difference.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::joint_shape::JointShape;
use crate::estimation::quality::chi_square_tail;
use crate::observation::Estimate;

/// Smallest variance of a combination of functions that a test uses, in units of the variance of a single function. What the
/// family of shapes does not model is below 3 % of the standard deviation of a function.
const MIN_TESTED_VARIANCE: f64 = 1e-3;
/// Number of combinations that a test names.
const NAMED_COMBINATIONS: usize = 3;

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

/// Errors that two means have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommonErrors {
    /// None: another installation, or a computation.
    None,
    /// Those of the installation.
    Installation,
    /// Those of one flight.
    Flight,
}

/// Difference of two shapes.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeDifference {
    pub values: DVector<f64>,
    /// Factor of the covariance (functions x sources).
    pub factor: DMatrix<f64>,
}

/// Combination of functions in units of its standard deviation.
#[derive(Clone, Debug, PartialEq)]
pub struct TestedCombination {
    /// Difference over its standard deviation, not negative.
    pub sigmas: f64,
    /// Index of the function with the largest weight.
    pub function: usize,
}

/// Test whether a difference is 0.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeTest {
    pub chi_square: f64,
    /// Number of combinations of the functions that the covariance determines.
    pub freedom: usize,
    /// Probability of a chi-square at least as large if there is no difference.
    pub p: f64,
    /// Combinations that contribute most, the largest first.
    pub combinations: Vec<TestedCombination>,
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
    /// Returns the mean of the first functions alone.
    pub fn first_functions(&self, count: usize) -> Self {
        let cut = |factor: &DMatrix<f64>| factor.rows(0, count).into_owned();
        let first = |values: &DVector<f64>| values.rows(0, count).into_owned();
        Self {
            values: first(&self.values),
            lasting: cut(&self.lasting),
            shared: cut(&self.shared),
            own: cut(&self.own),
            scatter: self.scatter.as_ref().map(first),
        }
    }

    /// Returns the mean of means of several flights of one installation, at least one, which count equally.
    pub fn average(means: &[Self]) -> Self {
        let share = 1.0 / means.len().max(1) as f64;
        let rows = means.first().map_or(0, |mean| mean.values.len());
        let join = |part: fn(&Self) -> &DMatrix<f64>| {
            join_columns(rows, means.iter().map(|mean| part(mean) * share))
        };
        let squares = means
            .iter()
            .filter_map(|mean| mean.scatter.as_ref())
            .map(|scatter| scatter.map(|s| s * s));
        let scatters: Vec<DVector<f64>> = squares.collect();
        let pooled = scatters
            .iter()
            .fold(DVector::zeros(rows), |sum, square| sum + square);
        Self {
            values: means
                .iter()
                .fold(DVector::zeros(rows), |sum, mean| sum + &mean.values)
                * share,
            lasting: add_factors(rows, means.iter().map(|mean| &mean.lasting)) * share,
            shared: join(|mean| &mean.shared),
            own: join(|mean| &mean.own),
            scatter: (!scatters.is_empty())
                .then(|| pooled.map(|square| (square / scatters.len() as f64).sqrt())),
        }
    }

    /// Returns the standard deviations of the functions.
    pub fn sigmas(&self) -> DVector<f64> {
        self.difference_from(&DVector::zeros(self.values.len()))
            .sigmas()
    }

    /// Returns the mean as a difference from values without errors, such as those of a computation.
    pub fn difference_from(&self, predicted: &DVector<f64>) -> ShapeDifference {
        let factors = [self.lasting.clone(), self.shared.clone(), self.own.clone()];
        ShapeDifference {
            values: &self.values - predicted,
            factor: join_columns(self.values.len(), factors.into_iter()),
        }
    }

    /// Returns this mean minus another of the same functions, whose frames are others.
    pub fn minus(&self, other: &Self, common: CommonErrors) -> ShapeDifference {
        let part = |a: &DMatrix<f64>, b: &DMatrix<f64>, is_common: bool| match is_common {
            true => vec![a - b],
            false => vec![a.clone(), b.clone()],
        };
        let factors = [
            part(&self.lasting, &other.lasting, common != CommonErrors::None),
            part(&self.shared, &other.shared, common == CommonErrors::Flight),
            part(&self.own, &other.own, false),
        ];
        ShapeDifference {
            values: &self.values - &other.values,
            factor: join_columns(self.values.len(), factors.concat().into_iter()),
        }
    }
}

impl ShapeDifference {
    /// Returns the standard deviations of the functions.
    pub fn sigmas(&self) -> DVector<f64> {
        DVector::from_iterator(
            self.factor.nrows(),
            self.factor.row_iter().map(|row| row.norm()),
        )
    }

    /// Returns the difference without an effect: the first shape minus `amount` times `effect`, whose values have the
    /// independent standard deviations `sigmas`.
    pub fn without_effect(
        &self,
        effect: &DVector<f64>,
        sigmas: &DVector<f64>,
        amount: Estimate,
    ) -> Self {
        let known = effect.map(|value| if value.is_nan() { 0.0 } else { value });
        let own = DMatrix::from_diagonal(&(sigmas * amount.value));
        let uncertain: Vec<usize> = (0..own.ncols()).filter(|k| own[(*k, *k)] != 0.0).collect();
        let of_amount = DMatrix::from_columns(&[known * amount.sigma.unwrap_or(0.0)]);
        let factors = [
            self.factor.clone(),
            of_amount,
            own.select_columns(&uncertain),
        ];
        Self {
            values: &self.values - effect * amount.value,
            factor: join_columns(self.values.len(), factors.into_iter()),
        }
    }

    /// Tests whether the difference of these functions is 0, by the combinations of them whose variance is not negligible.
    /// Functions without a value are omitted.
    pub fn test(&self, functions: &[usize]) -> ShapeTest {
        let sigmas = self.sigmas();
        let is_known = |k: &&usize| !self.values[**k].is_nan() && sigmas[**k] > 0.0;
        let known: Vec<usize> = functions.iter().filter(is_known).copied().collect();
        if known.is_empty() {
            return ShapeTest {
                chi_square: 0.0,
                freedom: 0,
                p: 1.0,
                combinations: vec![],
            };
        }
        let sigma = DVector::from_iterator(known.len(), known.iter().map(|k| sigmas[*k]));
        let scaled = DMatrix::from_fn(known.len(), self.factor.ncols(), |i, j| {
            self.factor[(known[i], j)] / sigma[i]
        });
        let difference = DVector::from_iterator(
            known.len(),
            known.iter().map(|k| self.values[*k] / sigmas[*k]),
        );
        let SymmetricEigen {
            eigenvectors,
            eigenvalues,
        } = SymmetricEigen::new(&scaled * scaled.transpose());
        let tested = (0..known.len()).filter(|k| eigenvalues[*k] > MIN_TESTED_VARIANCE);
        let mut combinations: Vec<_> = tested
            .map(|k| {
                let direction = eigenvectors.column(k);
                let sigmas = direction.dot(&difference).abs() / eigenvalues[k].sqrt();
                TestedCombination {
                    sigmas,
                    function: known[direction.iamax()],
                }
            })
            .collect();
        let (freedom, chi_square) = (
            combinations.len(),
            combinations.iter().map(|c| c.sigmas * c.sigmas).sum(),
        );
        combinations.sort_by(|a, b| b.sigmas.total_cmp(&a.sigmas));
        combinations.truncate(NAMED_COMBINATIONS);
        ShapeTest {
            chi_square,
            freedom,
            p: chi_square_tail(freedom as f64, chi_square),
            combinations,
        }
    }
}
