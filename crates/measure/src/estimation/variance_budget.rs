//! Uncertainty budget: contributions of observations, priors and earlier information to the variance of a function.
//!
//! The sources are independent of one another, and to first order the function depends on the errors of each by a vector:
//! with `q = N^-1 g` it is `Sigma^-1 q` for a prior and `g_l (I - Q B' M^-1 B) - B' M^-1 (A, L) q` for a block's
//! observations. Their weighted squares add up to the function's variance, so each is a contribution to it (Niemeier,
//! *Ausgleichungsrechnung*, propagation of variances). Given `q`, a contribution costs one product.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::fit::{BlockFit, Fit, Gradient};
use super::linear::whitening_matrix;
use super::problem::{Block, Prior, Problem};

/// A named range of a block's observations that is independent of the others.
pub type NamedObservations = (&'static str, Range<usize>);

/// Names of the sources in a budget.
#[derive(Clone, Copy)]
pub struct SourceNames<'a> {
    /// Names of a block's observations, given (group, block).
    pub observations: &'a dyn Fn(usize, usize) -> Vec<NamedObservations>,
    /// Name of [`Problem::known`].
    pub known: &'static str,
}

/// Parts of [`Problem::known`] that keep their names in a budget: priors, and observations without parameters of their own.
#[derive(Clone, Debug)]
pub struct AttributedInformation {
    priors: Vec<Prior>,
    blocks: Vec<(Block, BlockFit, Vec<NamedObservations>)>,
}

impl AttributedInformation {
    /// Collects from a solution the priors on no other columns than these, and the observations of one group.
    pub fn from_solution(
        problem: &Problem,
        fit: &Fit,
        columns: impl Fn(usize) -> bool,
        group: usize,
        naming: &SourceNames,
    ) -> Self {
        let selected = |prior: &&Prior| prior.columns.iter().all(|column| columns(*column));
        let of_group = problem
            .groups
            .get(group)
            .into_iter()
            .zip(fit.groups.get(group));
        let blocks = of_group.flat_map(|(group, solved)| group.blocks.iter().zip(&solved.blocks));
        let named = |(k, (block, solved)): (usize, (&Block, &BlockFit))| {
            (
                block.clone(),
                solved.clone(),
                (naming.observations)(group, k),
            )
        };
        Self {
            priors: problem.priors.iter().filter(selected).cloned().collect(),
            blocks: blocks.enumerate().map(named).collect(),
        }
    }
}

/// A contribution to a function's variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VarianceContribution {
    /// Name of the source.
    pub source: &'static str,
    /// Contribution, the function's unit squared, a priori.
    pub variance: f64,
    /// Variance of the function if the parameters of this source were known without error; `None` for observations.
    pub if_known: Option<f64>,
}

