//! From a first guess to pairs: gated one-to-one matching and fitting in turns.

use super::beam::State;
use super::fit::{Clutter, Pair, Prior, Step, squared_distance, solve_step};
use super::outline::Outline;
use super::scene::{Matrix8, Predicted, Scene, looks_like, outline_fits, is_usable};
use crate::detect::Detection;

/// Chi-square of two degrees of freedom, 1e-4: beyond this a pair is none.
pub(super) const GATE: f64 = 18.4;
/// What is accepted in the end, chi-square of two degrees of freedom, 1 %: the predictions' stated noise is generous.
const RESIDUAL_GATE: f64 = 9.2;
/// Rounds of matching and fitting at most; pairs settle in two or three.
const MAX_ROUNDS: usize = 8;
/// Linear steps of a fit at most; bending settles in three.
const MAX_STEPS: usize = 8;
/// Below this a linear step is exact, px: less than the predictions' own noise.
const SETTLED_PX: f64 = 2.0;
/// Bounds of the variance factor by which the state is taken to be known less while pairs are sought.
const INFLATION: (f64, f64) = (1.0, 9.0);
/// A pair keeps its place up to so many times the gate: without it two pairs may take turns.
const KEEP_FACTOR: f64 = 1.5;
/// Fewest pairs of a fit: as many leave one that checks, with what is known before.
const MIN_PAIRS: usize = 4;

/// One frame in flight.
pub(super) struct Problem<'a> {
    pub(super) scene: &'a Scene<'a>,
    pub(super) detections: &'a [Detection],
    pub(super) clutter: Clutter,
    candidates: Vec<Vec<usize>>,
}

/// A fitted set of pairs.
#[derive(Clone, Debug)]
pub(super) struct Refined {
    pub(super) state: State,
    pub(super) covariance: Matrix8,
    pub(super) pairs: Vec<Pair>,
    pub(super) evidence: f64,
    pub(super) prior: Prior,
    pub(super) predicted: Vec<Option<Predicted>>,
    pub(super) outlines: Vec<Option<Outline>>,
}

/// A state fitted to pairs.
struct Fit {
    state: State,
    covariance: Matrix8,
    cost: f64,
    predicted: Vec<Option<Predicted>>,
}

impl<'a> Problem<'a> {
    pub(super) fn new(scene: &'a Scene<'a>, detections: &'a [Detection]) -> Self {
        let lens = &scene.setup.lens;
        // The major axis of a disc's image hangs on distance and size alone, and distance changes
        // little by bending.
        let candidates = scene
            .setup
            .markers
            .iter()
            .zip(&scene.beam.ground_m)
            .map(|(marker, p)| {
                let major = 0.5 * marker.diameter_m * lens.focal_px() / p.norm();
                let fits = |d: &Detection| is_usable(d) && looks_like(d, marker.shape, major);
                (0..detections.len()).filter(|i| fits(&detections[*i])).collect()
            })
            .collect();
        Self { scene, detections, clutter: Clutter::new(detections.len(), lens), candidates }
    }

    /// Detections that look like a marker.
    pub(super) fn candidates(&self, marker: usize) -> &[usize] {
        self.candidates.get(marker).map_or(&[], Vec::as_slice)
    }

    pub(super) fn solve_step(
        &self,
        pairs: &[Pair],
        predicted: &[Option<Predicted>],
        prior: &Prior,
        state: &State,
    ) -> Option<Step> {
        solve_step(pairs, predicted, self.detections, prior, state, self.clutter)
    }

    /// Matches and fits in turns until nothing changes, from the first pairs as they are and, where
    /// that differs, from those that a walk from marker to marker makes of them; the better one.
    pub(super) fn refine(&self, prior: &Prior, start: &[Pair]) -> Option<Refined> {
        let as_given = self.refine_from(prior, start.to_vec());
        let mut walked = self.pair_sequentially(prior, &self.scene.linearise(&prior.mean), start);
        walked.sort_by_key(|p| p.1);
        if as_given.as_ref().is_some_and(|a| walked.iter().all(|p| a.pairs.contains(p))) {
            return as_given;
        }
        let other = self.refine_from(prior, walked);
        [as_given, other].into_iter().flatten().max_by(|a, b| a.evidence.total_cmp(&b.evidence))
    }

    /// Matches and fits in turns until nothing changes; `None` below [`LEAST_PAIRS`].
    fn refine_from(&self, prior: &Prior, mut pairs: Vec<Pair>) -> Option<Refined> {
        let mut fit = self.fit_pairs(&pairs, prior, &prior.mean)?;
        let mut outlines = self.scene.marker_outlines(&fit.state);
        for _ in 0..MAX_ROUNDS {
            let inflation = (fit.cost / (2.0 * pairs.len() as f64).max(1.0)).clamp(INFLATION.0, INFLATION.1);
            let next = self.nearest_pairs(&fit.predicted, &outlines, &(fit.covariance * inflation), &pairs);
            if next == pairs {
                break;
            }
            pairs = next;
            fit = self.fit_pairs(&pairs, prior, &fit.state)?;
            outlines = self.scene.marker_outlines(&fit.state);
        }
        let (pairs, step) = self.remove_outliers(pairs, &fit.predicted, prior, &fit.state)?;
        (pairs.len() >= MIN_PAIRS).then_some(Refined {
            state: fit.state + step.delta,
            covariance: step.covariance,
            pairs,
            evidence: step.evidence,
            prior: prior.clone(),
            predicted: shift_predictions(&fit.predicted, &step),
            outlines,
        })
    }

