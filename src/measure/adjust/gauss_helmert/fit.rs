//! The solution of a problem, and how its covariance is carried to functions of the unknowns.

use nalgebra::{DMatrix, DVector};

use super::Linearised;

/// State of one block at the solution.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockFit {
    /// Adjusted less observed.
    pub residuals: DVector<f64>,
    /// The conditions' derivatives at the solution.
    pub linearised: Linearised,
    /// Q B' M^-1: minus the residuals' answer to the conditions.
    pub(super) gain: DMatrix<f64>,
    /// Q - Q B' M^-1 B Q: covariance of the adjusted observations for given parameters.
    pub(super) conditional: DMatrix<f64>,
}

/// State of one group at the solution.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupFit {
    /// Local parameters.
    pub local: DVector<f64>,
    /// d local / d global at the minimum.
    pub sensitivity: DMatrix<f64>,
    /// Covariance of the local parameters for given global ones.
    pub conditional: DMatrix<f64>,
    /// Covariance of local with global parameters (local x global).
    pub(super) cross: DMatrix<f64>,
    /// Covariance of the local parameters.
    pub(super) covariance: DMatrix<f64>,
    /// Its blocks.
    pub blocks: Vec<BlockFit>,
}

/// A solution of a [`Problem`].
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Global parameters.
    pub global: DVector<f64>,
    /// Their covariance, a priori (variance factor 1).
    pub covariance: DMatrix<f64>,
    /// The groups.
    pub groups: Vec<GroupFit>,
    /// Weighted sum of squared residuals, priors included.
    pub omega: f64,
    /// The priors' share of it.
    pub omega_priors: f64,
    /// Conditions and priors less parameters.
    pub redundancy: usize,
    /// Iterations until convergence.
    pub iterations: usize,
}

/// Derivative of a function (several rows) of the unknowns of one group.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradient {
    /// d function / d global parameters.
    pub global: DMatrix<f64>,
    /// d function / d local parameters of the group.
    pub local: DMatrix<f64>,
    /// (block, d function / d its adjusted observations).
    pub observed: Vec<(usize, DMatrix<f64>)>,
}

/// Random part of a function: covariance = `total Qxx total' + own`; functions of different groups
/// have the covariance `total_1 Qxx total_2'`.
#[derive(Clone, Debug, PartialEq)]
pub struct Propagated {
    /// Total derivative to the global parameters.
    pub total: DMatrix<f64>,
    /// Covariance for given global parameters.
    pub own: DMatrix<f64>,
}

impl Fit {
    /// Variance factor a posteriori; `None` at redundancy 0.
    pub fn variance_factor(&self) -> Option<f64> {
        (self.redundancy > 0).then(|| self.omega / self.redundancy as f64)
    }

    /// A function of parameters alone, and its noise through the adjusted observations.
    fn by_parameters(&self, group: usize, gradient: &Gradient) -> (DMatrix<f64>, DMatrix<f64>, DMatrix<f64>) {
        let rows = gradient.global.nrows();
        let (mut global, mut local) = (gradient.global.clone(), gradient.local.clone());
        let mut own = DMatrix::zeros(rows, rows);
        for (index, derivative) in &gradient.observed {
            let block = &self.groups[group].blocks[*index];
            let answer = derivative * &block.gain;
            let to_global = &answer * &block.linearised.global;
            for (k, &column) in block.linearised.columns.iter().enumerate() {
                let mut target = global.column_mut(column);
                target -= to_global.column(k);
            }
            if local.ncols() > 0 {
                local -= &answer * &block.linearised.local;
            }
            own += derivative * &block.conditional * derivative.transpose();
        }
        (global, local, own)
    }

    /// Splits a function's derivative into its answer to the global parameters and its own noise.
    pub fn propagate(&self, group: usize, gradient: &Gradient) -> Propagated {
        let (mut total, local, mut own) = self.by_parameters(group, gradient);
        if local.ncols() > 0 {
            total += &local * &self.groups[group].sensitivity;
            own += &local * &self.groups[group].conditional * local.transpose();
        }
        Propagated { total, own }
    }

    /// Covariance of a function of one group. Most functions depend on few of the global parameters;
    /// only those columns are multiplied.
    pub fn covariance_of(&self, group: usize, gradient: &Gradient) -> DMatrix<f64> {
        let (global, local, mut covariance) = self.by_parameters(group, gradient);
        let columns: Vec<usize> =
            (0..global.ncols()).filter(|&k| global.column(k).iter().any(|&v| v != 0.0)).collect();
        let global = global.select_columns(&columns);
        let n = columns.len();
        let shared = DMatrix::from_fn(n, n, |i, j| self.covariance[(columns[i], columns[j])]);
        covariance += &global * (shared * global.transpose());
        if local.ncols() > 0 {
            let fit = &self.groups[group];
            let mixed = &local * (fit.cross.select_columns(&columns) * global.transpose());
            covariance += &local * (&fit.covariance * local.transpose()) + mixed.transpose() + mixed;
        }
        covariance
    }

    /// Covariance of a block's adjusted observations, a priori.
    pub fn adjusted_covariance(&self, group: usize, block: usize) -> DMatrix<f64> {
        let fit = &self.groups[group];
        let block = &fit.blocks[block];
        let (lin, n) = (&block.linearised, block.linearised.columns.len());
        let global = &block.gain * &lin.global;
        let shared = DMatrix::from_fn(n, n, |i, j| self.covariance[(lin.columns[i], lin.columns[j])]);
        // From the right: nalgebra is slow at products from the left with few rows.
        let mut covariance = &block.conditional + &global * (shared * global.transpose());
        if lin.local.ncols() > 0 {
            let local = &block.gain * &lin.local;
            let cross = DMatrix::from_fn(local.ncols(), n, |i, j| fit.cross[(i, lin.columns[j])]);
            let mixed = &local * (cross * global.transpose());
            covariance += &local * (&fit.covariance * local.transpose()) + mixed.transpose() + mixed;
        }
        covariance
    }
}
