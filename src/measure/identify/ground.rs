//! Orientation from ground frames: consensus, identities, then one adjustment of all frames.

use super::beam::State;
use super::bias::correct_centres;
use super::consensus::{Consensus, find_consensus, pairs_from_rotation};
use super::decide::decide_pairs;
use super::diagnose::diagnose_misfit;
use super::fit::Prior;
use super::flight::{MIN_IDENTIFIED, build_identities};
use super::matching::Problem;
use super::refine::{self, Adjusted, GroundImage, adjust_orientation};
use super::scene::{Scene, looks_like, is_usable};
use super::{IdentifyError, Identities, Misfit, OrientationFit};
use crate::detect::Detection;
use crate::observation::Estimate;
use crate::setup::{Orientation, Setup};

/// How well the consensus knows the rotation, rad.
const CONSENSUS_SIGMA: f64 = 2e-3;
const REJECTED_REASON: &str =
    "its image disagrees with the survey and the other markers; check the survey of this marker";

/// See [`super::orient`].
pub(super) fn orient_frames(setup: &Setup, frames: &[Vec<Detection>]) -> Result<OrientationFit, IdentifyError> {
    let first = first_consensus(setup, frames)?;
    let mut orientation = Orientation {
        camera_from_survey: first.camera_from_survey,
        covariance_rad2: None,
        ground: Vec::new(),
    };
    let mut identities: Vec<Identities> =
        frames.iter().map(|f| identities_on_ground(setup, &orientation, f)).collect();
    let mut fitted = None;
    // The bias of the outlines hangs on the attitude: two passes.
    for _ in 0..2 {
        let scene = Scene::new(setup, &orientation, false);
        let corrected: Vec<_> =
            frames.iter().zip(&identities).map(|(f, i)| correct_centres(&scene, &State::zeros(), f, i)).collect();
        let sights = ground_images(&corrected, &identities);
        let adjusted = adjust_orientation(setup, &orientation.camera_from_survey, sights);
        let Some(adjusted) = adjusted.filter(|a| a.used.len() >= MIN_IDENTIFIED) else {
            let found = frames.iter().map(Vec::len).sum();
            return Err(IdentifyError::NoConsensus { matched: first.pairs.len(), found });
        };
        orientation = adjusted.orientation.clone();
        fitted = Some(adjusted);
    }
    let Some(fitted) = fitted else {
        return Err(IdentifyError::TooFew { found: 0, needed: MIN_IDENTIFIED });
    };
    let of_used: Vec<usize> = fitted.used.iter().map(|(s, _)| s.frame).collect();
    if let Some(misfit) = find_misfit(setup, frames, &of_used) {
        let cause = frames.get(misfit.frame).and_then(|f| diagnose_misfit(setup, &orientation, f));
        return Err(IdentifyError::Misfit(Misfit { cause, ..misfit }));
    }
    let scene = Scene::new(setup, &orientation, false);
    let bend = estimate_bend(&scene, &fitted);
    for (detections, of) in frames.iter().zip(&mut identities) {
        explain_missing(&scene, detections, of);
    }
    for sight in &fitted.taken_out {
        if let Some(of) = identities.get_mut(sight.frame) {
            if let Some(slot) = of.marker_of.get_mut(sight.detection) {
                *slot = None;
            }
            of.missing.push((sight.marker, REJECTED_REASON.to_string()));
        }
    }
    Ok(OrientationFit {
        orientation,
        variance_factor: fitted.variance_factor,
        redundancy: fitted.redundancy,
        bend,
        residuals: fitted.used.iter().map(|(s, v)| (s.frame, s.marker, *v)).collect(),
        identities,
    })
}

/// How much higher the wing stood than surveyed. A bend makes the outer markers look wrong: they are asked, too.
fn estimate_bend(scene: &Scene, fitted: &Adjusted) -> Option<Estimate> {
    let to_survey = scene.beam.frame.wing_from_survey.inverse();
    let by_bend: Vec<_> = scene.beam.bend_displacements().iter().map(|by| to_survey * by).collect();
    let sights = fitted.used.iter().map(|(sight, _)| sight).chain(&fitted.taken_out).cloned().collect();
    refine::estimate_bend(scene.setup, &fitted.orientation.camera_from_survey, &by_bend, sights)
}

/// A frame among others of which hardly anything fits; of one alone the consensus has decided. What clutter adds to a frame in which half of the survey is found is no
/// misfit, nor are the few markers of a frame that hardly shows any.
fn find_misfit(setup: &Setup, frames: &[Vec<Detection>], of_used: &[usize]) -> Option<Misfit> {
    let of = |(frame, detections): (usize, &Vec<Detection>)| {
        let matched = of_used.iter().filter(|f| **f == frame).count();
        let found = detections.iter().filter(|d| is_usable(d)).count();
        let few = 2 * matched < found && 2 * matched < setup.markers.len();
        (matched < MIN_IDENTIFIED || few).then_some(Misfit { frame, matched, found, cause: None })
    };
    frames.iter().enumerate().filter(|_| frames.len() > 1).find_map(of)
}

