//! Identities in flight: scan, refine, decide, report.

use super::decide::{MIN_LOG_ODDS, Decision, Doubt, decide_pairs};
use super::fit::Pair;
use super::matching::{Problem, Refined};
use super::scan::{Guess, scan_deflections};
use super::scene::{Scene, is_usable};
use super::{IdentifyError, Identities};
use crate::detect::Detection;
use crate::geometry::Lens;

/// Fewer pairs leave nothing to check a solution with.
pub(super) const MIN_IDENTIFIED: usize = 4;
/// ln of the odds against "nothing but clutter", over some hundred guesses.
const MIN_LOG_ODDS_CHANCE: f64 = 16.0;

/// Identities of one frame, and the fitted state they stand on.
pub(super) fn identify_frame(scene: &Scene<'_>, detections: &[Detection]) -> Result<Identities, IdentifyError> {
    let found = detections.iter().filter(|d| is_usable(d)).count();
    if found < MIN_IDENTIFIED {
        return Err(IdentifyError::TooFew { found, needed: MIN_IDENTIFIED });
    }
    let problem = Problem::new(scene, detections);
    let solutions = find_solutions(&problem);
    let Some(best) = solutions.first() else {
        return Err(IdentifyError::NoConsensus { matched: 0, found });
    };
    if best.evidence < MIN_LOG_ODDS_CHANCE {
        return Err(IdentifyError::NoConsensus { matched: best.pairs.len(), found });
    }
    let mut decision = decide_pairs(&problem, best.clone());
    let rivals = mark_ambiguous(&mut decision, &solutions);
    let identities = build_identities(&problem, &decision);
    let certain = identities.marker_of.iter().flatten().count();
    if certain < MIN_IDENTIFIED {
        return Err(IdentifyError::Ambiguous { solutions: rivals + 2 });
    }
    Ok(identities)
}

/// Refined guesses, the strongest evidence first.
pub(super) fn find_solutions(problem: &Problem<'_>) -> Vec<Refined> {
    let mut solutions: Vec<Refined> = Vec::new();
    for guess in scan_deflections(problem) {
        let most = solutions.iter().map(|s| s.pairs.len()).max().unwrap_or(0);
        if 2 * guess.pairs.len() < most || solutions.iter().any(|s| leads_to_solution(&guess, s)) {
            continue;
        }
        let refined = problem.refine(&guess.prior, &guess.pairs);
        solutions.extend(refined.filter(|r| solutions.iter().all(|s| s.pairs != r.pairs)));
    }
    solutions.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    solutions
}

/// Whether a guess is but another start to a solution that is already there. A reading that could
/// rival it contradicts it in many pairs; a few are looked at one by one later.
fn leads_to_solution(guess: &Guess, solution: &Refined) -> bool {
    let against = guess.pairs.iter().filter(|p| find_contradiction(&solution.pairs, **p).is_some()).count();
    against < 3 || 10 * against < 3 * solution.pairs.len()
}

/// Other solutions with about the same evidence put in doubt what they tell otherwise.
fn mark_ambiguous(decision: &mut Decision, solutions: &[Refined]) -> usize {
    let limit = decision.refined.evidence - MIN_LOG_ODDS;
    let mut rivals = 0;
    for rival in solutions.iter().filter(|s| s.evidence > limit) {
        let mut differs = false;
        for &(i, j) in &decision.refined.pairs {
            if let Some(doubt) = find_contradiction(&rival.pairs, (i, j)) {
                differs = true;
                if !decision.doubtful.iter().any(|d| d.0 == j) {
                    decision.doubtful.push((j, doubt));
                }
            }
        }
        rivals += usize::from(differs);
    }
    rivals
}

fn find_contradiction(pairs: &[Pair], (i, j): Pair) -> Option<Doubt> {
    pairs.iter().find_map(|&(a, b)| match (a == i, b == j) {
        (true, false) => Some(Doubt::Marker(b)),
        (false, true) => Some(Doubt::Detection),
        _ => None,
    })
}

pub(super) fn build_identities(problem: &Problem<'_>, decision: &Decision) -> Identities {
    let refined = &decision.refined;
    let mut identities = Identities {
        marker_of: vec![None; problem.detections.len()],
        missing: Vec::new(),
        tip_deflection_m: problem.scene.deflection_m(&refined.state, problem.scene.outermost_marker()),
    };
    for j in 0..problem.scene.setup.markers.len() {
        let detection = refined.pairs.iter().find(|p| p.1 == j).map(|p| p.0);
        let doubt = decision.doubtful.iter().find(|d| d.0 == j).map(|d| d.1);
        match (detection, doubt) {
            (Some(i), None) => identities.marker_of[i] = Some(j),
            (_, Some(doubt)) => identities.missing.push((j, ambiguity_text(problem, doubt))),
            (None, None) => {
                let pixel = refined.predicted.get(j).copied().flatten().map(|p| p.pixel);
                identities.missing.push((j, absence_text(&problem.scene.setup.lens, pixel)));
            }
        }
    }
    identities
}

fn ambiguity_text(problem: &Problem<'_>, doubt: Doubt) -> String {
    match doubt {
        Doubt::Detection => "two detections fit alike".to_string(),
        Doubt::Marker(other) => {
            let id = problem.scene.setup.markers.get(other).map_or("another marker", |m| m.id.as_str());
            format!("its detection fits {id} alike")
        }
    }
}

/// Why a marker without a detection has none.
pub(super) fn absence_text(lens: &Lens, pixel: Option<nalgebra::Vector2<f64>>) -> String {
    match pixel {
        None => "behind the camera".to_string(),
        Some(p) if lens.contains(&p) => format!("not found near the predicted ({:.0}, {:.0}) px", p.x, p.y),
        Some(p) => format!("outside the frame: predicted at ({:.0}, {:.0}) px", p.x, p.y),
    }
}
