//! Pairs that could be told otherwise: decided by likelihood ratio, or reported as undecided.

use super::fit::Pair;
use super::matching::{GATE, Problem, Refined, shift_predictions};

/// ln of the odds that one reading must have over any other.
pub(super) const MIN_LOG_ODDS: f64 = 9.0;
/// Other readings are looked at within this squared distance: the gate, and what a wrong
/// neighbour pulls the fit by.
const NEIGHBOURHOOD: f64 = 6.0 * GATE;

/// A set of pairs with those that are not beyond doubt.
pub(super) struct Decision {
    pub(super) refined: Refined,
    /// Markers that cannot be decided, with the other reading's marker or detection.
    pub(super) doubtful: Vec<(usize, Doubt)>,
}

/// What stands against a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Doubt {
    /// Another marker explains the detection as well.
    Marker(usize),
    /// Another detection fits the marker as well.
    Detection,
}

/// Another reading: the pairs, which markers it concerns, and what it is.
struct Reading {
    pairs: Vec<Pair>,
    concerns: Vec<(usize, Doubt)>,
}

/// Takes up better readings until there is none, then lists the doubtful ones.
pub(super) fn decide_pairs(problem: &Problem<'_>, mut refined: Refined) -> Decision {
    for _ in 0..4 {
        let better = list_alternatives(problem, &refined)
            .into_iter()
            .filter_map(|r| Some((pair_evidence(problem, &refined, &r.pairs)?, r)))
            .filter(|(e, _)| *e > refined.evidence + 1e-6)
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, reading)) = better else { break };
        let Some(next) = problem.refit_pairs(&refined, reading.pairs) else { break };
        if next.evidence <= refined.evidence {
            break;
        }
        refined = next;
    }
    let mut doubtful: Vec<(usize, Doubt)> = Vec::new();
    for reading in list_alternatives(problem, &refined) {
        let close = pair_evidence(problem, &refined, &reading.pairs).is_some_and(|e| e > refined.evidence - MIN_LOG_ODDS);
        if close {
            for concern in reading.concerns {
                if !doubtful.iter().any(|d| d.0 == concern.0) {
                    doubtful.push(concern);
                }
            }
        }
    }
    Decision { refined, doubtful }
}

fn pair_evidence(problem: &Problem<'_>, refined: &Refined, pairs: &[Pair]) -> Option<f64> {
    problem.solve_step(pairs, &refined.predicted, &refined.prior, &refined.state).map(|s| s.evidence)
}

/// Every reading one exchange away: a detection given to another marker, two detections swapped,
/// a marker given another detection.
fn list_alternatives(problem: &Problem<'_>, refined: &Refined) -> Vec<Reading> {
    let mut all = Vec::new();
    let pairs = &refined.pairs;
    for (k, &(i, j)) in pairs.iter().enumerate() {
        for other in 0..refined.predicted.len() {
            if other == j || !is_near(problem, refined, (i, other)) {
                continue;
            }
            let mut changed = pairs.clone();
            changed[k] = (i, other);
            match pairs.iter().position(|p| p.1 == other) {
                None => all.push(Reading { pairs: changed, concerns: vec![(j, Doubt::Marker(other))] }),
                Some(at) => {
                    let mut stolen = changed.clone();
                    stolen.remove(at);
                    let concerns = vec![(j, Doubt::Marker(other)), (other, Doubt::Marker(j))];
                    if is_near(problem, refined, (pairs[at].0, j)) {
                        changed[at] = (pairs[at].0, j);
                        all.push(Reading { pairs: changed, concerns: concerns.clone() });
                    }
                    all.push(Reading { pairs: stolen, concerns });
                }
            }
        }
        for &other in problem.candidates(j) {
            if other != i && !pairs.iter().any(|p| p.0 == other) && is_near(problem, refined, (other, j)) {
                let mut changed = pairs.clone();
                changed[k] = (other, j);
                all.push(Reading { pairs: changed, concerns: vec![(j, Doubt::Detection)] });
            }
        }
    }
    all
}

fn is_near(problem: &Problem<'_>, refined: &Refined, pair: Pair) -> bool {
    let covariance = refined.covariance * 4.0;
    problem.candidates(pair.1).contains(&pair.0)
        && problem.outline_fits(pair, &refined.outlines)
        && super::fit::squared_distance(pair, &refined.predicted, problem.detections, &covariance, false)
            < NEIGHBOURHOOD
}

impl Problem<'_> {
    /// The same solution with other pairs.
    pub(super) fn refit_pairs(&self, refined: &Refined, pairs: Vec<Pair>) -> Option<Refined> {
        let first = self.solve_step(&pairs, &refined.predicted, &refined.prior, &refined.state)?;
        let state = refined.state + first.delta;
        let predicted = self.scene.linearise(&state);
        let step = self.solve_step(&pairs, &predicted, &refined.prior, &state)?;
        Some(Refined {
            state: state + step.delta,
            covariance: step.covariance,
            evidence: step.evidence,
            predicted: shift_predictions(&predicted, &step),
            pairs,
            prior: refined.prior.clone(),
            outlines: self.scene.marker_outlines(&state),
        })
    }
}