/// The best frame's consensus; the reason of the most promising failure where none has one.
fn first_consensus(setup: &Setup, frames: &[Vec<Detection>]) -> Result<Consensus, IdentifyError> {
    let mut best: Option<Consensus> = None;
    let mut failure = IdentifyError::TooFew { found: 0, needed: MIN_IDENTIFIED };
    for frame in frames {
        match find_consensus(setup, frame) {
            Ok(next) => {
                if best.as_ref().is_none_or(|b| b.pairs.len() < next.pairs.len()) {
                    best = Some(next);
                }
            }
            Err(error) => failure = more_promising(failure, error),
        }
    }
    best.ok_or(failure)
}

fn more_promising(a: IdentifyError, b: IdentifyError) -> IdentifyError {
    let rank = |e: &IdentifyError| match e {
        IdentifyError::TooFew { found, .. } => *found,
        IdentifyError::NoConsensus { matched, .. } => 1_000 + matched,
        IdentifyError::Misfit(_) | IdentifyError::Ambiguous { .. } => 10_000,
    };
    if rank(&b) > rank(&a) { b } else { a }
}

/// The flight's matching with a wing that cannot bend.
fn identities_on_ground(setup: &Setup, orientation: &Orientation, detections: &[Detection]) -> Identities {
    let scene = Scene::new(setup, orientation, false);
    let problem = Problem::new(&scene, detections);
    let fixed = 1e-9;
    let turn = CONSENSUS_SIGMA;
    let sigma = State::from([fixed, fixed, fixed, fixed, fixed, turn, turn, turn]);
    let prior = Prior { mean: State::zeros(), sigma };
    let start = pairs_from_rotation(setup, detections, &orientation.camera_from_survey);
    match problem.refine(&prior, &start) {
        Some(refined) => build_identities(&problem, &decide_pairs(&problem, refined)),
        None => Identities {
            marker_of: vec![None; detections.len()],
            missing: (0..setup.markers.len()).map(|j| (j, "this frame fits no orientation".into())).collect(),
            tip_deflection_m: 0.0,
        },
    }
}

/// Says of each marker that is missing within the frame where one like it is seen that is no other marker: a
/// survey point that is wrong is seen, but elsewhere.
fn explain_missing(scene: &Scene<'_>, detections: &[Detection], of: &mut Identities) {
    let pixels = scene.project_markers(&State::zeros());
    let outlines = scene.marker_outlines(&State::zeros());
    let free = |i: &usize| of.marker_of.get(*i).is_some_and(Option::is_none);
    let free: Vec<&Detection> = (0..detections.len()).filter(free).map(|i| &detections[i]).collect();
    for (marker, reason) in &mut of.missing {
        let surveyed = &scene.setup.markers[*marker];
        let (Some(Some(at)), Some(Some(outline))) = (pixels.get(*marker), outlines.get(*marker)) else {
            continue;
        };
        if !scene.setup.lens.contains(at) {
            continue;
        }
        let like = free.iter().filter(|d| is_usable(d) && looks_like(d, surveyed.shape, outline.semi_major_px));
        let off = |d: &&&Detection| (d.centre_px - at).norm();
        let Some(nearest) = like.min_by(|a, b| off(a).total_cmp(&off(b))) else { continue };
        let (seen, off_px) = (nearest.centre_px, off(&nearest));
        if off_px < outline.semi_major_px {
            *reason = format!(
                "a {} is at ({:.0}, {:.0}) px, where it is expected, but with another outline: check its diameter_m and \
                 the survey of its neighbours",
                surveyed.shape.name(),
                seen.x,
                seen.y
            );
            continue;
        }
        let distance_m = (surveyed.position_m - scene.setup.projection_centre_m).norm();
        *reason = format!(
            "expected at ({:.0}, {:.0}) px and not there; a {} like it that is no other marker is at ({:.0}, {:.0}) px: \
             its survey may be wrong by {:.2} m or more; survey it again",
            at.x,
            at.y,
            surveyed.shape.name(),
            seen.x,
            seen.y,
            off_px * distance_m / scene.setup.lens.focal_px()
        );
    }
}

fn ground_images(frames: &[Vec<Detection>], identities: &[Identities]) -> Vec<GroundImage> {
    let mut sights = Vec::new();
    for (frame, (detections, of)) in frames.iter().zip(identities).enumerate() {
        for (detection, (d, marker)) in detections.iter().zip(&of.marker_of).enumerate() {
            if let Some(marker) = *marker {
                let (pixel, covariance_px2) = (d.centre_px, *d.covariance_px2);
                sights.push(GroundImage { frame, detection, marker, pixel, covariance_px2 });
            }
        }
    }
    sights
}
