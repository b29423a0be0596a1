//! The Gauss-Helmert engine on which every adjustment stands.
//!
//! Conditions `f(x, d, l + v) = 0` between global parameters `x`, parameters `d` local to a group
//! (a marker's distance, a frame's amplitude) and observations `l` with residuals `v`; minimised
//! is `v' Q^-1 v` plus the priors' share (Koch, *Parameter Estimation and Hypothesis Testing in
//! Linear Models*; Niemeier, *Ausgleichungsrechnung*). Work goes block by block: `(B Q B')^-1` is as
//! large as one block, a group's local parameters leave by their Schur complement, so the cost is
//! linear in the number of groups.
//!
//! ```text
//! linearised:   A dx + L dd + B v + w = 0      w = f(x, d, l0) + B (l - l0)
//! M = B Q B'    N = sum A' M^-1 A - (A' M^-1 L)(L' M^-1 L)^-1(L' M^-1 A) + priors
//! v = -Q B' M^-1 (A dx + L dd + w)
//! ```
//!
//! How to use it: fill a [`Problem`], give [`solve`] a closure that returns a [`Linearised`] block
//! at a [`Point`], and read the [`Fit`]; [`Fit::propagate`] carries covariance to any function of
//! parameters, local parameters and adjusted observations.

mod linear;

use nalgebra::{DMatrix, DVector};

use self::linear::{add_product, factor, inverse, singular};
use super::AdjustError;

const MAX_ITERATIONS: usize = 60;
/// Squared length of the last step in standard deviations, and of the unclosed conditions.
const CONVERGED: f64 = 1e-12;
/// The same for a solution that only decides what the next one looks like: the last step is a tenth
/// of a standard deviation, what it leaves is a hundredth.
const ROUGH: f64 = 1e-2;
/// Rise of the sum of squares that a step may cause, over the sum that is still open.
const OPEN_SHARE: f64 = 0.1;
/// Relative rise of the sum of squares that rounding may cause.
const ROUNDING: f64 = 1e-9;

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
    /// Which parameters.
    pub columns: Vec<usize>,
    /// Their expected values.
    pub mean: DVector<f64>,
    /// Covariance of the expectation.
    pub covariance: DMatrix<f64>,
}

impl Prior {
    /// A prior on one parameter.
    pub fn scalar(column: usize, mean: f64, sigma: f64) -> Self {
        Self {
            columns: vec![column],
            mean: DVector::from_element(1, mean),
            covariance: DMatrix::from_element(1, 1, sigma * sigma),
        }
    }
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

/// State of one block at the solution.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockFit {
    /// Adjusted less observed.
    pub residuals: DVector<f64>,
    /// The conditions' derivatives at the solution.
    pub linearised: Linearised,
    /// Q B' M^-1: minus the residuals' answer to the conditions.
    gain: DMatrix<f64>,
    /// Q - Q B' M^-1 B Q: covariance of the adjusted observations for given parameters.
    conditional: DMatrix<f64>,
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
    cross: DMatrix<f64>,
    /// Covariance of the local parameters.
    covariance: DMatrix<f64>,
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
        covariance += &global * shared * global.transpose();
        if local.ncols() > 0 {
            let fit = &self.groups[group];
            let mixed = &local * fit.cross.select_columns(&columns) * global.transpose();
            covariance += &local * &fit.covariance * local.transpose() + mixed.transpose() + mixed;
        }
        covariance
    }

    /// Covariance of a block's adjusted observations, a priori.
    pub fn adjusted_covariance(&self, group: usize, block: usize) -> DMatrix<f64> {
        let n = self.groups[group].blocks[block].residuals.len();
        let gradient = Gradient {
            global: DMatrix::zeros(n, self.global.len()),
            local: DMatrix::zeros(n, self.groups[group].local.len()),
            observed: vec![(block, DMatrix::identity(n, n))],
        };
        self.covariance_of(group, &gradient)
    }
}

/// Minimises the problem. `linearise` gives a block's conditions at a point.
pub fn solve(
    problem: &Problem,
    linearise: impl Fn(&Point) -> Result<Linearised, AdjustError>,
) -> Result<Fit, AdjustError> {
    solve_groups(problem, |at| {
        let point = |(block, observed)| Point {
            group: at.group,
            block,
            global: at.global,
            local: at.local,
            observed,
        };
        at.observed.iter().enumerate().map(|b| linearise(&point(b))).collect()
    })
}

