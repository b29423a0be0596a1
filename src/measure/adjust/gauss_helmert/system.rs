//! The normal equations at a point of the iteration, and the step that follows from them.

use nalgebra::{DMatrix, DVector};

use super::fit::{BlockFit, Fit, GroupFit};
use super::linear::{factor, inverse, singular};
use super::stack::{Stack, Stacked};
use super::{Block, Group, GroupPoint, Linearised, Prior, Problem};
use crate::measure::adjust::AdjustError;

/// Current values of everything unknown.
pub(super) struct State {
    global: DVector<f64>,
    local: Vec<DVector<f64>>,
    residuals: Vec<Vec<DVector<f64>>>,
}

impl State {
    pub(super) fn start(problem: &Problem, before: Option<&Fit>) -> Self {
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
pub(super) fn residual_change(problem: &Problem, a: &State, b: &State) -> f64 {
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
pub(super) struct BlockSystem {
    pub(super) linearised: Linearised,
    /// w = f(l0) + B (l - l0).
    pub(super) contradiction: DVector<f64>,
    /// W, lower triangular; M^-1 = W' W.
    pub(super) whitener: DMatrix<f64>,
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

pub(super) struct System {
    pub(super) normal: DMatrix<f64>,
    right: DVector<f64>,
    pub(super) omega: f64,
    omega_priors: f64,
    /// f' M^-1 f at the adjusted observations: 0 where the conditions hold exactly.
    pub(super) unclosed: f64,
    groups: Vec<GroupSystem>,
}

impl System {
    pub(super) fn assemble(
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
        let mut stack = Stack::new(q);
        for ((block, residuals), linearised) in group.blocks.iter().zip(residuals).zip(blocks) {
            part.blocks.push(stack.push(block, residuals, linearised)?);
        }
        let stacked = stack.finish(&part.blocks);
        self.add_stacked(&mut part, &stacked);
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

    /// Adds a group's products to the normal equations.
    fn add_stacked(&mut self, part: &mut GroupSystem, stacked: &Stacked) {
        let (q, columns) = (part.local_right.len(), &stacked.shared);
        let product = &stacked.product;
        let last = q + columns.len();
        self.omega += product[(last, last)];
        self.unclosed += stacked.unclosed;
        part.local_normal.copy_from(&product.view((0, 0), (q, q)));
        part.local_right.copy_from(&product.view((0, last), (q, 1)));
        part.local_right.neg_mut();
        for (j, &column) in columns.iter().enumerate() {
            let from = product.column(q + j);
            self.right[column] -= product[(last, q + j)];
            part.coupling.column_mut(column).copy_from(&from.rows(0, q));
            columns.iter().enumerate().for_each(|(i, &row)| self.normal[(row, column)] += from[q + i]);
        }
        for own in &stacked.own {
            for (a, &column) in own.columns.iter().enumerate() {
                let with = own.with_stack.column(a);
                self.right[column] -= with[last];
                let mut coupling = part.coupling.column_mut(column);
                coupling += with.rows(0, q);
                for (i, &row) in columns.iter().enumerate() {
                    self.normal[(row, column)] += with[q + i];
                    self.normal[(column, row)] += with[q + i];
                }
                for (b, &row) in own.columns.iter().enumerate() {
                    self.normal[(row, column)] += own.square[(b, a)];
                }
            }
        }
    }

    /// The global step, damped after Levenberg and Marquardt.
    pub(super) fn step(&self, problem: &Problem, damping: f64) -> Result<DVector<f64>, AdjustError> {
        let mut normal = self.normal.clone();
        for i in 0..normal.nrows() {
            normal[(i, i)] *= 1.0 + damping;
        }
        Ok(factor(&normal, &problem.missing)?.solve(&self.right))
    }

    /// All unknowns after a global step: local parameters and residuals follow from it.
    pub(super) fn moved(&self, problem: &Problem, state: &State, step: &DVector<f64>) -> State {
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
                let weighted = system.whitener.tr_mul(&(&system.whitener * w));
                -(&block.covariance * lin.observations.tr_mul(&weighted))
            });
            next.residuals.push(residuals.collect());
            next.local.push(local + local_step);
        }
        next
    }

    pub(super) fn finish(
        self,
        problem: &Problem,
        state: State,
        iterations: usize,
    ) -> Result<Fit, AdjustError> {
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
    let gain = &q_bt * system.whitener.tr_mul(&system.whitener);
    let conditional = &block.covariance - &gain * q_bt.transpose();
    BlockFit { residuals, linearised: system.linearised, gain, conditional }
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
