//! Uncertainty budget: contributions of observations, priors and earlier information to the variance of a function.
//!
//! The sources are independent of one another, and to first order the function depends on the errors of each by a vector:
//! with `q = N^-1 g` it is `Sigma^-1 q` for a prior and `g_l (I - Q B' M^-1 B) - B' M^-1 (A, L) q` for a block's
//! observations. Their weighted squares add up to the function's variance, so each is a contribution to it (Niemeier,
//! *Ausgleichungsrechnung*, propagation of variances). Given `q`, a contribution costs one product.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::fit::{BlockFit, Fit, Gradient, GroupFit};
use super::linear::{inverse_spd, whitening_matrix};
use super::problem::{Block, Group, Prior, Problem};

/// A named range of a block's observations that is independent of the others.
pub type NamedObservations = (&'static str, Range<usize>);

/// Names of the sources in a budget.
#[derive(Clone, Copy)]
pub struct SourceNames<'a> {
    /// Names of a block's observations, given (group, block).
    pub observations: &'a dyn Fn(usize, usize) -> Vec<NamedObservations>,
    /// Name of [`Problem::known`].
    pub known: &'static str,
    /// Name of the most numerous observations: other groups' contribution of this name is computed as the remainder of the
    /// variance, which avoids their products.
    pub rest: &'static str,
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

/// Variances by name, in order of appearance.
#[derive(Default)]
struct VarianceSum(Vec<(&'static str, f64)>);

impl VarianceSum {
    fn add_variance(&mut self, source: &'static str, variance: f64) {
        match self.0.iter_mut().find(|(name, _)| *name == source) {
            Some((_, sum)) => *sum += variance,
            None => self.0.push((source, variance)),
        }
    }

    fn total(&self) -> f64 {
        self.0.iter().map(|(_, variance)| variance).sum()
    }
}

/// Covariance of a function with the parameters: `q = N^-1 g`.
struct Sensitivity {
    global: DVector<f64>,
    local: DVector<f64>,
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
    /// Information of all groups together about the global parameters, for each source but the rest; empty for a single
    /// group.
    group_information: Vec<(&'static str, DMatrix<f64>)>,
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
            group_information: vec![],
        };
        if problem.groups.len() > 1 {
            sources.group_information = sources.information_by_source();
        }
        sources
    }

    /// Returns the contributions to the variance of one function (the gradient's first) of a group's unknowns. Their sum is
    /// [`Fit::function_variances`].
    pub fn contributions(&self, group: usize, gradient: &Gradient) -> Vec<VarianceContribution> {
        let (by, own) = self.fit.eliminate_observations(group, gradient);
        let sensitivity = self.function_sensitivity(group, &by);
        let mut sum = VarianceSum::default();
        self.add_prior_variances(&sensitivity.global, &mut sum);
        self.add_information_prior(&sensitivity.global, &mut sum);
        self.add_own_group(group, &sensitivity, &gradient.observed, &mut sum);
        self.add_other_groups(group, &sensitivity.global, &mut sum);
        let total = own[(0, 0)] + sensitivity.function_variance(&by);
        if self.problem.groups.len() > 1 {
            let explained = sum.total();
            sum.add_variance(self.naming.rest, (total - explained).max(0.0));
        }
        let part = |(source, variance)| VarianceContribution {
            source,
            variance,
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
        let local = by.local.column(0);
        if local.is_empty() {
            return Sensitivity {
                global: &self.fit.response * function,
                local: DVector::zeros(0),
            };
        }
        function += solved.sensitivity.tr_mul(&local);
        let global = &self.fit.response * function;
        Sensitivity {
            local: &solved.sensitivity * &global + &solved.conditional * local,
            global,
        }
    }

    fn add_prior_variances(&self, global: &DVector<f64>, sum: &mut VarianceSum) {
        for prior in &self.problem.priors {
            sum.add_variance(prior.name.source, prior_variance(prior, global));
        }
    }

    /// Adds the contributions of the prior information: its named parts and the remainder.
    fn add_information_prior(&self, global: &DVector<f64>, sum: &mut VarianceSum) {
        let Some(known) = &self.problem.known else {
            return;
        };
        let all = global.dot(&(&known.information * global));
        let mut named = VarianceSum::default();
        for prior in self
            .attributed
            .iter()
            .flat_map(|attributed| &attributed.priors)
        {
            named.add_variance(prior.name.source, prior_variance(prior, global));
        }
        for (block, solved, observed) in self
            .attributed
            .iter()
            .flat_map(|attributed| &attributed.blocks)
        {
            let dependence = observation_sensitivity(solved, global, &DVector::zeros(0));
            add_block(block, &-dependence, observed, &mut named);
        }
        let rest = (all - named.total()).max(0.0);
        named
            .0
            .into_iter()
            .for_each(|(source, variance)| sum.add_variance(source, variance));
        sum.add_variance(self.naming.known, rest);
    }

    /// Adds the contributions of the function's own group.
    fn add_own_group(
        &self,
        group: usize,
        sensitivity: &Sensitivity,
        observed: &[(usize, DMatrix<f64>)],
        sum: &mut VarianceSum,
    ) {
        let (given, solved) = (&self.problem.groups[group], &self.fit.groups[group]);
        for prior in &given.priors {
            sum.add_variance(prior.name.source, prior_variance(prior, &sensitivity.local));
        }
        for (k, (block, fit)) in given.blocks.iter().zip(&solved.blocks).enumerate() {
            let mut dependence =
                -observation_sensitivity(fit, &sensitivity.global, &sensitivity.local);
            for (_, derivative) in observed.iter().filter(|(index, _)| *index == k) {
                dependence += &fit.conditional * derivative.column(0);
            }
            add_block(
                block,
                &dependence,
                &(self.naming.observations)(group, k),
                sum,
            );
        }
    }

    /// Adds the contributions of the other groups, whose own parameters depend on the global ones.
    fn add_other_groups(&self, group: usize, global: &DVector<f64>, sum: &mut VarianceSum) {
        if self.group_information.is_empty() {
            return;
        }
        let mut own = VarianceSum::default();
        let local = &self.fit.groups[group].sensitivity * global;
        self.add_own_group(
            group,
            &Sensitivity {
                global: global.clone(),
                local,
            },
            &[],
            &mut own,
        );
        for (source, information) in &self.group_information {
            let all = global.dot(&(information * global));
            let own = own
                .0
                .iter()
                .find(|(name, _)| name == source)
                .map_or(0.0, |(_, variance)| *variance);
            sum.add_variance(source, (all - own).max(0.0));
        }
    }

    /// Returns the information of all groups about the global parameters, for each source but the rest.
    fn information_by_source(&self) -> Vec<(&'static str, DMatrix<f64>)> {
        let p = self.fit.global.len();
        let mut all: Vec<(&'static str, DMatrix<f64>)> = vec![];
        for (index, (group, solved)) in self.problem.groups.iter().zip(&self.fit.groups).enumerate()
        {
            for (source, rows) in self.weighted_rows(index, group, solved) {
                let at = all
                    .iter()
                    .position(|(name, _)| *name == source)
                    .unwrap_or_else(|| {
                        all.push((source, DMatrix::zeros(p, p)));
                        all.len() - 1
                    });
                all[at].1.gemm_tr(1.0, &rows, &rows, 1.0);
            }
        }
        all
    }

    /// Returns the weighted dependence of a group on the global parameters, source by source.
    fn weighted_rows(
        &self,
        index: usize,
        group: &Group,
        solved: &GroupFit,
    ) -> Vec<(&'static str, DMatrix<f64>)> {
        let mut all = vec![];
        for prior in &group.priors {
            let rows =
                weights_root(&prior.covariance) * solved.sensitivity.select_rows(&prior.columns);
            append_source_rows(&mut all, prior.name.source, &rows);
        }
        for (k, (block, fit)) in group.blocks.iter().zip(&solved.blocks).enumerate() {
            let mut observed = (self.naming.observations)(index, k);
            observed.retain(|(source, _)| *source != self.naming.rest);
            if observed.is_empty() {
                continue;
            }
            let lin = &fit.linearised;
            let mut by_global = &lin.local * &solved.sensitivity;
            for (column, values) in lin.columns.iter().zip(lin.global.column_iter()) {
                by_global.column_mut(*column).axpy(1.0, &values, 1.0);
            }
            for (source, range) in observed {
                let (first, count) = (range.start, range.len());
                let covariance = block
                    .covariance
                    .view((first, first), (count, count))
                    .into_owned();
                let gain = fit.gain.rows(first, count);
                append_source_rows(
                    &mut all,
                    source,
                    &(weights_root(&covariance) * gain * &by_global),
                );
            }
        }
        all.into_iter()
            .map(|(source, rows)| (source, DMatrix::from_rows(&rows)))
            .collect()
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

/// Returns `q' Sigma^-1 q` for a prior's columns.
fn prior_variance(prior: &Prior, sensitivity: &DVector<f64>) -> f64 {
    let own = sensitivity.select_rows(&prior.columns);
    inverse_spd(&prior.covariance).map_or(0.0, |weight| own.dot(&(weight * &own)))
}

/// Returns `Q B' M^-1 (A, L) q` of a block.
fn observation_sensitivity(
    block: &BlockFit,
    global: &DVector<f64>,
    local: &DVector<f64>,
) -> DVector<f64> {
    let lin = &block.linearised;
    let mut conditions = DVector::zeros(lin.misclosure.len());
    for (column, by) in lin.columns.iter().zip(lin.global.column_iter()) {
        conditions.axpy(global[*column], &by, 1.0);
    }
    for (value, by) in local.iter().zip(lin.local.column_iter()) {
        conditions.axpy(*value, &by, 1.0);
    }
    &block.gain * conditions
}

/// Adds `y' Q^-1 y` of a block's observations, by source.
fn add_block(
    block: &Block,
    dependence: &DVector<f64>,
    observed: &[NamedObservations],
    sum: &mut VarianceSum,
) {
    for (source, range) in observed {
        let (first, count) = (range.start, range.len());
        let covariance = block
            .covariance
            .view((first, first), (count, count))
            .into_owned();
        let own = dependence.rows(first, count);
        sum.add_variance(
            source,
            inverse_spd(&covariance).map_or(0.0, |weight| own.dot(&(weight * own))),
        );
    }
}

/// Returns `W` with `W' W` the inverse of a covariance; 0 if it has none.
fn weights_root(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    whitening_matrix(covariance).unwrap_or_else(|| covariance * 0.0)
}

type StackedRows = Vec<nalgebra::RowDVector<f64>>;

fn append_source_rows(
    all: &mut Vec<(&'static str, StackedRows)>,
    source: &'static str,
    rows: &DMatrix<f64>,
) {
    let at = all
        .iter()
        .position(|(name, _)| *name == source)
        .unwrap_or_else(|| {
            all.push((source, vec![]));
            all.len() - 1
        });
    all[at]
        .1
        .extend(rows.row_iter().map(|row| row.into_owned()));
}

#[cfg(test)]
mod tests;