/// As [`solve`], for models whose blocks share work: `linearise` gives all blocks of a group.
pub fn solve_groups(
    problem: &Problem,
    linearise: impl Fn(&GroupPoint) -> Result<Vec<Linearised>, AdjustError>,
) -> Result<Fit, AdjustError> {
    solve_from(problem, &Course::default(), linearise)
}

/// How far a solution is carried, and what is known before.
#[derive(Clone, Copy, Debug, Default)]
pub struct Course<'a> {
    /// Stop within a hundredth of a standard deviation.
    pub rough: bool,
    /// Residuals of an earlier solution to start from, where its blocks are the same.
    pub residuals: Option<&'a Fit>,
}

/// As [`solve_groups`], on a given course.
pub fn solve_from(
    problem: &Problem,
    course: &Course,
    linearise: impl Fn(&GroupPoint) -> Result<Vec<Linearised>, AdjustError>,
) -> Result<Fit, AdjustError> {
    let converged = if course.rough { ROUGH } else { CONVERGED };
    let mut state = State::start(problem, course.residuals);
    let mut system = System::assemble(problem, &state, &linearise)?;
    let mut damping = 0.0;
    for iteration in 1..=MAX_ITERATIONS {
        let step = system.step(problem, damping)?;
        let next_state = system.moved(problem, &state, &step);
        let next = System::assemble(problem, &next_state, &linearise);
        let moved = step.dot(&(&system.normal * &step)) + residual_change(problem, &state, &next_state);
        let settled = moved <= converged;
        // The sum of squares holds to first order in the conditions that are still open, and rounding
        // lets it waver far below what a standard deviation can tell.
        let limit = system.omega + OPEN_SHARE * system.unclosed + ROUNDING * (1.0 + system.omega);
        let accepted = next.as_ref().is_ok_and(|n| n.omega.is_finite() && (n.omega <= limit || settled));
        if !accepted {
            damping = if damping == 0.0 { 1e-3 } else { damping * 10.0 };
            if damping > 1e12 {
                return Err(next.err().unwrap_or(AdjustError::NoConvergence { iterations: iteration }));
            }
            continue;
        }
        (state, system) = (next_state, next?);
        if settled && system.unclosed <= converged {
            return system.finish(problem, state, iteration);
        }
        damping = if damping < 1e-6 { 0.0 } else { damping * 0.1 };
    }
    Err(AdjustError::NoConvergence { iterations: MAX_ITERATIONS })
}

/// Current values of everything unknown.
struct State {
    global: DVector<f64>,
    local: Vec<DVector<f64>>,
    residuals: Vec<Vec<DVector<f64>>>,
}

impl State {
    fn start(problem: &Problem, before: Option<&Fit>) -> Self {
        let residuals = |(index, group): (usize, &Group)| {
            let before = before.and_then(|fit| fit.groups.get(index));
            let before = before.filter(|b| b.blocks.len() == group.blocks.len());
            let of_block = |(k, block): (usize, &Block)| {
                let old = before.map(|b| &b.blocks[k].residuals).filter(|v| v.len() == block.observed.len());
                old.cloned().unwrap_or_else(|| DVector::zeros(block.observed.len()))
            };
            group.blocks.iter().enumerate().map(of_block).collect()
        };
        Self {
            global: problem.start.clone(),
            local: problem.groups.iter().map(|g| g.local.clone()).collect(),
            residuals: problem.groups.iter().enumerate().map(residuals).collect(),
        }
    }
}

/// Squared change of the residuals, in standard deviations: they steer where the conditions are
/// linearised, so parameters at rest are not enough.
fn residual_change(problem: &Problem, a: &State, b: &State) -> f64 {
    let mut sum = 0.0;
    for (group, (ra, rb)) in problem.groups.iter().zip(a.residuals.iter().zip(&b.residuals)) {
        for (block, (va, vb)) in group.blocks.iter().zip(ra.iter().zip(rb)) {
            for k in 0..va.len() {
                sum += (va[k] - vb[k]).powi(2) / block.covariance[(k, k)];
            }
        }
    }
    sum
}

/// One block's part of the normal equations.
struct BlockSystem {
    linearised: Linearised,
    /// w = f(l0) + B (l - l0).
    contradiction: DVector<f64>,
    /// M^-1.
    weight: DMatrix<f64>,
}

/// One group's part, local parameters still inside.
struct GroupSystem {
    blocks: Vec<BlockSystem>,
    /// (L' M^-1 L)^-1.
    local_inverse: DMatrix<f64>,
    local_normal: DMatrix<f64>,
    /// L' M^-1 A.
    coupling: DMatrix<f64>,
    /// -L' M^-1 w.
    local_right: DVector<f64>,
}

