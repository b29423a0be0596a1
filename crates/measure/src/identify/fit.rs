//! Least squares of the wing state for given pairs, and the evidence for a set of pairs.

use nalgebra::{Matrix2, Vector2};

use super::beam::WingState;
use super::scene::{Matrix8, PredictedImage, mahalanobis_squared};
use crate::detect::Detection;
use crate::geometry::Lens;

/// Indices of a detection and its marker.
pub(super) type MatchedPair = (usize, usize);

/// Selects pairs in their order, each detection and each marker once.
pub(super) fn select_one_to_one(
    ordered: impl IntoIterator<Item = (f64, MatchedPair)>,
) -> Vec<(f64, MatchedPair)> {
    let mut selected: Vec<(f64, MatchedPair)> = Vec::new();
    for (distance, (i, j)) in ordered {
        if selected.iter().all(|(_, p)| p.0 != i && p.1 != j) {
            selected.push((distance, (i, j)));
        }
    }
    selected
}

/// Prior of the wing state.
#[derive(Clone, Debug)]
pub(super) struct StatePrior {
    pub(super) mean: WingState,
    pub(super) sigma: WingState,
}

impl StatePrior {
    pub(super) fn precision_matrix(&self) -> Matrix8 {
        Matrix8::from_diagonal(&self.sigma.map(|s| 1.0 / (s * s)))
    }

    pub(super) fn covariance_matrix(&self) -> Matrix8 {
        Matrix8::from_diagonal(&self.sigma.map(|s| s * s))
    }
}

/// Odds that a marker of the survey is detected: 2 to 1 (assumption).
pub(super) const SEEN_ODDS: f64 = 2.0;
/// Density of false candidates along the wing, which covers 10 % of the frame, over the mean density.
const CROWDING: f64 = 10.0;
/// Assumed number of false candidates if there are none: hardly any frame has fewer.
const MIN_CLUTTER: f64 = 3.0;

/// Returns the density of false candidates in a frame with a number of detections, 1/px^2.
pub(super) fn clutter_per_px2(detections: usize, lens: &Lens) -> f64 {
    let area = f64::from(lens.width) * f64::from(lens.height);
    CROWDING * (detections as f64 + MIN_CLUTTER) / area.max(1.0)
}

/// Density of false candidates in a frame, relative to the odds of a detected marker.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clutter {
    /// Value of `ln(odds that a marker is detected / (false candidates per px^2 * 2 pi))`.
    gain: f64,
}

impl Clutter {
    /// Creates the density for a number of detections.
    pub(super) fn new(detections: usize, lens: &Lens) -> Self {
        Self {
            gain: (SEEN_ODDS / (clutter_per_px2(detections, lens) * std::f64::consts::TAU)).ln(),
        }
    }
}

/// Result of one linear least-squares step.
#[derive(Clone, Debug)]
pub(super) struct StateStep {
    pub(super) delta: WingState,
    pub(super) covariance: Matrix8,
    /// Weighted squares after the step, prior included.
    pub(super) cost: f64,
    /// Log evidence for the pairs against false candidates alone.
    pub(super) evidence: f64,
}

fn pair_covariance(detection: &Detection, predicted: &PredictedImage) -> Matrix2<f64> {
    predicted.covariance + *detection.covariance_px2
}

/// Solves for the change of the state; `None` if a pair has no prediction.
pub(super) fn solve_step(
    pairs: &[MatchedPair],
    predicted: &[Option<PredictedImage>],
    detections: &[Detection],
    prior: &StatePrior,
    state: &WingState,
    clutter: Clutter,
) -> Option<StateStep> {
    let mut normal = prior.precision_matrix();
    let mut right = normal * (prior.mean - state);
    let mut cost = right.dot(&(prior.mean - state));
    let mut evidence = 0.0;
    for &(i, j) in pairs {
        let p = predicted.get(j)?.as_ref()?;
        let detection = detections.get(i)?;
        let covariance = pair_covariance(detection, p);
        let weight = covariance.try_inverse()?;
        let v = detection.centre_px - p.pixel;
        let weighted = p.jacobian.transpose() * weight;
        normal += weighted * p.jacobian;
        right += weighted * v;
        cost += v.dot(&(weight * v));
        evidence += clutter.gain - 0.5 * covariance.determinant().ln();
    }
    let cholesky = normal.cholesky()?;
    let delta = cholesky.solve(&right);
    let cost = (cost - right.dot(&delta)).max(0.0);
    let log_determinant = 2.0 * cholesky.l_dirty().diagonal().map(f64::ln).sum();
    let prior_log = -2.0 * prior.sigma.map(f64::ln).sum();
    evidence += 0.5 * (prior_log - log_determinant) - 0.5 * cost;
    Some(StateStep {
        delta,
        covariance: cholesky.inverse(),
        cost,
        evidence,
    })
}

/// Returns the squared normalised distance of a pair, given the `covariance` of the state and the pair's noise. If
/// `took_part`, the pair is part of the fit and the value is the test of its residual.
pub(super) fn squared_distance(
    (i, j): MatchedPair,
    predicted: &[Option<PredictedImage>],
    detections: &[Detection],
    covariance: &Matrix8,
    took_part: bool,
) -> f64 {
    let (Some(Some(p)), Some(detection)) = (predicted.get(j), detections.get(i)) else {
        return f64::INFINITY;
    };
    let state = p.jacobian * covariance * p.jacobian.transpose();
    let noise = pair_covariance(detection, p);
    let v: Vector2<f64> = detection.centre_px - p.pixel;
    if took_part {
        mahalanobis_squared(&v, &(noise - state))
    } else {
        mahalanobis_squared(&v, &(noise + state))
    }
}
