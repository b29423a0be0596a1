//! Variance components of groups of observations: restricted maximum likelihood (its estimate is that of
//! Koch, 1986), by Fisher scoring in the logarithm of the components.
//!
//! ```text
//! score_i = (v_i' Q_i^-1 v_i - r_i) / 2     r_i = tr(R V_i)     V_i = B_i Q_i B_i'
//! F_ij    = tr(R V_i R V_j) / 2             R   = M^-1 - M^-1 J Qxx J' M^-1
//! ```
//!
//! The logarithm keeps components positive, and the inverse of `F` is their covariance. If the observations
//! do not determine a component, the given standard deviations are kept.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::error::EstimationResult;
use super::fit::{BlockFit, Fit};
use super::problem::{GroupPoint, Linearised, Problem};
use super::solve::{SolveOptions, solve_groups};
use crate::observation::deserialize_or_nan;

/// Variance component of one group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VarianceComponent {
    /// Name of the group: `image` or `survey`.
    pub group: Cow<'static, str>,
    /// Component (1: the group's standard deviations are right), by whose square root they are scaled; `None` if the
    /// observations do not determine it and the given standard deviations were kept.
    pub factor: Option<f64>,
    /// Standard deviation of the component.
    pub sigma_factor: Option<f64>,
    /// Contribution of the group to the redundancy.
    #[serde(deserialize_with = "deserialize_or_nan")]
    pub redundancy: f64,
}

const MAX_ITERATIONS: usize = 40;
/// Iterations after which a component that is still poorly determined is given up.
const MIN_ITERATIONS: usize = 15;
/// Gain in likelihood below which the iteration ends: 0.001 standard deviations, of which Fisher's step leaves a small
/// part.
const MIN_GAIN: f64 = 1e-6;
/// Information added to each component's own, so that a component without any stays unchanged.
const RIDGE: f64 = 0.1;
/// Longest step of the logarithm of a component.
const MAX_STEP: f64 = 1.0;
/// Component below which it counts as zero.
const MIN_COMPONENT: f64 = 1e-3;
/// Largest relative standard deviation of a reported component: that of two redundant observations. It is also assumed for
/// a component that keeps the given standard deviations.
const MAX_RELATIVE_SIGMA: f64 = 1.0;

/// A group of variance: the observations of the blocks that share a component. Groups must not be correlated.
pub struct VarianceGroup<'a> {
    /// Name of the group: `image` or `survey`.
    pub name: &'static str,
    /// Indices of a block's observations that belong to the group, given (group, block).
    pub members: &'a dyn Fn(usize, usize) -> Vec<usize>,
}

/// Estimated components, the fit that uses them, and remarks.
pub struct ComponentEstimate {
    /// Fit of the problem with its covariances scaled.
    pub fit: Fit,
    pub components: Vec<VarianceComponent>,
    /// Sentences, one for each component that could not be estimated.
    pub remarks: Vec<String>,
}

/// Estimates the components, iterated to convergence, and scales the problem's covariances in place. If the iteration does
/// not converge, all covariances stay as given and a remark reports it.
pub fn variance_components(
    problem: &mut Problem,
    groups: &[VarianceGroup],
    linearise: impl Fn(&GroupPoint, &mut Vec<Linearised>) -> EstimationResult<()>,
) -> EstimationResult<ComponentEstimate> {
    let given = problem.clone();
    let mut free = vec![true; groups.len()];
    let mut logs = vec![0.0; groups.len()];
    let mut remarks = vec![];
    let (mut share, mut before) = (1.0_f64, vec![0.0; groups.len()]);
    for iteration in 0..MAX_ITERATIONS {
        *problem = scale_covariances(&given, groups, &logs);
        let Ok(fit) = solve_groups(problem, &SolveOptions::default(), &linearise) else {
            break;
        };
        let shares = ScoringEquations::new(problem, &fit, groups);
        let (steps, gain) = shares.scoring_steps(&free);
        let settled = gain < MIN_GAIN;
        if settled || iteration >= MIN_ITERATIONS {
            let sigmas = shares.log_sigmas(&free);
            let vague = |i: &usize| free[*i] && sigmas[*i] > MAX_RELATIVE_SIGMA;
            let worst = (0..groups.len())
                .filter(vague)
                .max_by(|&a, &b| sigmas[a].total_cmp(&sigmas[b]));
            if let Some(worst) = worst {
                remarks.push(unestimated_component_remark(
                    groups[worst].name,
                    shares.redundancy[worst],
                ));
                (free[worst], logs[worst]) = (false, 0.0);
                continue;
            }
            if settled {
                return Ok(ComponentEstimate {
                    components: shares.build_components(groups, &free, &logs),
                    fit,
                    remarks,
                });
            }
        }
        // The expected information may be too small: steps that change their sign were too long.
        let turned = steps.iter().zip(&before).map(|(a, b)| a * b).sum::<f64>() < 0.0;
        share = if turned {
            0.5 * share
        } else {
            (1.5 * share).min(1.0)
        };
        before.clone_from(&steps);
        for i in 0..groups.len() {
            logs[i] += share * steps[i].clamp(-MAX_STEP, MAX_STEP);
            if logs[i] < MIN_COMPONENT.ln() {
                remarks.push(unestimated_component_remark(
                    groups[i].name,
                    shares.redundancy[i],
                ));
                (free[i], logs[i]) = (false, 0.0);
            }
        }
    }
    *problem = given;
    let fit = solve_groups(problem, &SolveOptions::default(), &linearise)?;
    let shares = ScoringEquations::new(problem, &fit, groups);
    let components = shares.build_components(groups, &vec![false; groups.len()], &logs);
    let sentence =
        "the variance components did not converge; all standard deviations stay as given";
    Ok(ComponentEstimate {
        fit,
        components,
        remarks: vec![sentence.into()],
    })
}

