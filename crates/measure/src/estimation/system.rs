//! The normal equations at a point of the iteration, and the step that follows from them.

use nalgebra::{DMatrix, DVector};

use super::error::EstimationResult;
use super::fit::{BlockFit, Fit, GroupFit};
use super::linear::{
    NormalFactor, add_scaled, add_square, dot_product, factor_in_place, factor_normal_matrix,
    invert_lower, singular_error,
};
use super::prior::{add_prior, prior_weights};
use super::problem::{Block, Group, GroupPoint, Linearised, Problem};
use super::stack::{BlockStack, BlockSystem, ProductTarget, Workspace};
use super::state::EstimationState;

/// Largest increase of the sum of squares by a step, as a fraction of the part that is not settled.
const OPEN_FRACTION: f64 = 0.1;
/// Relative increase of the sum of squares that rounding may cause.
const ROUNDING: f64 = 1e-9;

/// Equations of one group with its local parameters eliminated: `L' M^-1 L = C C'` with its priors.
struct GroupSystem {
    linearised: Vec<Linearised>,
    /// Stack of the blocks, created at the first point.
    stack: Option<BlockStack>,
    /// Inverses of the priors' covariances.
    weights: Vec<DMatrix<f64>>,
    /// Matrix `C`, lower triangle.
    factor: DMatrix<f64>,
    /// Matrix `(C^-1 L' M^-1 A)'`, global x local.
    coupling: DMatrix<f64>,
    /// Vector `-C^-1 L' M^-1 w`.
    right: DVector<f64>,
}

/// Normal equations at a point.
pub(super) struct NormalEquations {
    pub(super) normal: DMatrix<f64>,
    pub(super) right: DVector<f64>,
    pub(super) omega: f64,
    omega_priors: f64,
    /// Misclosure `f' M^-1 f` at the adjusted observations: 0 if the conditions hold exactly.
    pub(super) unclosed: f64,
    /// Whether several groups have parameters of their own.
    pub(super) several_own: bool,
    /// Decrease of the sum of squares that the groups' own parameters can still bring, if several groups have some.
    pub(super) unsettled: f64,
    /// Rounding error of the sum of squares: precise priors on differences make large terms cancel in it.
    pub(super) rounding: f64,
    /// Inverses of the priors' covariances.
    weights: Vec<DMatrix<f64>>,
    groups: Vec<GroupSystem>,
    workspace: Workspace,
}

impl NormalEquations {
    /// Allocates a problem's normal equations.
    pub(super) fn new(problem: &Problem) -> EstimationResult<Self> {
        let p = problem.start.len();
        let group = |group: &Group| -> EstimationResult<GroupSystem> {
            let q = group.local.len();
            Ok(GroupSystem {
                linearised: Vec::with_capacity(group.blocks.len()),
                stack: None,
                weights: prior_weights(&group.priors)?,
                factor: DMatrix::zeros(q, q),
                coupling: DMatrix::zeros(p, q),
                right: DVector::zeros(q),
            })
        };
        Ok(Self {
            normal: DMatrix::zeros(p, p),
            right: DVector::zeros(p),
            omega: 0.0,
            omega_priors: 0.0,
            unclosed: 0.0,
            several_own: problem
                .groups
                .iter()
                .filter(|group| !group.local.is_empty())
                .count()
                > 1,
            unsettled: 0.0,
            rounding: 0.0,
            weights: prior_weights(&problem.priors)?,
            groups: problem.groups.iter().map(group).collect::<Result<_, _>>()?,
            workspace: Workspace::default(),
        })
    }

    /// Computes the equations at a point.
    pub(super) fn assemble(
        &mut self,
        problem: &Problem,
        state: &EstimationState,
        linearise: &impl Fn(&GroupPoint, &mut Vec<Linearised>) -> EstimationResult<()>,
    ) -> EstimationResult<()> {
        self.normal.as_mut_slice().fill(0.0);
        self.right.as_mut_slice().fill(0.0);
        (self.omega, self.omega_priors, self.unclosed, self.unsettled) = (0.0, 0.0, 0.0, 0.0);
        for index in 0..problem.groups.len() {
            self.add_group(&problem.groups[index], state, index, linearise)?;
        }
        self.normal.fill_upper_triangle_with_lower_triangle();
        for (prior, weight) in problem.priors.iter().zip(&self.weights) {
            self.omega_priors += add_prior(
                prior,
                weight,
                &state.global,
                &mut self.normal,
                &mut self.right,
            );
        }
        if let Some(known) = &problem.known {
            let off = &state.global - &known.mean;
            let weighted = &known.information * &off;
            self.normal += &known.information;
            self.right -= &weighted;
            self.omega_priors += off.dot(&weighted);
            self.rounding = rounding_bound(&known.information, &off);
        }
        self.omega += self.omega_priors;
        Ok(())
    }

