//! Identities in flight: scan, refinement, decision, report.

use super::decide::{Ambiguity, MIN_LOG_ODDS, MatchDecision, decide_pairs};
use super::fit::MatchedPair;
use super::matching::{MatchingProblem, RefinedMatch};
use super::scan::{StateGuess, scan_deflections};
use super::scene::{PredictedImage, WingView, is_usable};
use super::{IdentifyError, Identities};
use crate::detect::Detection;
use crate::geometry::Lens;
use crate::ordering::sort_by_value;

/// Minimum number of pairs; fewer leave no redundancy.
pub const MIN_IDENTIFIED: usize = 4;
/// Minimum log odds against false candidates alone, for some hundred guesses.
const MIN_LOG_ODDS_CHANCE: f64 = 16.0;

impl WingView<'_> {
    /// Identifies the markers of a frame.
    ///
    /// # Errors
    /// Returns an error if too few markers are found, or none or more than one solution fits.
    pub fn identify_markers(&self, detections: &[Detection]) -> Result<Identities, IdentifyError> {
        let found = detections.iter().filter(|d| is_usable(d)).count();
        if found < MIN_IDENTIFIED {
            return Err(IdentifyError::TooFew {
                found,
                needed: MIN_IDENTIFIED,
            });
        }
        let problem = MatchingProblem::new(self, detections);
        let solutions = find_solutions(&problem);
        let Some(best) = solutions.first() else {
            return Err(IdentifyError::NoConsensus { matched: 0, found });
        };
        if best.evidence < MIN_LOG_ODDS_CHANCE {
            return Err(IdentifyError::NoConsensus {
                matched: best.pairs.len(),
                found,
            });
        }
        let mut decision = decide_pairs(&problem, best.clone());
        let rivals = mark_ambiguous(&mut decision, &solutions);
        let identities = build_identities(&problem, &decision);
        let certain = identities.count_named();
        if certain < MIN_IDENTIFIED {
            return Err(IdentifyError::Ambiguous {
                solutions: rivals + 2,
            });
        }
        Ok(identities)
    }
}

/// Returns refined guesses, strongest evidence first.
pub(super) fn find_solutions(problem: &MatchingProblem<'_>) -> Vec<RefinedMatch> {
    let mut solutions: Vec<RefinedMatch> = Vec::new();
    for guess in scan_deflections(problem) {
        let most = solutions.iter().map(|s| s.pairs.len()).max().unwrap_or(0);
        if 2 * guess.pairs.len() < most || solutions.iter().any(|s| leads_to_solution(&guess, s)) {
            continue;
        }
        let refined = problem.refine(&guess.prior, &guess.pairs);
        solutions.extend(refined.filter(|r| solutions.iter().all(|s| s.pairs != r.pairs)));
    }
    sort_by_value(&mut solutions, |one| -one.evidence);
    solutions
}

/// Returns true if a guess is another start to a known solution. A rival contradicts it in many pairs; a few differences
/// are examined one by one later.
fn leads_to_solution(guess: &StateGuess, solution: &RefinedMatch) -> bool {
    let against = guess
        .pairs
        .iter()
        .filter(|p| find_conflicting_pair(&solution.pairs, **p).is_some())
        .count();
    against < 3 || 10 * against < 3 * solution.pairs.len()
}

/// Marks as ambiguous the markers for which other solutions of similar evidence differ. Returns the number of such
/// solutions.
fn mark_ambiguous(decision: &mut MatchDecision, solutions: &[RefinedMatch]) -> usize {
    let limit = decision.refined.evidence - MIN_LOG_ODDS;
    let mut rivals = 0;
    for rival in solutions.iter().filter(|s| s.evidence > limit) {
        let mut differs = false;
        for &(i, j) in &decision.refined.pairs {
            if let Some(ambiguity) = find_conflicting_pair(&rival.pairs, (i, j)) {
                differs = true;
                if !decision.ambiguous.iter().any(|d| d.0 == j) {
                    decision.ambiguous.push((j, ambiguity));
                }
            }
        }
        rivals += usize::from(differs);
    }
    rivals
}

/// Returns how another solution contradicts a pair: it gives the detection another marker, or the marker another detection.
fn find_conflicting_pair(pairs: &[MatchedPair], (i, j): MatchedPair) -> Option<Ambiguity> {
    pairs.iter().find_map(|&(a, b)| match (a == i, b == j) {
        (true, false) => Some(Ambiguity::Marker(b)),
        (false, true) => Some(Ambiguity::Detection),
        _ => None,
    })
}

pub(super) fn build_identities(
    problem: &MatchingProblem<'_>,
    decision: &MatchDecision,
) -> Identities {
    let refined = &decision.refined;
    let mut identities = Identities {
        marker_of: vec![None; problem.detections.len()],
        missing: Vec::new(),
        tip_deflection_m: problem
            .scene
            .deflection_m(&refined.state, problem.scene.outermost_marker()),
        visible: 0,
    };
    let is_shown = |(j, p): (usize, &Option<PredictedImage>)| {
        // Points are found after the decals, and on the ground only if they were marked.
        let is_decal = !problem.scene.setup.is_point(j);
        let is_known = || problem.detections.iter().any(|d| d.marker == Some(j));
        p.as_ref()
            .is_some_and(|p| problem.scene.setup.lens.contains(&p.pixel))
            && (is_decal || is_known())
    };
    identities.visible = refined
        .predicted
        .iter()
        .enumerate()
        .filter(|shown| is_shown(*shown))
        .count();
    for j in 0..problem.scene.setup.markers.len() {
        let detection = refined.pairs.iter().find(|p| p.1 == j).map(|p| p.0);
        let ambiguity = decision.ambiguous.iter().find(|d| d.0 == j).map(|d| d.1);
        match (detection, ambiguity) {
            (Some(i), None) => identities.marker_of[i] = Some(j),
            (_, Some(ambiguity)) => identities
                .missing
                .push((j, ambiguity_text(problem, ambiguity))),
            (None, None) => {
                let pixel = refined.predicted.get(j).copied().flatten().map(|p| p.pixel);
                identities
                    .missing
                    .push((j, absence_text(&problem.scene.setup.lens, pixel)));
            }
        }
    }
    identities
}

fn ambiguity_text(problem: &MatchingProblem<'_>, ambiguity: Ambiguity) -> String {
    match ambiguity {
        Ambiguity::Detection => "two detections fit equally well".to_string(),
        Ambiguity::Marker(other) => {
            let id = problem
                .scene
                .setup
                .markers
                .get(other)
                .map_or("another marker", |m| m.id.as_str());
            format!("its detection fits {id} equally well")
        }
    }
}

/// Explains a marker without a detection.
pub(super) fn absence_text(lens: &Lens, pixel: Option<nalgebra::Vector2<f64>>) -> String {
    match pixel {
        None => "behind the camera".to_string(),
        Some(p) if lens.contains(&p) => {
            format!("not found near the predicted ({:.0}, {:.0}) px", p.x, p.y)
        }
        Some(p) => format!(
            "outside the frame: predicted at ({:.0}, {:.0}) px",
            p.x, p.y
        ),
    }
}