fn unestimated_component_remark(name: &str, redundancy: f64) -> String {
    format!(
        "the variance component of {name} cannot be estimated from this frame (redundancy \
         {redundancy:.1}); its standard deviations stay as given"
    )
}

/// Returns the problem with each group's covariances multiplied by its component.
fn scale_covariances(given: &Problem, groups: &[VarianceGroup], logs: &[f64]) -> Problem {
    let mut problem = given.clone();
    for (group, log) in groups.iter().zip(logs) {
        for (g, data) in problem.groups.iter_mut().enumerate() {
            for (b, block) in data.blocks.iter_mut().enumerate() {
                let members = (group.members)(g, b);
                for &i in &members {
                    for &j in &members {
                        block.covariance[(i, j)] *= log.exp();
                    }
                }
            }
        }
    }
    problem
}

/// Equations of Fisher scoring: residual sums, redundancies and information of the groups.
struct ScoringEquations {
    omega: Vec<f64>,
    redundancy: Vec<f64>,
    information: DMatrix<f64>,
}

impl ScoringEquations {
    fn new(problem: &Problem, fit: &Fit, groups: &[VarianceGroup]) -> Self {
        let conditions = StackedConditions::new(problem, fit);
        let products: Vec<_> = groups
            .iter()
            .map(|g| conditions.cofactor_product(problem, fit, g))
            .collect();
        let n = groups.len();
        let information = DMatrix::from_fn(n, n, |i, j| {
            0.5 * products[i].component_mul(&products[j].transpose()).sum()
        });
        Self {
            omega: groups
                .iter()
                .map(|g| weighted_squares(problem, fit, g))
                .collect(),
            redundancy: products.iter().map(DMatrix::trace).collect(),
            information,
        }
    }

    fn information_of_free_components(&self, free: &[bool]) -> (Vec<usize>, DMatrix<f64>) {
        let list: Vec<usize> = (0..free.len()).filter(|&i| free[i]).collect();
        let n = list.len();
        let part = DMatrix::from_fn(n, n, |i, j| self.information[(list[i], list[j])]);
        (list, part)
    }

    /// Returns steps of the logarithms and the gain in likelihood. If two components have the same effect, the step goes
    /// along their common direction.
    fn scoring_steps(&self, free: &[bool]) -> (Vec<f64>, f64) {
        let (list, mut part) = self.information_of_free_components(free);
        (0..list.len()).for_each(|k| part[(k, k)] += RIDGE);
        let score = |&i: &usize| 0.5 * (self.omega[i] - self.redundancy[i]);
        let score = DVector::from_iterator(list.len(), list.iter().map(score));
        let mut steps = vec![0.0; free.len()];
        let Some(found) = part.cholesky().map(|c| c.solve(&score)) else {
            return (steps, 0.0);
        };
        list.iter()
            .zip(found.iter())
            .for_each(|(&i, &step)| steps[i] = step);
        (steps, found.dot(&score))
    }

    /// Returns standard deviations of the logarithms, including the uncertainty of the components that are kept as given.
    fn log_sigmas(&self, free: &[bool]) -> Vec<f64> {
        let (list, part) = self.information_of_free_components(free);
        let mut sigmas = vec![f64::INFINITY; free.len()];
        let Some(inverse) = part.cholesky().map(|c| c.inverse()) else {
            return sigmas;
        };
        for (k, &i) in list.iter().enumerate() {
            let kept = (0..free.len()).filter(|&h| !free[h]);
            let through = kept.map(|h| {
                let coefficient: f64 = list
                    .iter()
                    .enumerate()
                    .map(|(m, &j)| inverse[(k, m)] * self.information[(j, h)])
                    .sum();
                (coefficient * MAX_RELATIVE_SIGMA).powi(2)
            });
            sigmas[i] = (inverse[(k, k)] + through.sum::<f64>()).sqrt();
        }
        sigmas
    }