    fn add_group(
        &mut self,
        group: &Group,
        state: &EstimationState,
        index: usize,
        linearise: &impl Fn(&GroupPoint, &mut Vec<Linearised>) -> EstimationResult<()>,
    ) -> EstimationResult<()> {
        let (part, local) = (&mut self.groups[index], &state.local[index]);
        let observed = &state.observed[index];
        let at = GroupPoint {
            group: index,
            global: &state.global,
            local,
            observed,
        };
        linearise(&at, &mut part.linearised)?;
        let stack = part
            .stack
            .get_or_insert_with(|| BlockStack::new(local.len(), &part.linearised));
        part.coupling.as_mut_slice().fill(0.0);
        let mut target = ProductTarget {
            normal: &mut self.normal,
            right: &mut self.right,
            coupling: &mut part.coupling,
        };
        let residuals = &state.residuals[index];
        self.unclosed += stack.accumulate_products(
            &group.blocks,
            residuals,
            &part.linearised,
            &mut self.workspace,
            &mut target,
        )?;
        // The stack's own square, lower triangle.
        let (q, width) = (local.len(), stack.width());
        let product = &self.workspace.product;
        let last = width - 1;
        self.omega += product[last * width + last];
        let p = self.right.len();
        for (j, column) in product.chunks_exact(width).enumerate().take(q) {
            part.factor.as_mut_slice()[j * q + j..(j + 1) * q].copy_from_slice(&column[j..q]);
            part.right[j] = -column[last];
            let coupling = &mut part.coupling.as_mut_slice()[j * p..(j + 1) * p];
            stack
                .shared
                .iter()
                .zip(&column[q..])
                .for_each(|(&at, v)| coupling[at] += v);
        }
        for (j, (&at, column)) in stack
            .shared
            .iter()
            .zip(product.chunks_exact(width).skip(q))
            .enumerate()
        {
            self.right[at] -= column[last];
            let normal = &mut self.normal.as_mut_slice()[at * p..(at + 1) * p];
            stack
                .shared
                .iter()
                .zip(&column[q..])
                .skip(j)
                .for_each(|(&i, v)| normal[i] += v);
        }
        for (prior, weight) in group.priors.iter().zip(&part.weights) {
            self.omega_priors += add_prior(prior, weight, local, &mut part.factor, &mut part.right);
        }
        if q > 0 {
            part.eliminate_local(&mut self.right)?;
            if self.several_own {
                self.unsettled += part.right.norm_squared();
            }
            let coupling = part.coupling.as_slice();
            add_square(self.normal.as_mut_slice(), -1.0, coupling, p);
        }
        Ok(())
    }

    /// Returns the global step, damped after Levenberg and Marquardt.
    pub(super) fn global_step(
        &self,
        problem: &Problem,
        damping: f64,
    ) -> EstimationResult<DVector<f64>> {
        if damping == 0.0 {
            return self.solve_right_side(problem, &self.right);
        }
        let mut normal = self.normal.clone();
        for i in 0..normal.nrows() {
            normal[(i, i)] *= 1.0 + damping;
        }
        Ok(factor_normal_matrix(&normal, &problem.missing)?.solve(&self.right))
    }

    /// Returns the sum of squares with the groups' own parameters settled, to first order in them.
    pub(super) fn settled_omega(&self) -> f64 {
        self.omega - self.unsettled
    }

    /// Returns the uncertainty of [`Self::settled_omega`]: it is of first order in the unsettled part, and rounding changes
    /// it by far less than a standard deviation does.
    pub(super) fn omega_tolerance(&self) -> f64 {
        OPEN_FRACTION * (self.unclosed + self.unsettled) + ROUNDING * (1.0 + self.omega)
    }

