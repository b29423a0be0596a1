//! Quality in the geodesists' terms: global test, redundancy numbers, w-test, minimal detectable
//! bias, variance components.
//!
//! The global test is one-sided: a variance factor below 1 says that the standard deviations were
//! stated too large, which is no reason to distrust the solution or to shrink its figures.

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

use super::gauss_helmert::{Fit, GroupPoint, Linearised, Problem, solve_groups};
use super::{AdjustError, GlobalTest, SigmaKind, VarianceComponent};

/// Probability of finding a bias as large as the minimal detectable one (Baarda).
const POWER: f64 = 0.8;
/// Below this share of its redundancy an observation is uncontrolled.
const UNCONTROLLED: f64 = 1e-6;
const COMPONENT_ITERATIONS: usize = 50;
const COMPONENT_SETTLED: f64 = 1e-4;

/// Chi-square test of the variance factor against 1, one-sided.
pub fn global_test(omega: f64, redundancy: usize, alpha: f64) -> GlobalTest {
    match ChiSquared::new(redundancy as f64) {
        Ok(law) if redundancy > 0 => {
            if omega <= law.inverse_cdf(1.0 - alpha) {
                GlobalTest::Passed
            } else {
                GlobalTest::Rejected
            }
        }
        _ => GlobalTest::NotPossible,
    }
}

/// Whether standard deviations are scaled by the root of the variance factor.
pub fn is_posterior(kind: SigmaKind, test: GlobalTest) -> bool {
    match kind {
        SigmaKind::ByTest => test == GlobalTest::Rejected,
        SigmaKind::Prior => false,
        SigmaKind::Posterior => test != GlobalTest::NotPossible,
    }
}

/// Two-sided critical value of the w-test; infinite at level 0.
pub fn critical_w(alpha: f64) -> f64 {
    if alpha > 0.0 { normal_quantile(1.0 - 0.5 * alpha) } else { f64::INFINITY }
}

/// Root of the non-centrality at which the w-test finds a bias with Baarda's power.
pub fn detectable_shift(alpha: f64) -> f64 {
    let alpha = if alpha > 0.0 { alpha } else { 0.001 };
    critical_w(alpha) + normal_quantile(POWER)
}

fn normal_quantile(p: f64) -> f64 {
    Normal::new(0.0, 1.0).map_or(f64::NAN, |law| law.inverse_cdf(p))
}

/// Reliability of one observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reliability {
    /// Redundancy number, 0 to 1: share of an error that shows in the residual.
    pub redundancy: f64,
    /// Baarda's w; `None` for an uncontrolled observation.
    pub w: Option<f64>,
    /// Smallest bias found with probability 0.8, unit of the observation.
    pub minimal_detectable_bias: Option<f64>,
}

/// Reliability of every observation of a block; covariance within the block is honoured.
pub fn reliability(
    problem: &Problem,
    fit: &Fit,
    group: usize,
    block: usize,
    snooping_alpha: f64,
) -> Vec<Reliability> {
    let data = &problem.groups[group].blocks[block];
    let residuals = &fit.groups[group].blocks[block].residuals;
    let n = residuals.len();
    let weight = data.covariance.clone().cholesky().map_or_else(|| DMatrix::zeros(n, n), |c| c.inverse());
    let cofactor = &data.covariance - fit.adjusted_covariance(group, block);
    let weighted = &weight * residuals;
    let power = &weight * &cofactor * &weight;
    let shares = &cofactor * &weight;
    let shift = detectable_shift(snooping_alpha);
    (0..n)
        .map(|k| {
            let controlled = power[(k, k)] > UNCONTROLLED * weight[(k, k)];
            Reliability {
                redundancy: shares[(k, k)].clamp(0.0, 1.0),
                w: controlled.then(|| -weighted[k] / power[(k, k)].sqrt()),
                minimal_detectable_bias: controlled.then(|| shift / power[(k, k)].sqrt()),
            }
        })
        .collect()
}

/// Which observations of which blocks form a group of variance.
pub struct VarianceGroup<'a> {
    /// `image` or `survey`.
    pub name: &'static str,
    /// Observations of a block that belong to it, given (group, block).
    pub members: &'a dyn Fn(usize, usize) -> Vec<usize>,
}

/// Variance components (Koch 1986), iterated to convergence. The problem's covariances are scaled
/// in place; the fit of the scaled problem comes back. Groups must not be correlated.
pub fn variance_components(
    problem: &mut Problem,
    groups: &[VarianceGroup],
    linearise: impl Fn(&GroupPoint) -> Result<Vec<Linearised>, AdjustError>,
) -> Result<(Fit, Vec<VarianceComponent>), AdjustError> {
    let mut factors = vec![1.0; groups.len()];
    for _ in 0..COMPONENT_ITERATIONS {
        let fit = solve_groups(problem, &linearise)?;
        let shares: Vec<(f64, f64)> = groups.iter().map(|g| share(problem, &fit, g)).collect();
        let updates: Vec<f64> =
            shares.iter().map(|&(omega, r)| if r > 1e-3 { (omega / r).max(1e-6) } else { 1.0 }).collect();
        if updates.iter().all(|u| (u - 1.0).abs() < COMPONENT_SETTLED) {
            let component = |((g, &factor), &(_, redundancy)): ((&VarianceGroup, &f64), &(f64, f64))| {
                VarianceComponent { group: g.name, factor, redundancy }
            };
            return Ok((fit, groups.iter().zip(&factors).zip(&shares).map(component).collect()));
        }
        for ((group, factor), update) in groups.iter().zip(&mut factors).zip(&updates) {
            *factor *= update;
            scale(problem, group, *update);
        }
    }
    Err(AdjustError::NoConvergence { iterations: COMPONENT_ITERATIONS })
}

/// Weighted squared residuals and redundancy of a group of variance.
fn share(problem: &Problem, fit: &Fit, group: &VarianceGroup) -> (f64, f64) {
    let (mut omega, mut redundancy) = (0.0, 0.0);
    for (g, data) in problem.groups.iter().enumerate() {
        for (b, block) in data.blocks.iter().enumerate() {
            let members = (group.members)(g, b);
            if members.is_empty() {
                continue;
            }
            let pick = |m: &DMatrix<f64>| {
                DMatrix::from_fn(members.len(), members.len(), |i, j| m[(members[i], members[j])])
            };
            let covariance = pick(&block.covariance);
            let Some(weight) = covariance.clone().cholesky().map(|c| c.inverse()) else { continue };
            let residuals = &fit.groups[g].blocks[b].residuals;
            let v = DVector::from_iterator(members.len(), members.iter().map(|&k| residuals[k]));
            omega += v.dot(&(&weight * &v));
            let cofactor = covariance - pick(&fit.adjusted_covariance(g, b));
            redundancy += (cofactor * weight).trace();
        }
    }
    (omega, redundancy)
}

fn scale(problem: &mut Problem, group: &VarianceGroup, factor: f64) {
    for (g, data) in problem.groups.iter_mut().enumerate() {
        for (b, block) in data.blocks.iter_mut().enumerate() {
            for &i in &(group.members)(g, b) {
                for &j in &(group.members)(g, b) {
                    block.covariance[(i, j)] *= factor;
                }
            }
        }
    }
}
