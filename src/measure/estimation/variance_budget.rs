//! What a function's variance comes from.
//!
//! Observations, priors and earlier knowledge are independent of one another, and to first order a function answers to the
//! error of each by a vector: with `q = N^-1 g` the one of a prior is `Sigma^-1 q`, that of a block's observations
//! `g_l (I - Q B' M^-1 B) - B' M^-1 (A, L) q`. Their weighted squares add up to the function's variance, so that each is a
//! part of it (Niemeier, *Ausgleichungsrechnung*, propagation of variances). Once `q` is known a part costs a product.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::fit::{BlockFit, Fit, Gradient, GroupFit};
use super::linear::{factor_in_place, inverse_spd, invert_lower};
use super::problem::{Block, Group, Prior, Problem};

/// Some of a block's observations, which are independent of its others, and what they are called.
pub type Observed = (&'static str, Range<usize>);

/// What sources are called.
#[derive(Clone, Copy)]
pub struct Naming<'a> {
    /// Of the observations of a block: its group, its place there.
    pub observations: &'a dyn Fn(usize, usize) -> Vec<Observed>,
    /// Of a prior, by its own name.
    pub prior: fn(&'static str) -> &'static str,
    /// Of what else is known of all global parameters.
    pub known: &'static str,
    /// Of the most numerous observations: what groups other than the function's have of them is what is left of the
    /// variance, which spares their products.
    pub rest: &'static str,
}

/// What went into [`Problem::known`] and keeps its name there: priors, and observations without parameters of their own.
#[derive(Clone, Debug)]
pub struct AttributedInformation {
    priors: Vec<Prior>,
    blocks: Vec<(Block, BlockFit, Vec<Observed>)>,
}

impl AttributedInformation {
    /// Of a solution from which knowledge was taken: its priors on no other columns than these, and a group of it.
    pub fn from_solution(
        problem: &Problem,
        fit: &Fit,
        columns: impl Fn(usize) -> bool,
        group: usize,
        naming: &Naming,
    ) -> Self {
        let kept = |prior: &&Prior| prior.columns.iter().all(|column| columns(*column));
        let of_group = problem.groups.get(group).into_iter().zip(fit.groups.get(group));
        let blocks = of_group.flat_map(|(group, solved)| group.blocks.iter().zip(&solved.blocks));
        let named = |(k, (block, solved)): (usize, (&Block, &BlockFit))| {
            (block.clone(), solved.clone(), (naming.observations)(group, k))
        };
        Self {
            priors: problem.priors.iter().filter(kept).cloned().collect(),
            blocks: blocks.enumerate().map(named).collect(),
        }
    }
}

/// A part of a function's variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// What it comes from.
    pub source: &'static str,
    /// The part, the function's unit squared, a priori.
    pub variance: f64,
    /// The function's variance if the parameters of this name were known without error; `None` for observations.
    pub if_known: Option<f64>,
}