    /// Returns the undamped step for another right side.
    pub(super) fn solve_right_side(
        &self,
        problem: &Problem,
        right: &DVector<f64>,
    ) -> EstimationResult<DVector<f64>> {
        Ok(self.factor(problem)?.solve(right))
    }

    /// Factors the normal matrix.
    pub(super) fn factor(&self, problem: &Problem) -> EstimationResult<NormalFactor> {
        factor_normal_matrix(&self.normal, &problem.missing)
    }

    /// Writes all unknowns after a global step into `next`; local parameters and residuals follow from it.
    pub(super) fn apply_step(
        &self,
        problem: &Problem,
        state: &EstimationState,
        step: &DVector<f64>,
        next: &mut EstimationState,
    ) {
        next.global.copy_from(&state.global);
        next.global += step;
        let mut work = vec![];
        for (index, (part, group)) in self.groups.iter().zip(&problem.groups).enumerate() {
            let local_step = part.solve_local_step(step);
            next.local[index].copy_from(&state.local[index]);
            next.local[index] += &local_step;
            let systems = part.stack.iter().flat_map(|s| &s.blocks);
            for (k, (system, lin)) in systems.zip(&part.linearised).enumerate() {
                let residuals = &mut next.residuals[index][k];
                system.update_residuals(
                    lin,
                    &group.blocks[k],
                    step,
                    &local_step,
                    &mut work,
                    residuals,
                );
                let observed = &mut next.observed[index][k];
                observed.copy_from(&group.blocks[k].observed);
                *observed += &*residuals;
            }
        }
    }

    /// Returns the solution at a state. `second`: half the second derivative of the settled sum of squares, if it differs
    /// from the normal matrix. Its inverse is the derivative of a parameter with respect to errors, whose size the normal
    /// matrix describes (White 1982).
    pub(super) fn into_fit(
        self,
        problem: &Problem,
        state: EstimationState,
        iterations: usize,
        second: Option<DMatrix<f64>>,
    ) -> EstimationResult<Fit> {
        let inverse = self.factor(problem)?.inverse();
        let (response, covariance, information) = match second {
            Some(second) => {
                let response = factor_normal_matrix(&second, &problem.missing)?.inverse();
                let covariance = &response * &self.normal * &response;
                (response, covariance, &second * inverse * &second)
            }
            None => (inverse.clone(), inverse, self.normal),
        };
        let priors = problem
            .priors
            .iter()
            .chain(problem.groups.iter().flat_map(|g| &g.priors));
        let mut conditions: usize = priors.map(|p| p.columns.len()).sum();
        conditions += problem.known.as_ref().map_or(0, |known| known.conditions);
        let mut unknowns = state.global.len();
        let mut groups = Vec::with_capacity(self.groups.len());
        let states = state.local.into_iter().zip(state.residuals);
        for ((part, group), (local, residuals)) in
            self.groups.into_iter().zip(&problem.groups).zip(states)
        {
            unknowns += local.len();
            conditions += part
                .linearised
                .iter()
                .map(|b| b.misclosure.len())
                .sum::<usize>();
            groups.push(part.into_group_fit(group, local, residuals, &covariance));
        }
        Ok(Fit {
            global: state.global,
            covariance,
            response,
            information,
            groups,
            omega: self.omega,
            omega_priors: self.omega_priors,
            redundancy: conditions.saturating_sub(unknowns),
            iterations,
        })
    }
}

impl GroupSystem {
    /// Factors the local parameters' normal matrix and eliminates them from the right side.
    fn eliminate_local(&mut self, right: &mut DVector<f64>) -> EstimationResult<()> {
        if !factor_in_place(&mut self.factor) {
            return Err(singular_error(
                "the local parameters of a group of observations",
            ));
        }
        let p = self.coupling.nrows();
        for i in 0..self.right.len() {
            let (done, rest) = self.coupling.as_mut_slice().split_at_mut(i * p);
            let column = &mut rest[..p];
            let mut value = self.right[i];
            for k in 0..i {
                let by = self.factor[(i, k)];
                add_scaled(column, -by, &done[k * p..(k + 1) * p]);
                value -= by * self.right[k];
            }
            let inverse = 1.0 / self.factor[(i, i)];
            column.iter_mut().for_each(|v| *v *= inverse);
            self.right[i] = value * inverse;
            add_scaled(right.as_mut_slice(), -self.right[i], column);
        }
        Ok(())
    }