struct System {
    normal: DMatrix<f64>,
    right: DVector<f64>,
    omega: f64,
    omega_priors: f64,
    /// f' M^-1 f at the adjusted observations: 0 where the conditions hold exactly.
    unclosed: f64,
    groups: Vec<GroupSystem>,
}

impl System {
    fn assemble(
        problem: &Problem,
        state: &State,
        linearise: &impl Fn(&GroupPoint) -> Result<Vec<Linearised>, AdjustError>,
    ) -> Result<Self, AdjustError> {
        let p = problem.start.len();
        let mut system = Self {
            normal: DMatrix::zeros(p, p),
            right: DVector::zeros(p),
            omega: 0.0,
            omega_priors: 0.0,
            unclosed: 0.0,
            groups: Vec::with_capacity(problem.groups.len()),
        };
        for index in 0..problem.groups.len() {
            system.add_group(problem, state, index, linearise)?;
        }
        for prior in &problem.priors {
            let share = add_prior(prior, &state.global, &mut system.normal, &mut system.right)?;
            system.omega_priors += share;
        }
        system.omega += system.omega_priors;
        Ok(system)
    }

    fn add_group(
        &mut self,
        problem: &Problem,
        state: &State,
        index: usize,
        linearise: &impl Fn(&GroupPoint) -> Result<Vec<Linearised>, AdjustError>,
    ) -> Result<(), AdjustError> {
        let (group, local) = (&problem.groups[index], &state.local[index]);
        let (p, q) = (problem.start.len(), local.len());
        let mut part = GroupSystem {
            blocks: Vec::with_capacity(group.blocks.len()),
            local_inverse: DMatrix::zeros(q, q),
            local_normal: DMatrix::zeros(q, q),
            coupling: DMatrix::zeros(q, p),
            local_right: DVector::zeros(q),
        };
        let residuals = &state.residuals[index];
        let observed: Vec<_> = group.blocks.iter().zip(residuals).map(|(b, v)| &b.observed + v).collect();
        let blocks =
            linearise(&GroupPoint { group: index, global: &state.global, local, observed: &observed })?;
        for ((block, residuals), linearised) in group.blocks.iter().zip(residuals).zip(blocks) {
            self.add_block(&mut part, block, residuals, linearised)?;
        }
        for prior in &group.priors {
            self.omega_priors += add_prior(prior, local, &mut part.local_normal, &mut part.local_right)?;
        }
        if q > 0 {
            part.local_inverse = inverse(&part.local_normal)
                .ok_or_else(|| singular("the local parameters of a group of observations"))?;
            let reduced = &part.local_inverse * &part.coupling;
            // Transposed first: nalgebra's product is many times faster than its `gemm_tr`.
            self.normal.gemm(-1.0, &part.coupling.transpose(), &reduced, 1.0);
            self.right.gemv_tr(-1.0, &reduced, &part.local_right, 1.0);
        }
        self.groups.push(part);
        Ok(())
    }

    fn add_block(
        &mut self,
        part: &mut GroupSystem,
        block: &Block,
        residuals: &DVector<f64>,
        linearised: Linearised,
    ) -> Result<(), AdjustError> {
        let linearised = trimmed(linearised);
        let b = &linearised.observations;
        let contradiction = &linearised.misclosure - b * residuals;
        let weight = inverse(&(b * &block.covariance * b.transpose()))
            .ok_or_else(|| singular("a condition without an observation of its own"))?;
        let wa = &weight * &linearised.global;
        let ww = &weight * &contradiction;
        self.omega += contradiction.dot(&ww);
        self.unclosed += linearised.misclosure.dot(&(&weight * &linearised.misclosure));
        let columns = &linearised.columns;
        let right = linearised.global.tr_mul(&ww);
        for (i, &ci) in columns.iter().enumerate() {
            self.right[ci] -= right[i];
        }
        add_product(&mut self.normal, Some(columns), Some(columns), &linearised.global, &wa);
        if linearised.local.ncols() > 0 {
            let l = &linearised.local;
            part.local_right -= l.tr_mul(&ww);
            add_product(&mut part.local_normal, None, None, l, &(&weight * l));
            add_product(&mut part.coupling, None, Some(columns), l, &wa);
        }
        part.blocks.push(BlockSystem { linearised, contradiction, weight });
        Ok(())
    }

    /// The global step, damped after Levenberg and Marquardt.
    fn step(&self, problem: &Problem, damping: f64) -> Result<DVector<f64>, AdjustError> {
        let mut normal = self.normal.clone();
        for i in 0..normal.nrows() {
            normal[(i, i)] *= 1.0 + damping;
        }
        Ok(factor(&normal, &problem.missing)?.solve(&self.right))
    }

