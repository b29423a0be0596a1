//! What a function's variance comes from.
//!
//! Observations, priors and earlier knowledge are independent of one another, and to first order a function answers to the
//! error of each by a vector: with `q = N^-1 g` the one of a prior is `Sigma^-1 q`, that of a block's observations
//! `g_l (I - Q B' M^-1 B) - B' M^-1 (A, L) q`. Their weighted squares add up to the function's variance, so that each is a
//! part of it (Niemeier, *Ausgleichungsrechnung*, propagation of variances). Once `q` is known a part costs a product.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::fit::{BlockFit, Fit, Gradient, GroupFit};
use super::linear::{cholesky, inverse, invert_lower};
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
}

/// What went into [`Problem::known`] and keeps its name there: priors, and observations without parameters of their own.
#[derive(Clone, Debug)]
pub struct Told {
    priors: Vec<Prior>,
    blocks: Vec<(Block, BlockFit, Vec<Observed>)>,
}

impl Told {
    /// Of a solution from which knowledge was taken: its priors on no other columns than these, and a group of it.
    pub fn of(
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
struct Answer {
    global: DVector<f64>,
    local: DVector<f64>,
}

/// All that a solution rests on.
pub struct Sources<'a> {
    problem: &'a Problem,
    fit: &'a Fit,
    naming: Naming<'a>,
    told: Option<&'a Told>,
    /// Of each source: what all groups together say of the global parameters; empty where there is one group.
    of_groups: Vec<(&'static str, DMatrix<f64>)>,
}

impl<'a> Sources<'a> {
    /// Of a solution; `told`: what of the knowledge from elsewhere keeps its name.
    pub fn new(problem: &'a Problem, fit: &'a Fit, naming: Naming<'a>, told: Option<&'a Told>) -> Self {
        let mut sources = Self { problem, fit, naming, told, of_groups: vec![] };
        if problem.groups.len() > 1 {
            sources.of_groups = sources.informed();
        }
        sources
    }

    /// The parts of the variance of one function (the gradient's first) of a group's unknowns. They add up to
    /// [`Fit::variances_of`].
    pub fn parts(&self, group: usize, gradient: &Gradient) -> Vec<Part> {
        let (by, _) = self.fit.by_parameters(group, gradient);
        let answer = self.answer(group, &by);
        let mut sum = Sum::default();
        self.of_priors(&answer.global, &mut sum);
        self.of_known(&answer.global, &mut sum);
        self.of_own(group, &answer, &gradient.observed, &mut sum);
        self.of_others(group, &answer.global, &mut sum);
        let total = sum.total();
        let part = |(source, variance)| Part {
            source,
            variance,
            if_known: self.if_known(group, &answer, source, total),
        };
        sum.0.into_iter().map(part).collect()
    }

    fn answer(&self, group: usize, by: &Gradient) -> Answer {
        let solved = &self.fit.groups[group];
        let mut function = DVector::zeros(self.fit.global.len());
        by.columns.iter().enumerate().for_each(|(k, column)| function[*column] += by.global[(k, 0)]);
        let local = by.local.column(0);
        if local.is_empty() {
            return Answer { global: &self.fit.covariance * function, local: DVector::zeros(0) };
        }
        function += solved.sensitivity.tr_mul(&local);
        let global = &self.fit.covariance * function;
        Answer { local: &solved.sensitivity * &global + &solved.conditional * local, global }
    }

    fn of_priors(&self, global: &DVector<f64>, sum: &mut Sum) {
        for prior in &self.problem.priors {
            sum.add((self.naming.prior)(prior.name), of_prior(prior, global));
        }
    }

    /// Knowledge from elsewhere, less what keeps its name.
    fn of_known(&self, global: &DVector<f64>, sum: &mut Sum) {
        let Some(known) = &self.problem.known else { return };
        let all = global.dot(&(&known.information * global));
        let mut named = Sum::default();
        for prior in self.told.iter().flat_map(|told| &told.priors) {
            named.add((self.naming.prior)(prior.name), of_prior(prior, global));
        }
        for (block, solved, observed) in self.told.iter().flat_map(|told| &told.blocks) {
            let answered = answered(solved, global, &DVector::zeros(0));
            of_block(block, &-answered, observed, &mut named);
        }
        let rest = (all - named.total()).max(0.0);
        named.0.into_iter().for_each(|(source, variance)| sum.add(source, variance));
        sum.add(self.naming.known, rest);
    }

    /// The group that the function is of.
    fn of_own(&self, group: usize, answer: &Answer, observed: &[(usize, DMatrix<f64>)], sum: &mut Sum) {
        let (given, solved) = (&self.problem.groups[group], &self.fit.groups[group]);
        for prior in &given.priors {
            sum.add((self.naming.prior)(prior.name), of_prior(prior, &answer.local));
        }
        for (k, (block, fit)) in given.blocks.iter().zip(&solved.blocks).enumerate() {
            let mut answered = -answered(fit, &answer.global, &answer.local);
            for (_, derivative) in observed.iter().filter(|(index, _)| *index == k) {
                answered += &fit.conditional * derivative.column(0);
            }
            of_block(block, &answered, &(self.naming.observations)(group, k), sum);
        }
    }

    /// The other groups, whose own parameters follow the global ones.
    fn of_others(&self, group: usize, global: &DVector<f64>, sum: &mut Sum) {
        if self.of_groups.is_empty() {
            return;
        }
        let mut own = Sum::default();
        let local = &self.fit.groups[group].sensitivity * global;
        self.of_own(group, &Answer { global: global.clone(), local }, &[], &mut own);
        for (source, information) in &self.of_groups {
            let all = global.dot(&(information * global));
            let own = own.0.iter().find(|(name, _)| name == source).map_or(0.0, |(_, variance)| *variance);
            sum.add(source, (all - own).max(0.0));
        }
    }

    /// Per source the information of all groups on the global parameters.
    fn informed(&self) -> Vec<(&'static str, DMatrix<f64>)> {
        let p = self.fit.global.len();
        let mut all: Vec<(&'static str, DMatrix<f64>)> = vec![];
        for (index, (group, solved)) in self.problem.groups.iter().zip(&self.fit.groups).enumerate() {
            for (source, rows) in self.rows(index, group, solved) {
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
    fn rows(&self, index: usize, group: &Group, solved: &GroupFit) -> Vec<(&'static str, DMatrix<f64>)> {
        let mut all = vec![];
        for prior in &group.priors {
            let rows = whitened(&prior.covariance) * solved.sensitivity.select_rows(&prior.columns);
            stacked(&mut all, (self.naming.prior)(prior.name), &rows);
        }
        for (k, (block, fit)) in group.blocks.iter().zip(&solved.blocks).enumerate() {
            let lin = &fit.linearised;
            let mut by_global = &lin.local * &solved.sensitivity;
            for (column, values) in lin.columns.iter().zip(lin.global.column_iter()) {
                by_global.column_mut(*column).axpy(1.0, &values, 1.0);
            }
            for (source, places) in (self.naming.observations)(index, k) {
                let (first, count) = (places.start, places.len());
                let covariance = block.covariance.view((first, first), (count, count)).into_owned();
                let gain = fit.gain.rows(first, count);
                stacked(&mut all, source, &(whitened(&covariance) * gain * &by_global));
            }
        }
        all.into_iter().map(|(source, rows)| (source, DMatrix::from_rows(&rows))).collect()
    }

    /// The function's variance under the condition that the parameters of a name are known.
    fn if_known(&self, group: usize, answer: &Answer, source: &'static str, total: f64) -> Option<f64> {
        let of = |priors: &[Prior]| -> Vec<usize> {
            let named = priors.iter().filter(|prior| (self.naming.prior)(prior.name) == source);
            named.flat_map(|prior| prior.columns.clone()).collect()
        };
        let told = self.told.map_or(&[][..], |told| &told.priors);
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
fn of_prior(prior: &Prior, answer: &DVector<f64>) -> f64 {
    let of = answer.select_rows(&prior.columns);
    inverse(&prior.covariance).map_or(0.0, |weight| of.dot(&(weight * &of)))
}

/// `Q B' M^-1 (A, L) q` of a block.
fn answered(block: &BlockFit, global: &DVector<f64>, local: &DVector<f64>) -> DVector<f64> {
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
fn of_block(block: &Block, answered: &DVector<f64>, observed: &[Observed], sum: &mut Sum) {
    for (source, places) in observed {
        let (first, count) = (places.start, places.len());
        let covariance = block.covariance.view((first, first), (count, count)).into_owned();
        let of = answered.rows(first, count);
        sum.add(source, inverse(&covariance).map_or(0.0, |weight| of.dot(&(weight * of))));
    }
}

/// `W` with `W' W` the inverse of a covariance; 0 where it has none.
fn whitened(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let mut lower = covariance.clone();
    if !cholesky(&mut lower) {
        return DMatrix::zeros(covariance.nrows(), covariance.ncols());
    }
    invert_lower(&mut lower);
    lower
}

type Rows = Vec<nalgebra::RowDVector<f64>>;

fn stacked(all: &mut Vec<(&'static str, Rows)>, source: &'static str, rows: &DMatrix<f64>) {
    let at = all.iter().position(|(name, _)| *name == source).unwrap_or_else(|| {
        all.push((source, vec![]));
        all.len() - 1
    });
    all[at].1.extend(rows.row_iter().map(|row| row.into_owned()));
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::estimation::{EstimationError, GroupPoint, Linearised, solve_groups};

    /// Three global parameters, a local one per group, two observations per block of which the second is a survey's.
    fn problem() -> Problem {
        let block = |k: usize| Block {
            observed: DVector::from_vec(vec![0.1 * k as f64, 0.2]),
            covariance: DMatrix::from_row_slice(2, 2, &[0.01, 0.0, 0.0, 0.04]),
        };
        let group = |g: usize| Group {
            local: DVector::zeros(1),
            priors: vec![Prior::scalar("drift", 0, 0.0, 0.3)],
            blocks: (0..4).map(|k| block(g + k)).collect(),
        };
        Problem {
            start: DVector::zeros(3),
            missing: vec!["a"; 3],
            priors: vec![
                Prior::scalar("root", 0, 0.0, 0.5),
                Prior::centred("lens", 1, DMatrix::from_row_slice(2, 2, &[0.09, 0.02, 0.02, 0.04])),
            ],
            known: None,
            groups: (0..3).map(group).collect(),
        }
    }

    fn linearise(at: &GroupPoint, blocks: &mut Vec<Linearised>) -> Result<(), EstimationError> {
        blocks.clear();
        for (k, observed) in at.observed.iter().enumerate() {
            let (g, t) = (at.group as f64, k as f64);
            let global = DMatrix::from_row_slice(1, 3, &[1.0 + 0.2 * g, t, 0.3 - 0.1 * t * g]);
            let local = DMatrix::from_row_slice(1, 1, &[0.7 + 0.2 * t]);
            let observations = DMatrix::from_row_slice(1, 2, &[-1.0, 0.5]);
            let misclosure = &global * at.global + &local * at.local + &observations * observed;
            blocks.push(Linearised { misclosure, columns: vec![0, 1, 2], global, local, observations });
        }
        Ok(())
    }

    fn named(_: usize, _: usize) -> Vec<Observed> {
        vec![("image", 0..1), ("survey", 1..2)]
    }

    /// A function of everything in group 1.
    fn gradient() -> Gradient {
        Gradient {
            columns: vec![2, 0],
            global: DMatrix::from_column_slice(2, 1, &[0.4, 1.0]),
            local: DMatrix::from_element(1, 1, 0.6),
            observed: vec![(2, DMatrix::from_column_slice(2, 1, &[0.3, -0.8]))],
        }
    }

    fn value(problem: &Problem) -> f64 {
        let fit = solve_groups(problem, linearise).unwrap();
        let seen = &problem.groups[1].blocks[2].observed + &fit.groups[1].blocks[2].residuals;
        0.4 * fit.global[2] + fit.global[0] + 0.6 * fit.groups[1].local[0] + 0.3 * seen[0] - 0.8 * seen[1]
    }

    /// What each source does to the function, found by changing what is given by its standard deviations.
    #[test]
    fn each_part_is_what_errors_of_that_source_do() {
        let problem = problem();
        let fit = solve_groups(&problem, linearise).unwrap();
        let naming = Naming { observations: &named, prior: |name| name, known: "earlier" };
        let parts = Sources::new(&problem, &fit, naming, None).parts(1, &gradient());
        let nominal = value(&problem);
        let done = |change: &dyn Fn(&mut Problem, f64), covariance: f64| {
            let mut other = problem.clone();
            change(&mut other, 1e-3);
            ((value(&other) - nominal) / 1e-3).powi(2) * covariance
        };
        let mut expected = [("image", 0.0), ("survey", 0.0), ("drift", 0.0), ("root", 0.0)];
        for g in 0..3 {
            for k in 0..4 {
                expected[0].1 += done(&|p, by| p.groups[g].blocks[k].observed[0] += by, 0.01);
                expected[1].1 += done(&|p, by| p.groups[g].blocks[k].observed[1] += by, 0.04);
            }
            expected[2].1 += done(&|p, by| p.groups[g].priors[0].mean[0] += by, 0.09);
        }
        expected[3].1 = done(&|p, by| p.priors[0].mean[0] += by, 0.25);
        for (source, variance) in expected {
            let part = parts.iter().find(|part| part.source == source).unwrap();
            assert!((part.variance / variance - 1.0).abs() < 1e-6, "{source}: {} {variance}", part.variance);
        }
        let sum: f64 = parts.iter().map(|part| part.variance).sum();
        let all = fit.variances_of(1, &gradient())[0];
        assert!((sum / all - 1.0).abs() < 1e-9, "{sum} {all}");
    }

    #[test]
    fn what_is_known_brings_what_a_narrow_prior_brings() {
        let mut problem = problem();
        let fit = solve_groups(&problem, linearise).unwrap();
        let naming = Naming { observations: &named, prior: |name| name, known: "earlier" };
        let parts = Sources::new(&problem, &fit, naming, None).parts(1, &gradient());
        let of = |source| parts.iter().find(|part| part.source == source).unwrap().if_known;
        let known = of("root").unwrap();
        assert_eq!(of("image"), None);
        problem.priors[0].covariance[(0, 0)] = 1e-14;
        let narrow = solve_groups(&problem, linearise).unwrap().variances_of(1, &gradient())[0];
        assert!((known / narrow - 1.0).abs() < 1e-6, "{known} {narrow}");
    }

    #[test]
    fn knowledge_taken_over_keeps_the_names_of_what_it_came_from() {
        let problem = problem();
        let fit = solve_groups(&problem, linearise).unwrap();
        let naming = Naming { observations: &named, prior: |name| name, known: "earlier" };
        let told = Told::of(&problem, &fit, |column| column == 0, 0, &naming);
        let next = Problem {
            priors: vec![],
            known: Some(fit.known()),
            groups: vec![problem.groups[1].clone()],
            ..problem.clone()
        };
        let at = |at: &GroupPoint, blocks: &mut Vec<Linearised>| linearise(&GroupPoint { group: 1, ..*at }, blocks);
        let solved = solve_groups(&next, at).unwrap();
        let parts = Sources::new(&next, &solved, naming, Some(&told)).parts(0, &gradient());
        let sum: f64 = parts.iter().map(|part| part.variance).sum();
        let all = solved.variances_of(0, &gradient())[0];
        assert!((sum / all - 1.0).abs() < 1e-9, "{sum} {all}");
        assert!(parts.iter().any(|p| p.source == "root" && p.if_known.is_some()));
        assert!(parts.iter().any(|p| p.source == "earlier" && p.variance > 0.0));
        assert!(parts.iter().all(|p| p.source != "lens"));
    }
}
