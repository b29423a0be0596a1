//! Ambiguous pairs: decided by likelihood ratio, or reported as undecided.

use super::fit::MatchedPair;
use super::matching::{GATE, MatchingProblem, RefinedMatch, shift_predictions};

/// Minimum log odds of a match against any alternative.
pub(super) const MIN_LOG_ODDS: f64 = 9.0;
/// Squared distance within which alternatives are examined: the gate, extended by the pull of a wrong neighbour on the fit.
const NEIGHBOURHOOD: f64 = 6.0 * GATE;

/// Matched pairs, and the markers that are ambiguous.
pub(super) struct MatchDecision {
    pub(super) refined: RefinedMatch,
    /// Ambiguous markers, with the alternative marker or detection.
    pub(super) ambiguous: Vec<(usize, Ambiguity)>,
}

/// Alternative to a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ambiguity {
    /// Another marker explains the detection as well.
    Marker(usize),
    /// Another detection fits the marker as well.
    Detection,
}

/// Alternative pairs, and the markers that they concern.
struct AlternativeMatch {
    pairs: Vec<MatchedPair>,
    concerns: Vec<(usize, Ambiguity)>,
}

/// Accepts better alternatives until there is none, then lists the ambiguous markers.
pub(super) fn decide_pairs(
    problem: &MatchingProblem<'_>,
    mut refined: RefinedMatch,
) -> MatchDecision {
    for _ in 0..4 {
        let better = list_alternatives(problem, &refined)
            .into_iter()
            .filter_map(|r| Some((evidence_for_pairs(problem, &refined, &r.pairs)?, r)))
            .filter(|(e, _)| *e > refined.evidence + 1e-6)
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, reading)) = better else { break };
        let Some(next) = problem.refit_pairs(&refined, reading.pairs) else {
            break;
        };
        if next.evidence <= refined.evidence {
            break;
        }
        refined = next;
    }
    let mut ambiguous: Vec<(usize, Ambiguity)> = Vec::new();
    for reading in list_alternatives(problem, &refined) {
        let close = evidence_for_pairs(problem, &refined, &reading.pairs)
            .is_some_and(|e| e > refined.evidence - MIN_LOG_ODDS);
        if close {
            for concern in reading.concerns {
                if !ambiguous.iter().any(|d| d.0 == concern.0) {
                    ambiguous.push(concern);
                }
            }
        }
    }
    MatchDecision { refined, ambiguous }
}

fn evidence_for_pairs(
    problem: &MatchingProblem<'_>,
    refined: &RefinedMatch,
    pairs: &[MatchedPair],
) -> Option<f64> {
    problem
        .solve_step(pairs, &refined.predicted, &refined.prior, &refined.state)
        .map(|s| s.evidence)
}

/// Lists all matches that differ by one exchange: a detection given to another marker, two detections swapped, or a marker
/// given another detection.
fn list_alternatives(
    problem: &MatchingProblem<'_>,
    refined: &RefinedMatch,
) -> Vec<AlternativeMatch> {
    let mut all = Vec::new();
    let pairs = &refined.pairs;
    for (k, &(i, j)) in pairs.iter().enumerate() {
        for other in 0..refined.predicted.len() {
            if other == j || !is_pair_plausible(problem, refined, (i, other)) {
                continue;
            }
            let mut changed = pairs.clone();
            changed[k] = (i, other);
            match pairs.iter().position(|p| p.1 == other) {
                None => all.push(AlternativeMatch {
                    pairs: changed,
                    concerns: vec![(j, Ambiguity::Marker(other))],
                }),
                Some(at) => {
                    let mut stolen = changed.clone();
                    stolen.remove(at);
                    let concerns =
                        vec![(j, Ambiguity::Marker(other)), (other, Ambiguity::Marker(j))];
                    if is_pair_plausible(problem, refined, (pairs[at].0, j)) {
                        changed[at] = (pairs[at].0, j);
                        all.push(AlternativeMatch {
                            pairs: changed,
                            concerns: concerns.clone(),
                        });
                    }
                    all.push(AlternativeMatch {
                        pairs: stolen,
                        concerns,
                    });
                }
            }
        }
        for &other in problem.candidates(j) {
            if other != i
                && !pairs.iter().any(|p| p.0 == other)
                && is_pair_plausible(problem, refined, (other, j))
            {
                let mut changed = pairs.clone();
                changed[k] = (other, j);
                all.push(AlternativeMatch {
                    pairs: changed,
                    concerns: vec![(j, Ambiguity::Detection)],
                });
            }
        }
    }
    all
}

fn is_pair_plausible(
    problem: &MatchingProblem<'_>,
    refined: &RefinedMatch,
    pair: MatchedPair,
) -> bool {
    let covariance = refined.covariance * 4.0;
    problem.candidates(pair.1).contains(&pair.0)
        && problem.is_outline_compatible(pair, &refined.outlines)
        && super::fit::squared_distance(
            pair,
            &refined.predicted,
            problem.detections,
            &covariance,
            false,
        ) < NEIGHBOURHOOD
}

impl MatchingProblem<'_> {
    /// Refits a solution with other pairs.
    pub(super) fn refit_pairs(
        &self,
        refined: &RefinedMatch,
        pairs: Vec<MatchedPair>,
    ) -> Option<RefinedMatch> {
        let first = self.solve_step(&pairs, &refined.predicted, &refined.prior, &refined.state)?;
        let state = refined.state + first.delta;
        let predicted = self.scene.linearise(&state);
        let step = self.solve_step(&pairs, &predicted, &refined.prior, &state)?;
        Some(RefinedMatch {
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
