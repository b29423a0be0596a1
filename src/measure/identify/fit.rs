//! Least squares of the state for given pairs, and the evidence for a set of pairs.

use nalgebra::{Matrix2, Vector2};

use super::beam::State;
use super::scene::{Matrix8, Predicted, mahalanobis_squared};
use crate::detect::Detection;
use crate::geometry::Lens;

/// Detection and marker.
pub(super) type Pair = (usize, usize);

/// What is believed of the state before looking.
#[derive(Clone, Debug)]
pub(super) struct Prior {
    pub(super) mean: State,
    pub(super) sigma: State,
}

impl Prior {
    pub(super) fn precision(&self) -> Matrix8 {
        Matrix8::from_diagonal(&self.sigma.map(|s| 1.0 / (s * s)))
    }

    pub(super) fn covariance(&self) -> Matrix8 {
        Matrix8::from_diagonal(&self.sigma.map(|s| s * s))
    }
}

/// Odds that a marker of the survey is seen: an assumption, two of three.
pub(super) const SEEN_ODDS: f64 = 2.0;
/// Candidates crowd along the wing, a tenth of the frame: times as many per area.
const CROWDING: f64 = 10.0;
/// False candidates where there are none: as many as hardly any frame is without.
const MIN_CLUTTER: f64 = 3.0;

/// False candidates per area in a frame of so many detections, 1/px^2.
pub(super) fn clutter_per_px2(detections: usize, lens: &Lens) -> f64 {
    let area = f64::from(lens.width) * f64::from(lens.height);
    CROWDING * (detections as f64 + MIN_CLUTTER) / area.max(1.0)
}

/// Frequency of markers and of false candidates in a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clutter {
    /// ln(odds that a marker is seen / (clutter per px^2 * 2 pi)).
    gain: f64,
}

impl Clutter {
    /// For so many detections.
    pub(super) fn new(detections: usize, lens: &Lens) -> Self {
        Self { gain: (SEEN_ODDS / (clutter_per_px2(detections, lens) * std::f64::consts::TAU)).ln() }
    }
}

/// One linear least-squares step.
#[derive(Clone, Debug)]
pub(super) struct Step {
    pub(super) delta: State,
    pub(super) covariance: Matrix8,
    /// Weighted squares after the step, prior included.
    pub(super) cost: f64,
    /// ln of the evidence for the pairs against "all are clutter".
    pub(super) evidence: f64,
}

fn pair_covariance(detection: &Detection, predicted: &Predicted) -> Matrix2<f64> {
    predicted.covariance + *detection.covariance_px2
}

/// Solves for the change of the state; `None` where a pair has no prediction.
pub(super) fn solve_step(
    pairs: &[Pair],
    predicted: &[Option<Predicted>],
    detections: &[Detection],
    prior: &Prior,
    state: &State,
    clutter: Clutter,
) -> Option<Step> {
    let mut normal = prior.precision();
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
    Some(Step { delta, covariance: cholesky.inverse(), cost, evidence })
}

/// Squared distance of a pair in units of what is known: `covariance` of the state, the pair's own
/// noise. For a pair that took part in the fit, `took_part` gives the test of its residual.
pub(super) fn squared_distance(
    (i, j): Pair,
    predicted: &[Option<Predicted>],
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
    if took_part { mahalanobis_squared(&v, &(noise - state)) } else { mahalanobis_squared(&v, &(noise + state)) }
}