    fn solve_local_step(&self, step: &DVector<f64>) -> DVector<f64> {
        let mut local = self.right.clone();
        for i in (0..local.len()).rev() {
            let known: f64 = (i + 1..local.len())
                .map(|k| self.factor[(k, i)] * local[k])
                .sum();
            let by_global = dot_product(self.coupling.column(i).as_slice(), step.as_slice());
            local[i] = (local[i] - by_global - known) / self.factor[(i, i)];
        }
        local
    }

    fn into_group_fit(
        mut self,
        group: &Group,
        local: DVector<f64>,
        residuals: Vec<DVector<f64>>,
        covariance: &DMatrix<f64>,
    ) -> GroupFit {
        invert_lower(&mut self.factor);
        let sensitivity = -(self.factor.transpose() * self.coupling.transpose());
        let conditional = self.factor.transpose() * &self.factor;
        let cross = &sensitivity * covariance;
        let systems = self.stack.into_iter().flat_map(|s| s.blocks);
        let blocks = self
            .linearised
            .into_iter()
            .zip(systems)
            .zip(&group.blocks)
            .zip(residuals);
        let blocks = blocks.map(|(((lin, system), block), residuals)| {
            system.into_block_fit(lin, block, residuals)
        });
        GroupFit {
            local,
            covariance: &cross * sensitivity.transpose() + &conditional,
            cross,
            sensitivity,
            conditional,
            blocks: blocks.collect(),
        }
    }
}

impl BlockSystem {
    /// Computes `v = -Q B' M^-1 (A dx + L dd + w)`.
    fn update_residuals(
        &self,
        lin: &Linearised,
        block: &Block,
        step: &DVector<f64>,
        local_step: &DVector<f64>,
        work: &mut Vec<f64>,
        into: &mut DVector<f64>,
    ) {
        let n = self.contradiction.len().max(1);
        work.clear();
        work.extend_from_slice(self.contradiction.as_slice());
        for (by, &moved) in lin
            .local
            .as_slice()
            .chunks_exact(n)
            .zip(local_step.as_slice())
        {
            add_scaled(work, moved, by);
        }
        for (by, &column) in lin.global.as_slice().chunks_exact(n).zip(&lin.columns) {
            add_scaled(work, step[column], by);
        }
        self.whitener.apply_weight(work);
        into.as_mut_slice().fill(0.0);
        let observations = lin.observations.as_slice().chunks_exact(n);
        for (by, covariance) in
            observations.zip(block.covariance.as_slice().chunks_exact(into.len()))
        {
            add_scaled(into.as_mut_slice(), -dot_product(by, work), covariance);
        }
    }

    fn into_block_fit(
        self,
        linearised: Linearised,
        block: &Block,
        residuals: DVector<f64>,
    ) -> BlockFit {
        let (n, m) = linearised.observations.shape();
        // (Q B')', one row per observation.
        let mut products = vec![0.0; n * m];
        let row = n.max(1);
        for (product, covariance) in products
            .chunks_exact_mut(row)
            .zip(block.covariance.as_slice().chunks_exact(m))
        {
            let observations = linearised.observations.as_slice().chunks_exact(row);
            for (by, &covariance) in observations.zip(covariance).filter(|(_, c)| **c != 0.0) {
                add_scaled(product, covariance, by);
            }
        }
        let mut gain = DMatrix::zeros(m, n);
        let mut conditional = block.covariance.clone();
        let mut weighed = vec![0.0; n];
        for (i, product) in products.chunks_exact(row).enumerate() {
            weighed.copy_from_slice(product);
            self.whitener.apply_weight(&mut weighed);
            weighed
                .iter()
                .enumerate()
                .for_each(|(k, w)| gain[(i, k)] = *w);
            for (j, other) in products.chunks_exact(row).enumerate() {
                conditional[(i, j)] -= dot_product(&weighed, other);
            }
        }
        BlockFit {
            residuals,
            linearised,
            gain,
            conditional,
        }
    }
}

/// Returns a bound of the rounding error of a sum of squares: for a sum of n terms, n times the machine precision times
/// their absolute values (Higham 2002, 3.1).
fn rounding_bound(information: &DMatrix<f64>, off: &DVector<f64>) -> f64 {
    let absolute = off.abs();
    off.len() as f64 * f64::EPSILON * absolute.dot(&(information.abs() * &absolute))
}
