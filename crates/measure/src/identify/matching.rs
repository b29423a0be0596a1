//! Pairs from a first guess: gated one-to-one matching and fitting in turns.

use super::beam::WingState;
use super::fit::{
    Clutter, MatchedPair, StatePrior, StateStep, select_one_to_one, solve_step, squared_distance,
};
use super::outline::DiscOutline;
use super::scene::{Matrix8, PredictedImage, WingView, is_usable, looks_like, outline_fits};
use crate::detect::Detection;
use crate::ordering::sort_by_value;

/// Gate of a pair: chi-square of two degrees of freedom, 1e-4.
pub(super) const GATE: f64 = 18.4;
/// Gate of a pair's residual after the fit: chi-square of two degrees of freedom, 1 %; the noise of the predictions is
/// generous.
const RESIDUAL_GATE: f64 = 9.2;
/// Maximum number of rounds of matching and fitting; pairs settle in two or three.
const MAX_ROUNDS: usize = 8;
/// Maximum number of linear steps of a fit; bending settles in three.
const MAX_STEPS: usize = 8;
/// Step below which the fit is linear, px: less than the predictions' noise.
const SETTLED_PX: f64 = 2.0;
/// Bounds of the variance factor that scales the covariance of the state during matching.
const INFLATION: (f64, f64) = (1.0, 9.0);
/// Factor on the gate for an existing pair, so that two pairs do not alternate.
const KEEP_FACTOR: f64 = 1.5;
/// Minimum number of pairs of a fit: leaves redundancy, given the prior.
const MIN_PAIRS: usize = 4;

/// Matching of one frame in flight.
pub(super) struct MatchingProblem<'a> {
    pub(super) scene: &'a WingView<'a>,
    pub(super) detections: &'a [Detection],
    pub(super) clutter: Clutter,
    candidates: Vec<Vec<usize>>,
}

/// A fitted set of pairs.
#[derive(Clone, Debug)]
pub(super) struct RefinedMatch {
    pub(super) state: WingState,
    pub(super) covariance: Matrix8,
    pub(super) pairs: Vec<MatchedPair>,
    pub(super) evidence: f64,
    pub(super) prior: StatePrior,
    pub(super) predicted: Vec<Option<PredictedImage>>,
    pub(super) outlines: Vec<Option<DiscOutline>>,
}

/// A state fitted to pairs.
struct StateFit {
    state: WingState,
    covariance: Matrix8,
    cost: f64,
    predicted: Vec<Option<PredictedImage>>,
}

impl<'a> MatchingProblem<'a> {
    pub(super) fn new(scene: &'a WingView<'a>, detections: &'a [Detection]) -> Self {
        let lens = &scene.setup.lens;
        // The major axis of a disc's image depends on distance and size alone, and bending changes the distance little.
        let candidates = scene
            .setup
            .markers
            .iter()
            .zip(&scene.beam.ground_m)
            .enumerate()
            .map(|(j, (marker, p))| {
                let major = 0.5 * marker.diameter_m * lens.focal_px() / p.norm();
                let fits = |d: &Detection| is_usable(d) && looks_like(d, scene.setup, j, major);
                (0..detections.len())
                    .filter(|i| fits(&detections[*i]))
                    .collect()
            })
            .collect();
        Self {
            scene,
            detections,
            clutter: Clutter::new(detections.len(), lens),
            candidates,
        }
    }

    /// Returns detections that are similar to a marker.
    pub(super) fn candidates(&self, marker: usize) -> &[usize] {
        self.candidates.get(marker).map_or(&[], Vec::as_slice)
    }

    pub(super) fn solve_step(
        &self,
        pairs: &[MatchedPair],
        predicted: &[Option<PredictedImage>],
        prior: &StatePrior,
        state: &WingState,
    ) -> Option<StateStep> {
        solve_step(
            pairs,
            predicted,
            self.detections,
            prior,
            state,
            self.clutter,
        )
    }