/// Parts by name, in order of appearance.
#[derive(Default)]
struct Sum(Vec<(&'static str, f64)>);

impl Sum {
    fn add(&mut self, source: &'static str, variance: f64) {
        match self.0.iter_mut().find(|(name, _)| *name == source) {
            Some((_, sum)) => *sum += variance,
            None => self.0.push((source, variance)),
        }
    }

    fn total(&self) -> f64 {
        self.0.iter().map(|(_, variance)| variance).sum()
    }
}

/// How a function answers to the parameters' normal equations: `q = N^-1 g`, which is its covariance with them.
struct Sensitivity {
    global: DVector<f64>,
    local: DVector<f64>,
}

impl Sensitivity {
    /// Of the function that it is of, through the parameters.
    fn function_variance(&self, by: &Gradient) -> f64 {
        let global = |(k, column): (usize, &usize)| by.global[(k, 0)] * self.global[*column];
        let local = (0..by.local.nrows()).map(|k| by.local[(k, 0)] * self.local[k]);
        by.columns.iter().enumerate().map(global).chain(local).sum()
    }
}

/// All that a solution rests on.
pub struct Sources<'a> {
    problem: &'a Problem,
    fit: &'a Fit,
    naming: Naming<'a>,
    attributed: Option<&'a AttributedInformation>,
    /// Of each source but the rest: what all groups together say of the global parameters; empty where there is one group.
    group_information: Vec<(&'static str, DMatrix<f64>)>,
}

impl<'a> Sources<'a> {
    /// Of a solution; `told`: what of the knowledge from elsewhere keeps its name.
    pub fn new(
        problem: &'a Problem,
        fit: &'a Fit,
        naming: Naming<'a>,
        told: Option<&'a AttributedInformation>,
    ) -> Self {
        let mut sources = Self { problem, fit, naming, attributed: told, group_information: vec![] };
        if problem.groups.len() > 1 {
            sources.group_information = sources.information_by_source();
        }
        sources
    }

    /// The parts of the variance of one function (the gradient's first) of a group's unknowns. They add up to
    /// [`Fit::variances_of`].
    pub fn contributions(&self, group: usize, gradient: &Gradient) -> Vec<Part> {
        let (by, own) = self.fit.eliminate_observations(group, gradient);
        let answer = self.sensitivity(group, &by);
        let mut sum = Sum::default();
        self.add_priors(&answer.global, &mut sum);
        self.add_information_prior(&answer.global, &mut sum);
        self.add_own_group(group, &answer, &gradient.observed, &mut sum);
        self.add_other_groups(group, &answer.global, &mut sum);
        let total = own[(0, 0)] + answer.function_variance(&by);
        if self.problem.groups.len() > 1 {
            let explained = sum.total();
            sum.add(self.naming.rest, (total - explained).max(0.0));
        }
        let part = |(source, variance)| Part {
            source,
            variance,
            if_known: self.variance_if_known(group, &answer, source, total),
        };
        sum.0.into_iter().map(part).collect()
    }

    fn sensitivity(&self, group: usize, by: &Gradient) -> Sensitivity {
        let solved = &self.fit.groups[group];
        let mut function = DVector::zeros(self.fit.global.len());
        by.columns.iter().enumerate().for_each(|(k, column)| function[*column] += by.global[(k, 0)]);
        let local = by.local.column(0);
        if local.is_empty() {
            return Sensitivity { global: &self.fit.response * function, local: DVector::zeros(0) };
        }
        function += solved.sensitivity.tr_mul(&local);
        let global = &self.fit.response * function;
        Sensitivity { local: &solved.sensitivity * &global + &solved.conditional * local, global }
    }

    fn add_priors(&self, global: &DVector<f64>, sum: &mut Sum) {
        for prior in &self.problem.priors {
            sum.add((self.naming.prior)(prior.name), prior_variance(prior, global));
        }
    }

    /// Knowledge from elsewhere, less what keeps its name.
    fn add_information_prior(&self, global: &DVector<f64>, sum: &mut Sum) {
        let Some(known) = &self.problem.known else { return };
        let all = global.dot(&(&known.information * global));
        let mut named = Sum::default();
        for prior in self.attributed.iter().flat_map(|told| &told.priors) {
            named.add((self.naming.prior)(prior.name), prior_variance(prior, global));
        }
        for (block, solved, observed) in self.attributed.iter().flat_map(|told| &told.blocks) {
            let answered = observation_sensitivity(solved, global, &DVector::zeros(0));
            add_block(block, &-answered, observed, &mut named);
        }
        let rest = (all - named.total()).max(0.0);
        named.0.into_iter().for_each(|(source, variance)| sum.add(source, variance));
        sum.add(self.naming.known, rest);
    }

    /// The group that the function is of.
    fn add_own_group(&self, group: usize, answer: &Sensitivity, observed: &[(usize, DMatrix<f64>)], sum: &mut Sum) {
        let (given, solved) = (&self.problem.groups[group], &self.fit.groups[group]);
        for prior in &given.priors {
            sum.add((self.naming.prior)(prior.name), prior_variance(prior, &answer.local));
        }
        for (k, (block, fit)) in given.blocks.iter().zip(&solved.blocks).enumerate() {
            let mut answered = -observation_sensitivity(fit, &answer.global, &answer.local);
            for (_, derivative) in observed.iter().filter(|(index, _)| *index == k) {
                answered += &fit.conditional * derivative.column(0);
            }
            add_block(block, &answered, &(self.naming.observations)(group, k), sum);
        }
    }

    /// The other groups, whose own parameters follow the global ones.
    fn add_other_groups(&self, group: usize, global: &DVector<f64>, sum: &mut Sum) {
        if self.group_information.is_empty() {
            return;
        }
        let mut own = Sum::default();
        let local = &self.fit.groups[group].sensitivity * global;
        self.add_own_group(group, &Sensitivity { global: global.clone(), local }, &[], &mut own);
        for (source, information) in &self.group_information {
            let all = global.dot(&(information * global));
            let own = own.0.iter().find(|(name, _)| name == source).map_or(0.0, |(_, variance)| *variance);
            sum.add(source, (all - own).max(0.0));
        }
    }

    /// Per source but the rest the information of all groups on the global parameters.
    fn information_by_source(&self) -> Vec<(&'static str, DMatrix<f64>)> {
        let p = self.fit.global.len();
        let mut all: Vec<(&'static str, DMatrix<f64>)> = vec![];
        for (index, (group, solved)) in self.problem.groups.iter().zip(&self.fit.groups).enumerate() {
            for (source, rows) in self.weighted_rows(index, group, solved) {
                let at = all.iter().position(|(name, _)| *name == source).unwrap_or_else(|| {
                    all.push((source, DMatrix::zeros(p, p)));
                    all.len() - 1
                });
                all[at].1.gemm_tr(1.0, &rows, &rows, 1.0);
            }
        }
        all
    }

    /// A group's weighted answers to the global parameters, source by source.
    fn weighted_rows(&self, index: usize, group: &Group, solved: &GroupFit) -> Vec<(&'static str, DMatrix<f64>)> {
        let mut all = vec![];
        for prior in &group.priors {
            let rows = whitening_matrix(&prior.covariance) * solved.sensitivity.select_rows(&prior.columns);
            stack_rows(&mut all, (self.naming.prior)(prior.name), &rows);
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
            for (source, places) in observed {
                let (first, count) = (places.start, places.len());
                let covariance = block.covariance.view((first, first), (count, count)).into_owned();
                let gain = fit.gain.rows(first, count);
                stack_rows(&mut all, source, &(whitening_matrix(&covariance) * gain * &by_global));
            }
        }
        all.into_iter().map(|(source, rows)| (source, DMatrix::from_rows(&rows))).collect()
    }

    /// The function's variance under the condition that the parameters of a name are known.
    fn variance_if_known(&self, group: usize, answer: &Sensitivity, source: &'static str, total: f64) -> Option<f64> {
        let of = |priors: &[Prior]| -> Vec<usize> {
            let named = priors.iter().filter(|prior| (self.naming.prior)(prior.name) == source);
            named.flat_map(|prior| prior.columns.clone()).collect()
        };
        let told = self.attributed.map_or(&[][..], |told| &told.priors);
        let global = [of(&self.problem.priors), of(told)].concat();
        let local = of(&self.problem.groups[group].priors);
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
        let with = |i: usize| if i < n { answer.global[global[i]] } else { answer.local[local[i - n]] };
        let with = DVector::from_fn(m, |i, _| with(i));
        let explained = DMatrix::from_fn(m, m, covariance).cholesky()?.solve(&with);
        Some((total - with.dot(&explained)).max(0.0))
    }
}

/// `q' Sigma^-1 q` on a prior's columns.
fn prior_variance(prior: &Prior, answer: &DVector<f64>) -> f64 {
    let of = answer.select_rows(&prior.columns);
    inverse_spd(&prior.covariance).map_or(0.0, |weight| of.dot(&(weight * &of)))
}

/// `Q B' M^-1 (A, L) q` of a block.
fn observation_sensitivity(block: &BlockFit, global: &DVector<f64>, local: &DVector<f64>) -> DVector<f64> {
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

/// `y' Q^-1 y`, by what its observations are.
fn add_block(block: &Block, answered: &DVector<f64>, observed: &[Observed], sum: &mut Sum) {
    for (source, places) in observed {
        let (first, count) = (places.start, places.len());
        let covariance = block.covariance.view((first, first), (count, count)).into_owned();
        let of = answered.rows(first, count);
        sum.add(source, inverse_spd(&covariance).map_or(0.0, |weight| of.dot(&(weight * of))));
    }
}

/// `W` with `W' W` the inverse of a covariance; 0 where it has none.
fn whitening_matrix(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let mut lower = covariance.clone();
    if !factor_in_place(&mut lower) {
        return DMatrix::zeros(covariance.nrows(), covariance.ncols());
    }
    invert_lower(&mut lower);
    lower
}

type Rows = Vec<nalgebra::RowDVector<f64>>;

fn stack_rows(all: &mut Vec<(&'static str, Rows)>, source: &'static str, rows: &DMatrix<f64>) {
    let at = all.iter().position(|(name, _)| *name == source).unwrap_or_else(|| {
        all.push((source, vec![]));
        all.len() - 1
    });
    all[at].1.extend(rows.row_iter().map(|row| row.into_owned()));
}

#[cfg(test)]
mod tests;
