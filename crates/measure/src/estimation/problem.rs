//! A least-squares problem: observations, conditions between observations and parameters, and priors.

use nalgebra::{DMatrix, DVector};

/// Correlated observations that enter conditions together.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Observed values.
    pub observed: DVector<f64>,
    /// Covariance of the observations, a priori.
    pub covariance: DMatrix<f64>,
}

/// Blocks that share local parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Start values of the local parameters; may be empty.
    pub local: DVector<f64>,
    /// Priors on the local parameters; columns count from the group's first local parameter.
    pub priors: Vec<Prior>,
    pub blocks: Vec<Block>,
}

/// Names of a prior.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PriorName {
    /// Name of its unknown, for messages.
    pub unknown: &'static str,
    /// Name of its source in uncertainty budgets.
    pub source: &'static str,
}

impl From<&'static str> for PriorName {
    fn from(name: &'static str) -> Self {
        Self {
            unknown: name,
            source: name,
        }
    }
}

/// A prior on parameters: a pseudo-observation.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    pub name: PriorName,
    /// Columns of the parameters.
    pub columns: Vec<usize>,
    /// Expected values.
    pub mean: DVector<f64>,
    /// Covariance of the expected values.
    pub covariance: DMatrix<f64>,
}

impl Prior {
    /// Creates a prior on one parameter.
    pub fn scalar(name: impl Into<PriorName>, column: usize, mean: f64, sigma: f64) -> Self {
        let covariance = DMatrix::from_element(1, 1, sigma * sigma);
        Self {
            mean: DVector::from_element(1, mean),
            ..Self::centred(name, column, covariance)
        }
    }

    /// Creates a prior with expected value 0 on consecutive parameters from `first` on.
    pub fn centred(name: impl Into<PriorName>, first: usize, covariance: DMatrix<f64>) -> Self {
        let count = covariance.nrows();
        Self {
            name: name.into(),
            columns: (first..first + count).collect(),
            mean: DVector::zeros(count),
            covariance,
        }
    }

    /// Returns the prior with its columns shifted by `offset`.
    pub fn shift_columns(mut self, offset: usize) -> Self {
        self.columns.iter_mut().for_each(|column| *column += offset);
        self
    }
}

/// A prior on all global parameters together, from an earlier solution.
#[derive(Clone, Debug, PartialEq)]
pub struct InformationPrior {
    /// Expected values.
    pub mean: DVector<f64>,
    /// Inverse of the covariance; singular if it concerns only some of the parameters, or only sums of them.
    pub information: DMatrix<f64>,
    /// Number of conditions it counts as: the rank of `information`.
    pub conditions: usize,
}

/// A least-squares problem.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// Start values of the global parameters.
    pub start: DVector<f64>,
    /// Reasons, one per global parameter, for it being undetermined (ends the sentence "the adjustment has no unique
    /// solution: …").
    pub missing: Vec<&'static str>,
    /// Priors on global parameters.
    pub priors: Vec<Prior>,
    /// Additional prior on all global parameters together.
    pub known: Option<InformationPrior>,
    pub groups: Vec<Group>,
}

/// Point at which a block is linearised.
#[derive(Clone, Copy, Debug)]
pub struct BlockPoint<'a> {
    /// Index of the group.
    pub group: usize,
    /// Index of the block in its group.
    pub block: usize,
    pub global: &'a DVector<f64>,
    /// Local parameters of the group.
    pub local: &'a DVector<f64>,
    /// Adjusted observations of the block.
    pub observed: &'a DVector<f64>,
}

/// Point at which a group is linearised.
#[derive(Clone, Copy, Debug)]
pub struct GroupPoint<'a> {
    /// Index of the group.
    pub group: usize,
    pub global: &'a DVector<f64>,
    /// Local parameters of the group.
    pub local: &'a DVector<f64>,
    /// Adjusted observations, per block.
    pub observed: &'a [DVector<f64>],
}

/// Conditions of a block at a point, with their derivatives.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearised {
    /// Value of the conditions; 0 if they hold.
    pub misclosure: DVector<f64>,
    /// Global parameters on which the block depends, each once.
    pub columns: Vec<usize>,
    /// Derivatives with respect to these global parameters (conditions x columns).
    pub global: DMatrix<f64>,
    /// Derivatives with respect to the local parameters (conditions x local).
    pub local: DMatrix<f64>,
    /// Derivatives with respect to the observations (conditions x observations).
    pub observations: DMatrix<f64>,
}

impl Linearised {
    /// Creates conditions with value and derivatives 0.
    pub fn empty(
        conditions: usize,
        columns: Vec<usize>,
        local: usize,
        observations: usize,
    ) -> Self {
        Self {
            misclosure: DVector::zeros(conditions),
            global: DMatrix::zeros(conditions, columns.len()),
            local: DMatrix::zeros(conditions, local),
            observations: DMatrix::zeros(conditions, observations),
            columns,
        }
    }
}