    /// Matches and fits in turns until nothing changes, from the first pairs as given and, if different, from sequentially
    /// chosen ones. Returns the better result.
    pub(super) fn refine(&self, prior: &StatePrior, start: &[MatchedPair]) -> Option<RefinedMatch> {
        let as_given = self.refine_from(prior, start.to_vec());
        let mut walked = self.pair_sequentially(prior, &self.scene.linearise(&prior.mean), start);
        walked.sort_by_key(|p| p.1);
        if as_given
            .as_ref()
            .is_some_and(|a| walked.iter().all(|p| a.pairs.contains(p)))
        {
            return as_given;
        }
        let other = self.refine_from(prior, walked);
        [as_given, other]
            .into_iter()
            .flatten()
            .max_by(|a, b| a.evidence.total_cmp(&b.evidence))
    }

    /// Matches and fits in turns until nothing changes, without pairs that were outliers once; `None` below [`MIN_PAIRS`].
    fn refine_from(&self, prior: &StatePrior, mut pairs: Vec<MatchedPair>) -> Option<RefinedMatch> {
        let mut fit = self.fit_pairs(&pairs, prior, &prior.mean)?;
        let mut outliers: Vec<MatchedPair> = Vec::new();
        let mut round = 0;
        loop {
            let outlines = self.scene.marker_outlines(&fit.state);
            let inflation =
                (fit.cost / (2.0 * pairs.len() as f64).max(1.0)).clamp(INFLATION.0, INFLATION.1);
            let mut next = self.nearest_pairs(&fit, &outlines, inflation, &pairs);
            next.retain(|pair| !outliers.contains(pair));
            round += 1;
            if next == pairs || round > MAX_ROUNDS {
                let (kept, step) =
                    self.remove_outliers(pairs.clone(), &fit.predicted, prior, &fit.state)?;
                // An outlier may have taken another marker's detection.
                if kept == pairs || round > MAX_ROUNDS {
                    return (kept.len() >= MIN_PAIRS).then_some(RefinedMatch {
                        state: fit.state + step.delta,
                        covariance: step.covariance,
                        pairs: kept,
                        evidence: step.evidence,
                        prior: prior.clone(),
                        predicted: shift_predictions(&fit.predicted, &step),
                        outlines,
                    });
                }
                outliers.extend(pairs.into_iter().filter(|pair| !kept.contains(pair)));
                next = kept;
            }
            pairs = next;
            fit = self.fit_pairs(&pairs, prior, &fit.state)?;
        }
    }

    /// Fits given pairs to convergence without rejecting any, because bending is not linear.
    fn fit_pairs(
        &self,
        pairs: &[MatchedPair],
        prior: &StatePrior,
        start: &WingState,
    ) -> Option<StateFit> {
        let mut state = *start;
        for _ in 0..MAX_STEPS {
            let predicted = self.scene.linearise(&state);
            let step = self.solve_step(pairs, &predicted, prior, &state)?;
            state += step.delta;
            if max_shift_px(&predicted, &step) < SETTLED_PX {
                let predicted = shift_predictions(&predicted, &step);
                return Some(StateFit {
                    state,
                    covariance: step.covariance,
                    cost: step.cost,
                    predicted,
                });
            }
        }
        None
    }

    /// Chooses first pairs marker by marker, the most precise prediction first; each pair improves the next prediction.
    fn pair_sequentially(
        &self,
        prior: &StatePrior,
        predicted: &[Option<PredictedImage>],
        start: &[MatchedPair],
    ) -> Vec<MatchedPair> {
        let mut covariance = prior.covariance_matrix();
        let mut shift = WingState::zeros();
        let mut order: Vec<usize> = start.iter().map(|p| p.1).collect();
        let area = |j: usize| {
            predicted
                .get(j)
                .and_then(Option::as_ref)
                .map_or(f64::MAX, |p| {
                    (p.jacobian * covariance * p.jacobian.transpose() + p.covariance).determinant()
                })
        };
        sort_by_value(&mut order, |one| area(*one));
        let mut pairs: Vec<MatchedPair> = Vec::new();
        for j in order {
            let Some(Some(p)) = predicted.get(j) else {
                continue;
            };
            let expected = p.jacobian * covariance * p.jacobian.transpose() + p.covariance;
            let Some(inverse) = expected.try_inverse() else {
                continue;
            };
            let off = |i: usize| {
                let v = self.detections[i].centre_px - p.pixel - p.jacobian * shift;
                (v, v.dot(&(inverse * v)))
            };
            let free = |i: &&usize| pairs.iter().all(|q| q.0 != **i);
            let best = self
                .candidates(j)
                .iter()
                .filter(free)
                .min_by(|a, b| off(**a).1.total_cmp(&off(**b).1));
            let Some(&i) = best.filter(|i| off(**i).1 < GATE) else {
                continue;
            };
            let gain = covariance * p.jacobian.transpose() * inverse;
            shift += gain * off(i).0;
            covariance -= gain * p.jacobian * covariance;
            pairs.push((i, j));
        }
        pairs
    }