    /// All unknowns after a global step: local parameters and residuals follow from it.
    fn moved(&self, problem: &Problem, state: &State, step: &DVector<f64>) -> State {
        let mut next = State {
            global: &state.global + step,
            local: Vec::with_capacity(self.groups.len()),
            residuals: Vec::with_capacity(self.groups.len()),
        };
        for ((part, group), local) in self.groups.iter().zip(&problem.groups).zip(&state.local) {
            let local_step = &part.local_inverse * (&part.local_right - &part.coupling * step);
            let residuals = part.blocks.iter().zip(&group.blocks).map(|(system, block)| {
                let lin = &system.linearised;
                let mut w = &system.contradiction + &lin.local * &local_step;
                for (k, &column) in lin.columns.iter().enumerate() {
                    w.axpy(step[column], &lin.global.column(k), 1.0);
                }
                -(&block.covariance * lin.observations.tr_mul(&(&system.weight * w)))
            });
            next.residuals.push(residuals.collect());
            next.local.push(local + local_step);
        }
        next
    }

    fn finish(self, problem: &Problem, state: State, iterations: usize) -> Result<Fit, AdjustError> {
        let covariance = factor(&self.normal, &problem.missing)?.inverse();
        let priors = problem.priors.iter().chain(problem.groups.iter().flat_map(|g| &g.priors));
        let mut conditions: usize = priors.map(|p| p.columns.len()).sum();
        let mut unknowns = state.global.len();
        let mut groups = Vec::with_capacity(self.groups.len());
        let states = state.local.into_iter().zip(state.residuals);
        for ((part, group), (local, residuals)) in self.groups.into_iter().zip(&problem.groups).zip(states) {
            unknowns += local.len();
            conditions += part.blocks.iter().map(|b| b.contradiction.len()).sum::<usize>();
            let blocks = part.blocks.into_iter().zip(&group.blocks).zip(residuals);
            let blocks = blocks.map(|((system, block), residuals)| block_fit(system, block, residuals));
            let sensitivity = -(&part.local_inverse * &part.coupling);
            let cross = &sensitivity * &covariance;
            groups.push(GroupFit {
                local,
                covariance: &cross * sensitivity.transpose() + &part.local_inverse,
                cross,
                sensitivity,
                conditional: part.local_inverse,
                blocks: blocks.collect(),
            });
        }
        Ok(Fit {
            global: state.global,
            covariance,
            groups,
            omega: self.omega,
            omega_priors: self.omega_priors,
            redundancy: conditions.saturating_sub(unknowns),
            iterations,
        })
    }
}

fn block_fit(system: BlockSystem, block: &Block, residuals: DVector<f64>) -> BlockFit {
    let q_bt = &block.covariance * system.linearised.observations.transpose();
    let gain = &q_bt * &system.weight;
    let conditional = &block.covariance - &gain * q_bt.transpose();
    BlockFit { residuals, linearised: system.linearised, gain, conditional }
}

/// Without the parameters that the block does not depend on here.
fn trimmed(mut linearised: Linearised) -> Linearised {
    let used = |k: &usize| linearised.global.column(*k).iter().any(|&v| v != 0.0);
    let keep: Vec<usize> = (0..linearised.columns.len()).filter(used).collect();
    if keep.len() < linearised.columns.len() {
        linearised.global = linearised.global.select_columns(&keep);
        linearised.columns = keep.into_iter().map(|k| linearised.columns[k]).collect();
    }
    linearised
}

/// Adds a prior to normal equations; returns its share of the sum of squares.
fn add_prior(
    prior: &Prior,
    values: &DVector<f64>,
    normal: &mut DMatrix<f64>,
    right: &mut DVector<f64>,
) -> Result<f64, AdjustError> {
    let weight = inverse(&prior.covariance).ok_or_else(|| {
        AdjustError::Input(
            "a prior's covariance is not positive definite; check the standard deviations".into(),
        )
    })?;
    let now = DVector::from_iterator(prior.columns.len(), prior.columns.iter().map(|&c| values[c]));
    let off = now - &prior.mean;
    let weighted = &weight * &off;
    for (i, &ci) in prior.columns.iter().enumerate() {
        right[ci] -= weighted[i];
        for (j, &cj) in prior.columns.iter().enumerate() {
            normal[(ci, cj)] += weight[(i, j)];
        }
    }
    Ok(off.dot(&weighted))
}

#[cfg(test)]
mod tests;
