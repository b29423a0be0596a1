//! Variance components of groups of observations: restricted maximum likelihood (its estimate is that of
//! Koch, 1986), by Fisher scoring in the logarithm of the components.
//!
//! ```text
//! score_i = (v_i' Q_i^-1 v_i - r_i) / 2     r_i = tr R_ii
//! F_ij    = tr(R_ij R_ji) / 2               R   = (Q - Q_adjusted) Q^-1
//! ```
//!
//! The logarithm keeps components positive, and the inverse of `F` is their covariance. If the observations
//! do not determine a component, the given standard deviations are kept.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::error::EstimationResult;
use super::fit::{Fit, Gradient};
use super::linear::inverse_spd;
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
        let observations = AdjustedObservations::new(problem, fit);
        let members: Vec<Vec<usize>> = groups
            .iter()
            .map(|group| observations.of_group(problem, group))
            .collect();
        let sum = |group: &Vec<usize>, value: &dyn Fn(usize) -> f64| -> f64 {
            group.iter().map(|k| value(*k)).sum()
        };
        let powers = &observations.redundancy;
        let information = |i: usize, j: usize| {
            0.5 * sum(&members[i], &|a| {
                sum(&members[j], &|b| powers[(a, b)] * powers[(b, a)])
            })
        };
        let per_group = |value: &dyn Fn(usize) -> f64| {
            let values = members.iter().map(|group| sum(group, value));
            values.collect()
        };
        Self {
            omega: per_group(&|k| observations.squares[k]),
            redundancy: per_group(&|k| powers[(k, k)]),
            information: DMatrix::from_fn(groups.len(), groups.len(), information),
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

/// Observations of all blocks in one list.
struct AdjustedObservations {
    /// `(Q - Q_adjusted) Q^-1`: derivatives of the residuals with respect to errors of the observations.
    redundancy: DMatrix<f64>,
    /// Contribution of each observation to the sum of squares.
    squares: Vec<f64>,
}

impl AdjustedObservations {
    fn new(problem: &Problem, fit: &Fit) -> Self {
        let blocks = problem.groups.iter().flat_map(|group| &group.blocks);
        let count = blocks.map(|block| block.observed.len()).sum();
        let (mut own, mut weights) = (DMatrix::zeros(count, count), DMatrix::zeros(count, count));
        let mut total = DMatrix::zeros(count, fit.global.len());
        let (mut first, mut squares) = (0, vec![]);
        for (index, group) in problem.groups.iter().enumerate() {
            let n = group.blocks.iter().map(|block| block.observed.len()).sum();
            let mut gradient = Gradient::empty(vec![], group.local.len(), n);
            let mut at = 0;
            for (k, block) in group.blocks.iter().enumerate() {
                let m = block.observed.len();
                let mut by = DMatrix::zeros(m, n);
                by.columns_mut(at, m).fill_with_identity();
                gradient.observed.push((k, by));
                let zero = || DMatrix::zeros(m, m);
                let weight = inverse_spd(&block.covariance).unwrap_or_else(zero);
                let residuals = &fit.groups[index].blocks[k].residuals;
                squares.extend((&weight * residuals).component_mul(residuals).iter());
                let (here, size) = ((first + at, first + at), (m, m));
                weights.view_mut(here, size).copy_from(&weight);
                at += m;
            }
            let part = fit.propagate(index, &gradient);
            own.view_mut((first, first), (n, n)).copy_from(&part.own);
            total.rows_mut(first, n).copy_from(&part.total);
            first += n;
        }
        let adjusted = &total * &fit.covariance * total.transpose() + own;
        Self {
            redundancy: DMatrix::identity(count, count) - adjusted * weights,
            squares,
        }
    }

    /// Returns the indices of a group's observations.
    fn of_group(&self, problem: &Problem, group: &VarianceGroup) -> Vec<usize> {
        let (mut first, mut members) = (0, vec![]);
        for (g, data) in problem.groups.iter().enumerate() {
            for (b, block) in data.blocks.iter().enumerate() {
                members.extend((group.members)(g, b).into_iter().map(|k| first + k));
                first += block.observed.len();
            }
        }
        members
    }
}