    /// Pairs one-to-one, nearest first, within the gate; existing pairs have a wider gate.
    fn nearest_pairs(
        &self,
        fit: &StateFit,
        outlines: &[Option<DiscOutline>],
        inflation: f64,
        old: &[MatchedPair],
    ) -> Vec<MatchedPair> {
        let (predicted, covariance) = (&fit.predicted, fit.covariance * inflation);
        let mut all: Vec<(f64, MatchedPair)> = Vec::new();
        for j in 0..predicted.len() {
            for &i in self.candidates(j) {
                if self.is_outline_compatible((i, j), outlines) {
                    let d =
                        squared_distance((i, j), predicted, self.detections, &covariance, false);
                    let loyal = if old.contains(&(i, j)) {
                        KEEP_FACTOR
                    } else {
                        1.0
                    };
                    if d < GATE * loyal {
                        all.push((d, (i, j)));
                    }
                }
            }
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut pairs: Vec<MatchedPair> = select_one_to_one(all)
            .into_iter()
            .map(|(_, pair)| pair)
            .collect();
        pairs.sort_by_key(|p| p.1);
        pairs
    }

    pub(super) fn is_outline_compatible(
        &self,
        (i, j): MatchedPair,
        outlines: &[Option<DiscOutline>],
    ) -> bool {
        let (Some(marker), Some(Some(outline)), Some(detection)) = (
            self.scene.setup.markers.get(j),
            outlines.get(j),
            self.detections.get(i),
        ) else {
            return false;
        };
        outline_fits(detection, marker.shape, outline)
    }

    /// Removes the worst pair until all residuals pass the test.
    pub(super) fn remove_outliers(
        &self,
        mut pairs: Vec<MatchedPair>,
        predicted: &[Option<PredictedImage>],
        prior: &StatePrior,
        state: &WingState,
    ) -> Option<(Vec<MatchedPair>, StateStep)> {
        loop {
            let step = self.solve_step(&pairs, predicted, prior, state)?;
            let shifted = shift_predictions(predicted, &step);
            let test = |pair: MatchedPair| {
                squared_distance(pair, &shifted, self.detections, &step.covariance, true)
            };
            let worst = pairs
                .iter()
                .enumerate()
                .map(|(k, pair)| (test(*pair), k))
                .max_by(|a, b| a.0.total_cmp(&b.0));
            match worst {
                Some((t, k)) if t > RESIDUAL_GATE => drop(pairs.remove(k)),
                _ => return Some((pairs, step)),
            }
        }
    }
}

/// Returns the predictions after a linear step.
pub(super) fn shift_predictions(
    predicted: &[Option<PredictedImage>],
    step: &StateStep,
) -> Vec<Option<PredictedImage>> {
    predicted
        .iter()
        .map(|p| {
            p.map(|p| PredictedImage {
                pixel: p.pixel + p.jacobian * step.delta,
                ..p
            })
        })
        .collect()
}

fn max_shift_px(predicted: &[Option<PredictedImage>], step: &StateStep) -> f64 {
    predicted
        .iter()
        .flatten()
        .map(|p| (p.jacobian * step.delta).norm())
        .fold(0.0, f64::max)
}