    /// Fits given pairs to convergence, before any of them is judged: bending is not linear.
    fn fit_pairs(&self, pairs: &[Pair], prior: &Prior, start: &State) -> Option<Fit> {
        let mut state = *start;
        for _ in 0..MAX_STEPS {
            let predicted = self.scene.linearise(&state);
            let step = self.solve_step(pairs, &predicted, prior, &state)?;
            state += step.delta;
            if max_shift_px(&predicted, &step) < SETTLED_PX {
                let predicted = shift_predictions(&predicted, &step);
                return Some(Fit { state, covariance: step.covariance, cost: step.cost, predicted });
            }
        }
        None
    }

    /// First pairs, one marker after the other, the surest prediction first, each one sharpening
    /// the next.
    fn pair_sequentially(&self, prior: &Prior, predicted: &[Option<Predicted>], start: &[Pair]) -> Vec<Pair> {
        let mut covariance = prior.covariance();
        let mut shift = State::zeros();
        let mut order: Vec<usize> = start.iter().map(|p| p.1).collect();
        let area = |j: usize| {
            predicted.get(j).and_then(Option::as_ref).map_or(f64::MAX, |p| {
                (p.jacobian * covariance * p.jacobian.transpose() + p.covariance).determinant()
            })
        };
        order.sort_by(|a, b| area(*a).total_cmp(&area(*b)));
        let mut pairs: Vec<Pair> = Vec::new();
        for j in order {
            let Some(Some(p)) = predicted.get(j) else { continue };
            let expected = p.jacobian * covariance * p.jacobian.transpose() + p.covariance;
            let Some(inverse) = expected.try_inverse() else { continue };
            let off = |i: usize| {
                let v = self.detections[i].centre_px - p.pixel - p.jacobian * shift;
                (v, v.dot(&(inverse * v)))
            };
            let free = |i: &&usize| pairs.iter().all(|q| q.0 != **i);
            let best =
                self.candidates(j).iter().filter(free).min_by(|a, b| off(**a).1.total_cmp(&off(**b).1));
            let Some(&i) = best.filter(|i| off(**i).1 < GATE) else { continue };
            let gain = covariance * p.jacobian.transpose() * inverse;
            shift += gain * off(i).0;
            covariance -= gain * p.jacobian * covariance;
            pairs.push((i, j));
        }
        pairs
    }

    /// One-to-one, nearest first, within the gate; `old` pairs are held against their residual's test.
    fn nearest_pairs(
        &self,
        predicted: &[Option<Predicted>],
        outlines: &[Option<Outline>],
        covariance: &Matrix8,
        old: &[Pair],
    ) -> Vec<Pair> {
        let mut all: Vec<(f64, Pair)> = Vec::new();
        for j in 0..predicted.len() {
            for &i in self.candidates(j) {
                if self.outline_fits((i, j), outlines) {
                    let d = squared_distance((i, j), predicted, self.detections, covariance, false);
                    let loyal = if old.contains(&(i, j)) { KEEP_FACTOR } else { 1.0 };
                    if d < GATE * loyal {
                        all.push((d, (i, j)));
                    }
                }
            }
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut pairs: Vec<Pair> = Vec::new();
        for (_, (i, j)) in all {
            if pairs.iter().all(|p| p.0 != i && p.1 != j) {
                pairs.push((i, j));
            }
        }
        pairs.sort_by_key(|p| p.1);
        pairs
    }

    pub(super) fn outline_fits(&self, (i, j): Pair, outlines: &[Option<Outline>]) -> bool {
        let (Some(marker), Some(Some(outline)), Some(detection)) =
            (self.scene.setup.markers.get(j), outlines.get(j), self.detections.get(i))
        else {
            return false;
        };
        outline_fits(detection, marker.shape, outline)
    }

    /// Takes the worst pair out while its residual fails the test.
    pub(super) fn remove_outliers(
        &self,
        mut pairs: Vec<Pair>,
        predicted: &[Option<Predicted>],
        prior: &Prior,
        state: &State,
    ) -> Option<(Vec<Pair>, Step)> {
        loop {
            let step = self.solve_step(&pairs, predicted, prior, state)?;
            let shifted = shift_predictions(predicted, &step);
            let test = |pair: Pair| squared_distance(pair, &shifted, self.detections, &step.covariance, true);
            let worst =
                pairs.iter().enumerate().map(|(k, pair)| (test(*pair), k)).max_by(|a, b| a.0.total_cmp(&b.0));
            match worst {
                Some((t, k)) if t > RESIDUAL_GATE => drop(pairs.remove(k)),
                _ => return Some((pairs, step)),
            }
        }
    }
}

/// Predictions after a linear step.
pub(super) fn shift_predictions(predicted: &[Option<Predicted>], step: &Step) -> Vec<Option<Predicted>> {
    predicted.iter().map(|p| p.map(|p| Predicted { pixel: p.pixel + p.jacobian * step.delta, ..p })).collect()
}

fn max_shift_px(predicted: &[Option<Predicted>], step: &Step) -> f64 {
    predicted.iter().flatten().map(|p| (p.jacobian * step.delta).norm()).fold(0.0, f64::max)
}
