//! Quality measures of geodesy: global test, redundancy numbers, w-test, minimal detectable bias.
//!
//! The global test is one-sided: a variance factor below 1 means that the given standard deviations were too large, which
//! is no reason to distrust the solution or to reduce its standard deviations.

use nalgebra::DMatrix;
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

use super::fit::{Fit, Gradient};
use super::linear::inverse_spd;
use super::problem::Problem;

/// Choice of the reported standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SigmaKind {
    /// A posteriori if the global test rejects the model, a priori if it accepts it.
    #[default]
    #[serde(rename = "by test")]
    ByTest,
    /// A priori standard deviations.
    Prior,
    /// A posteriori: scaled by the root of the variance factor.
    Posterior,
}

/// Verdict of the chi-square test on the variance factor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GlobalTest {
    /// The variance factor is compatible with 1.
    Passed,
    /// The variance factor is significantly larger than 1.
    Rejected,
}

/// Probability of finding a bias as large as the minimal detectable one (Baarda).
const DETECTION_POWER: f64 = 0.8;
/// Redundancy number below which an observation is uncontrolled.
const MIN_REDUNDANCY: f64 = 1e-6;

/// Tests the variance factor against 1 by chi-square, one-sided; `None` without redundancy.
pub fn global_test(omega: f64, redundancy: usize, alpha: f64) -> Option<GlobalTest> {
    // The tail's probability instead of its quantile, which is found by bisection.
    let law = ChiSquared::new(redundancy as f64)
        .ok()
        .filter(|_| redundancy > 0)?;
    Some(if law.sf(omega) >= alpha {
        GlobalTest::Passed
    } else {
        GlobalTest::Rejected
    })
}

/// Returns the variance factor, at least 1, if the global test of level `alpha` rejects it, otherwise 1.
pub fn rejected_factor(omega: f64, redundancy: usize, alpha: f64) -> f64 {
    match global_test(omega, redundancy, alpha) {
        Some(GlobalTest::Rejected) => (omega / redundancy.max(1) as f64).max(1.0),
        _ => 1.0,
    }
}

/// Returns the limit that a chi-square variable of `freedom` degrees of freedom exceeds with probability `alpha`; infinite
/// without degrees of freedom.
pub fn chi_square_limit(freedom: f64, alpha: f64) -> f64 {
    ChiSquared::new(freedom).map_or(f64::INFINITY, |law| law.inverse_cdf(1.0 - alpha))
}

/// Returns the probability that a chi-square variable of `freedom` degrees of freedom exceeds `value`; 1 without degrees of
/// freedom.
pub fn chi_square_tail(freedom: f64, value: f64) -> f64 {
    ChiSquared::new(freedom).map_or(1.0, |law| law.sf(value))
}

/// Returns true if standard deviations are scaled by the root of the variance factor.
pub fn is_posterior(kind: SigmaKind, test: Option<GlobalTest>) -> bool {
    match kind {
        SigmaKind::ByTest => test == Some(GlobalTest::Rejected),
        SigmaKind::Prior => false,
        SigmaKind::Posterior => test.is_some(),
    }
}

/// Returns the two-sided critical value of the w-test; infinite at level 0.
pub fn critical_w(alpha: f64) -> f64 {
    if alpha > 0.0 {
        normal_quantile(1.0 - 0.5 * alpha)
    } else {
        f64::INFINITY
    }
}

/// Returns the root of the non-centrality at which the w-test finds a bias with Baarda's power.
pub fn detectable_shift(alpha: f64) -> f64 {
    let alpha = if alpha > 0.0 { alpha } else { 0.001 };
    critical_w(alpha) + normal_quantile(DETECTION_POWER)
}

fn normal_quantile(p: f64) -> f64 {
    Normal::new(0.0, 1.0).map_or(f64::NAN, |law| law.inverse_cdf(p))
}

/// Reliability of one observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reliability {
    /// Redundancy number, 0 to 1: fraction of an error that appears in the residual.
    pub redundancy: f64,
    /// Baarda's w; `None` for an uncontrolled observation.
    pub w: Option<f64>,
    /// Smallest bias found with probability 0.8, unit of the observation.
    pub minimal_detectable_bias: Option<f64>,
}

/// Returns the reliability of every observation of a block, with the covariances within the block.
pub fn observation_reliability(
    problem: &Problem,
    fit: &Fit,
    group: usize,
    block: usize,
    snooping_alpha: f64,
) -> Vec<Reliability> {
    let data = &problem.groups[group].blocks[block];
    let residuals = &fit.groups[group].blocks[block].residuals;
    let n = residuals.len();
    let weight = inverse_spd(&data.covariance).unwrap_or_else(|| DMatrix::zeros(n, n));
    let cofactor = &data.covariance - fit.adjusted_covariance(group, block);
    let weighted = &weight * residuals;
    let power = &weight * &cofactor * &weight;
    let shares = &cofactor * &weight;
    let shift = detectable_shift(snooping_alpha);
    (0..n)
        .map(|k| {
            let controlled = power[(k, k)] > MIN_REDUNDANCY * weight[(k, k)];
            Reliability {
                redundancy: shares[(k, k)].clamp(0.0, 1.0),
                w: controlled.then(|| -weighted[k] / power[(k, k)].sqrt()),
                minimal_detectable_bias: controlled.then(|| shift / power[(k, k)].sqrt()),
            }
        })
        .collect()
}

/// Returns the statistic of the hypothesis that a global parameter has another value in one group alone (the w-test of a
/// model error with several observations, Baarda 1968): standard normal if it has not. `None` if the group does not control
/// it.
pub fn group_bias_statistic(
    problem: &Problem,
    fit: &Fit,
    group: usize,
    column: usize,
) -> Option<f64> {
    let blocks = &fit.groups[group].blocks;
    let mut functions = Gradient::empty(vec![], fit.groups[group].local.len(), 1);
    let (mut score, mut power) = (0.0, 0.0);
    for (index, block) in blocks.iter().enumerate() {
        let linearised = &block.linearised;
        let Some(at) = linearised.columns.iter().position(|other| *other == column) else {
            continue;
        };
        // Change of the observations that has the same effect on the conditions.
        let by_parameter = linearised.global.columns(at, 1).into_owned();
        let change = linearised.observations.clone().lu().solve(&by_parameter)?;
        let weight = inverse_spd(&problem.groups[group].blocks[index].covariance)?;
        let weighted = weight * &change;
        score += weighted.column(0).dot(&block.residuals);
        power += weighted.dot(&change);
        functions.observed.push((index, weighted));
    }
    let variance = power - fit.function_variances(group, &functions).first()?;
    (variance > MIN_REDUNDANCY * power).then(|| score / variance.sqrt())
}