    fn build_components(
        &self,
        groups: &[VarianceGroup],
        free: &[bool],
        logs: &[f64],
    ) -> Vec<VarianceComponent> {
        let sigmas = self.log_sigmas(free);
        let one = |i: usize| {
            let value = logs[i].exp();
            VarianceComponent {
                group: groups[i].name.into(),
                factor: free[i].then_some(value),
                sigma_factor: free[i].then(|| value * sigmas[i]),
                redundancy: self.redundancy[i],
            }
        };
        (0..groups.len()).map(one).collect()
    }
}

/// Returns `v' Q^-1 v` of a group.
fn weighted_squares(problem: &Problem, fit: &Fit, group: &VarianceGroup) -> f64 {
    let mut omega = 0.0;
    for (g, data) in problem.groups.iter().enumerate() {
        for (b, block) in data.blocks.iter().enumerate() {
            let members = (group.members)(g, b);
            let Some(factor) = block
                .covariance
                .select_rows(&members)
                .select_columns(&members)
                .cholesky()
            else {
                continue;
            };
            let residuals = fit.groups[g].blocks[b].residuals.select_rows(&members);
            omega += residuals.dot(&factor.solve(&residuals));
        }
    }
    omega
}

/// Conditions of all blocks, stacked in one matrix.
struct StackedConditions {
    /// First row of each (group, block).
    first: Vec<Vec<usize>>,
    /// Matrix `R` of the module's equations.
    cofactor: DMatrix<f64>,
}

impl StackedConditions {
    fn new(problem: &Problem, fit: &Fit) -> Self {
        let mut rows = 0;
        let mut first = vec![];
        for group in &fit.groups {
            let start = |b: &BlockFit| {
                rows += b.linearised.misclosure.len();
                rows - b.linearised.misclosure.len()
            };
            first.push(group.blocks.iter().map(start).collect::<Vec<_>>());
        }
        let p = fit.global.len();
        let mut weighted = DMatrix::zeros(rows, p);
        let mut cofactor = DMatrix::zeros(rows, rows);
        for (g, group) in fit.groups.iter().enumerate() {
            let start = first[g].first().copied().unwrap_or(0);
            let own = group
                .blocks
                .iter()
                .map(|b| b.linearised.misclosure.len())
                .sum();
            let mut local = DMatrix::zeros(own, group.local.len());
            for (b, block) in group.blocks.iter().enumerate() {
                let (lin, row) = (&block.linearised, first[g][b]);
                let n = lin.misclosure.len();
                let normal = &lin.observations
                    * &problem.groups[g].blocks[b].covariance
                    * lin.observations.transpose();
                let weight = normal
                    .cholesky()
                    .map_or_else(|| DMatrix::zeros(n, n), |c| c.inverse());
                let mut total = &lin.local * &group.sensitivity;
                for (k, &column) in lin.columns.iter().enumerate() {
                    let mut target = total.column_mut(column);
                    target += lin.global.column(k);
                }
                weighted.rows_mut(row, n).copy_from(&(&weight * total));
                local
                    .rows_mut(row - start, n)
                    .copy_from(&(&weight * &lin.local));
                cofactor.view_mut((row, row), (n, n)).copy_from(&weight);
            }
            if !group.local.is_empty() {
                let mut square = cofactor.view_mut((start, start), (own, own));
                square -= &local * &group.conditional * local.transpose();
            }
        }
        cofactor -= &weighted * &fit.covariance * weighted.transpose();
        Self { first, cofactor }
    }

    /// Returns `R V` of a group; `V` is block diagonal.
    fn cofactor_product(
        &self,
        problem: &Problem,
        fit: &Fit,
        group: &VarianceGroup,
    ) -> DMatrix<f64> {
        let mut product = DMatrix::zeros(self.cofactor.nrows(), self.cofactor.ncols());
        for (g, data) in problem.groups.iter().enumerate() {
            for (b, block) in data.blocks.iter().enumerate() {
                let members = (group.members)(g, b);
                let by = fit.groups[g].blocks[b]
                    .linearised
                    .observations
                    .select_columns(&members);
                let own = block
                    .covariance
                    .select_rows(&members)
                    .select_columns(&members);
                let (row, n) = (self.first[g][b], by.nrows());
                let share = self.cofactor.columns(row, n) * (&by * own * by.transpose());
                product.columns_mut(row, n).copy_from(&share);
            }
        }
        product
    }
}
