//! A least-squares problem: observations, conditions between them and parameters, and what is known beforehand.

use nalgebra::{DMatrix, DVector};

/// Correlated observations that enter conditions together.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// As observed.
    pub observed: DVector<f64>,
    /// Their covariance, a priori.
    pub covariance: DMatrix<f64>,
}

/// Blocks that share local parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Start of the local parameters; may be empty.
    pub local: DVector<f64>,
    /// Priors on them; columns count from the group's first local parameter.
    pub priors: Vec<Prior>,
    /// The observations.
    pub blocks: Vec<Block>,
}

/// Knowledge about parameters from elsewhere: a pseudo-observation.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    /// What it is, for a person.
    pub name: &'static str,
    /// Which parameters.
    pub columns: Vec<usize>,
    /// Their expected values.
    pub mean: DVector<f64>,
    /// Covariance of the expectation.
    pub covariance: DMatrix<f64>,
}

impl Prior {
    /// A prior on one parameter.
    pub fn scalar(name: &'static str, column: usize, mean: f64, sigma: f64) -> Self {
        let covariance = DMatrix::from_element(1, 1, sigma * sigma);
        Self { mean: DVector::from_element(1, mean), ..Self::centred(name, column, covariance) }
    }

    /// A prior on the parameters from `first` on, which are expected to be 0.
    pub fn centred(name: &'static str, first: usize, covariance: DMatrix<f64>) -> Self {
        let count = covariance.nrows();
        Self { name, columns: (first..first + count).collect(), mean: DVector::zeros(count), covariance }
    }

    /// The same on parameters so many columns farther.
    pub fn shift_columns(mut self, by: usize) -> Self {
        self.columns.iter_mut().for_each(|column| *column += by);
        self
    }
}

/// Knowledge about all global parameters together, as an earlier solution left it.
#[derive(Clone, Debug, PartialEq)]
pub struct InformationPrior {
    /// Their expected values.
    pub mean: DVector<f64>,
    /// Inverse of the expectation's covariance; singular where it tells of some of them, or of sums, alone.
    pub information: DMatrix<f64>,
    /// As how many conditions it counts: the rank of that.
    pub conditions: usize,
}

/// One least-squares problem.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// Start of the global parameters.
    pub start: DVector<f64>,
    /// Per global parameter: what is missing where it cannot be determined (ends the sentence
    /// "the adjustment has no unique solution: …").
    pub missing: Vec<&'static str>,
    /// Priors on global parameters.
    pub priors: Vec<Prior>,
    /// What else is known of all of them.
    pub known: Option<InformationPrior>,
    /// The groups.
    pub groups: Vec<Group>,
}

/// Where a block is linearised.
#[derive(Clone, Copy, Debug)]
pub struct Point<'a> {
    /// Index of the group.
    pub group: usize,
    /// Index of the block in its group.
    pub block: usize,
    /// Global parameters.
    pub global: &'a DVector<f64>,
    /// The group's local parameters.
    pub local: &'a DVector<f64>,
    /// Adjusted observations of the block.
    pub observed: &'a DVector<f64>,
}

/// Where a whole group is linearised.
#[derive(Clone, Copy, Debug)]
pub struct GroupPoint<'a> {
    /// Index of the group.
    pub group: usize,
    /// Global parameters.
    pub global: &'a DVector<f64>,
    /// The group's local parameters.
    pub local: &'a DVector<f64>,
    /// Adjusted observations, per block.
    pub observed: &'a [DVector<f64>],
}

/// A block's conditions at a point, with their derivatives.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearised {
    /// Value of the conditions, 0 when they hold.
    pub misclosure: DVector<f64>,
    /// Global parameters that the block depends on, each once.
    pub columns: Vec<usize>,
    /// d condition / d those parameters (conditions x columns).
    pub global: DMatrix<f64>,
    /// d condition / d local parameters (conditions x local).
    pub local: DMatrix<f64>,
    /// d condition / d observations (conditions x observations).
    pub observations: DMatrix<f64>,
}

impl Linearised {
    /// Conditions that depend on nothing yet.
    pub fn empty(conditions: usize, columns: Vec<usize>, local: usize, observations: usize) -> Self {
        Self {
            misclosure: DVector::zeros(conditions),
            global: DMatrix::zeros(conditions, columns.len()),
            local: DMatrix::zeros(conditions, local),
            observations: DMatrix::zeros(conditions, observations),
            columns,
        }
    }
}