/// Variances of a function, or information about parameters, by name in order of appearance.
#[derive(Default)]
struct VarianceSum(Vec<(&'static str, DMatrix<f64>)>);

impl VarianceSum {
    /// Returns the sum of a source for a number of functions, 0 at first.
    fn of_source(&mut self, source: &'static str, functions: usize) -> &mut DMatrix<f64> {
        let at = self.0.iter().position(|(name, _)| *name == source);
        let at = at.unwrap_or_else(|| {
            self.0.push((source, DMatrix::zeros(functions, functions)));
            self.0.len() - 1
        });
        &mut self.0[at].1
    }

    fn add_variance(&mut self, source: &'static str, variance: f64) {
        *self.of_source(source, 1) += DMatrix::from_element(1, 1, variance);
    }

    /// Adds `y' Q^-1 y` for the dependence `y` on errors with the covariance `Q`.
    fn add_weighted(
        &mut self,
        source: &'static str,
        dependence: &DMatrix<f64>,
        covariance: &DMatrix<f64>,
    ) {
        if let Some(white) = whitening_matrix(covariance) {
            let rows = white * dependence;
            let sum = self.of_source(source, rows.ncols());
            sum.gemm_tr(1.0, &rows, &rows, 1.0);
        }
    }

    /// Adds the contributions of a block's observations.
    fn add_block(
        &mut self,
        block: &Block,
        dependence: &DMatrix<f64>,
        observed: &[NamedObservations],
    ) {
        for (source, range) in observed {
            let (first, count) = (range.start, range.len());
            let covariance = block.covariance.view((first, first), (count, count));
            let own = dependence.rows(first, count).into_owned();
            self.add_weighted(source, &own, &covariance.into_owned());
        }
    }

    /// Adds the contributions of the function's prior.
    fn add_prior(&mut self, prior: &Prior, sensitivity: &DMatrix<f64>) {
        let own = sensitivity.select_rows(&prior.columns);
        self.add_weighted(prior.name.source, &own, &prior.covariance);
    }

    fn variance(&self, source: &str) -> f64 {
        let own = self.0.iter().find(|(name, _)| *name == source);
        own.map_or(0.0, |(_, variance)| variance[(0, 0)])
    }
}

/// Covariance of functions with the parameters, `q = N^-1 g`, one column per function.
struct Sensitivity {
    global: DMatrix<f64>,
    local: DMatrix<f64>,
}

impl Sensitivity {
    /// Returns the function's variance through the parameters.
    fn function_variance(&self, by: &Gradient) -> f64 {
        let global = |(k, column): (usize, &usize)| by.global[(k, 0)] * self.global[*column];
        let local = (0..by.local.nrows()).map(|k| by.local[(k, 0)] * self.local[k]);
        by.columns.iter().enumerate().map(global).chain(local).sum()
    }
}

/// Sources of a solution, prepared for budgets.
pub struct VarianceSources<'a> {
    problem: &'a Problem,
    fit: &'a Fit,
    naming: SourceNames<'a>,
    attributed: Option<&'a AttributedInformation>,
    /// Information of all groups together about the global parameters; empty for a single group.
    group_information: VarianceSum,
}

impl<'a> VarianceSources<'a> {
    /// Prepares the budgets of a solution; `attributed`: parts of the prior information that keep their names.
    pub fn new(
        problem: &'a Problem,
        fit: &'a Fit,
        naming: SourceNames<'a>,
        attributed: Option<&'a AttributedInformation>,
    ) -> Self {
        let mut sources = Self {
            problem,
            fit,
            naming,
            attributed,
            group_information: VarianceSum::default(),
        };
        if problem.groups.len() > 1 {
            let global = DMatrix::identity(fit.global.len(), fit.global.len());
            let mut sum = VarianceSum::default();
            for group in 0..problem.groups.len() {
                sources.add_group(
                    group,
                    &sources.sensitivity_of(group, &global),
                    &[],
                    &mut sum,
                );
            }
            sources.group_information = sum;
        }
        sources
    }

    /// Returns the contributions to the variance of one function (the gradient's first) of a group's unknowns. Their sum is
    /// [`Fit::function_variances`].
    pub fn contributions(&self, group: usize, gradient: &Gradient) -> Vec<VarianceContribution> {
        let (by, own) = self.fit.eliminate_observations(group, gradient);
        let sensitivity = self.function_sensitivity(group, &by);
        let mut sum = VarianceSum::default();
        for prior in &self.problem.priors {
            sum.add_prior(prior, &sensitivity.global);
        }
        self.add_information_prior(&sensitivity.global, &mut sum);
        self.add_group(group, &sensitivity, &gradient.observed, &mut sum);
        self.add_other_groups(group, &sensitivity.global, &mut sum);
        let total = own[(0, 0)] + sensitivity.function_variance(&by);
        let part = |(source, variance): (&'static str, DMatrix<f64>)| VarianceContribution {
            source,
            variance: variance[(0, 0)],
            if_known: self.variance_if_known(group, &sensitivity, source, total),
        };
        sum.0.into_iter().map(part).collect()
    }

    fn function_sensitivity(&self, group: usize, by: &Gradient) -> Sensitivity {
        let solved = &self.fit.groups[group];
        let mut function = DVector::zeros(self.fit.global.len());
        by.columns
            .iter()
            .enumerate()
            .for_each(|(k, column)| function[*column] += by.global[(k, 0)]);
        if by.local.nrows() > 0 {
            function += solved.sensitivity.tr_mul(&by.local.column(0));
        }
        let global = DMatrix::from_columns(&[&self.fit.response * function]);
        let mut sensitivity = self.sensitivity_of(group, &global);
        if by.local.nrows() > 0 {
            sensitivity.local += &solved.conditional * by.local.columns(0, 1);
        }
        sensitivity
    }

    /// Returns the sensitivity of functions of the global parameters alone, on which a group's own parameters depend.
    fn sensitivity_of(&self, group: usize, global: &DMatrix<f64>) -> Sensitivity {
        Sensitivity {
            local: &self.fit.groups[group].sensitivity * global,
            global: global.clone(),
        }
    }

    /// Adds the contributions of the prior information: its named parts and the remainder.
    fn add_information_prior(&self, global: &DMatrix<f64>, sum: &mut VarianceSum) {
        let Some(known) = &self.problem.known else {
            return;
        };
        let mut named = VarianceSum::default();
        if let Some(AttributedInformation { priors, blocks }) = self.attributed {
            for prior in priors {
                named.add_prior(prior, global);
            }
            for (block, solved, observed) in blocks {
                let dependence = observation_sensitivity(solved, global, &DMatrix::zeros(0, 1));
                named.add_block(block, &dependence, observed);
            }
        }
        let mut rest = global.dot(&(&known.information * global));
        for (source, variance) in named.0 {
            rest -= variance[(0, 0)];
            sum.add_variance(source, variance[(0, 0)]);
        }
        sum.add_variance(self.naming.known, rest.max(0.0));
    }

    /// Adds the contributions of a group. `observed`: derivatives of the function with respect to its adjusted observations.
    fn add_group(
        &self,
        group: usize,
        sensitivity: &Sensitivity,
        observed: &[(usize, DMatrix<f64>)],
        sum: &mut VarianceSum,
    ) {
        let (given, solved) = (&self.problem.groups[group], &self.fit.groups[group]);
        for prior in &given.priors {
            sum.add_prior(prior, &sensitivity.local);
        }
        for (k, (block, fit)) in given.blocks.iter().zip(&solved.blocks).enumerate() {
            let Sensitivity { global, local } = sensitivity;
            let mut dependence = -observation_sensitivity(fit, global, local);
            for (_, derivative) in observed.iter().filter(|(index, _)| *index == k) {
                dependence += &fit.conditional * derivative.columns(0, 1);
            }
            sum.add_block(block, &dependence, &(self.naming.observations)(group, k));
        }
    }

    /// Adds the contributions of the other groups, whose own parameters depend on the global ones.
    fn add_other_groups(&self, group: usize, global: &DMatrix<f64>, sum: &mut VarianceSum) {
        if self.group_information.0.is_empty() {
            return;
        }
        let mut own = VarianceSum::default();
        self.add_group(group, &self.sensitivity_of(group, global), &[], &mut own);
        for (source, information) in &self.group_information.0 {
            let all = global.dot(&(information * global));
            sum.add_variance(source, (all - own.variance(source)).max(0.0));
        }
    }

    /// Returns the function's variance if the parameters of a source were known.
    fn variance_if_known(
        &self,
        group: usize,
        sensitivity: &Sensitivity,
        source: &'static str,
        total: f64,
    ) -> Option<f64> {
        let columns = |priors: &[Prior]| -> Vec<usize> {
            let named = priors.iter().filter(|prior| prior.name.source == source);
            named.flat_map(|prior| prior.columns.clone()).collect()
        };
        let attributed = self
            .attributed
            .map_or(&[][..], |attributed| &attributed.priors);
        let global = [columns(&self.problem.priors), columns(attributed)].concat();
        let local = columns(&self.problem.groups[group].priors);
        let (n, m) = (global.len(), global.len() + local.len());
        if m == 0 {
            return None;
        }
        let (fit, solved) = (self.fit, &self.fit.groups[group]);
        let covariance = |i: usize, j: usize| match (i < n, j < n) {
            (true, true) => fit.covariance[(global[i], global[j])],
            (true, false) => solved.cross[(local[j - n], global[i])],
            (false, true) => solved.cross[(local[i - n], global[j])],
            (false, false) => solved.covariance[(local[i - n], local[j - n])],
        };
        let with = |i: usize| {
            if i < n {
                sensitivity.global[global[i]]
            } else {
                sensitivity.local[local[i - n]]
            }
        };
        let with = DVector::from_fn(m, |i, _| with(i));
        let explained = DMatrix::from_fn(m, m, covariance).cholesky()?.solve(&with);
        Some((total - with.dot(&explained)).max(0.0))
    }
}

/// Returns `Q B' M^-1 (A, L) q` of a block.
fn observation_sensitivity(
    block: &BlockFit,
    global: &DMatrix<f64>,
    local: &DMatrix<f64>,
) -> DMatrix<f64> {
    let lin = &block.linearised;
    let mut conditions = &lin.global * global.select_rows(&lin.columns);
    if !local.is_empty() {
        conditions += &lin.local * local;
    }
    &block.gain * conditions
}

#[cfg(test)]
mod tests;
