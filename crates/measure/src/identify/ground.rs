//! Orientation from ground frames: consensus, identities, then one adjustment of all frames.

use super::beam::WingState;
use super::bias::correct_centres;
use super::consensus::{Consensus, find_consensus, pairs_from_rotation};
use super::decide::decide_pairs;
use super::fit::StatePrior;
use super::flight::{MIN_IDENTIFIED, build_identities};
use super::matching::MatchingProblem;
use super::refine::{self, AdjustedOrientation, GroundImage, adjust_orientation};
use super::scene::{WingView, is_usable, looks_like};
use super::{IdentifyError, Identities, Misfit, OrientationFit};
use crate::detect::Detection;
use crate::observation::{Estimate, Observation};
use crate::setup::{Orientation, Setup};

/// Standard deviation of the consensus rotation, rad.
const CONSENSUS_SIGMA: f64 = 2e-3;
const REJECTED_REASON: &str =
    "its image disagrees with the survey and the other markers; check the survey of this marker";

/// Estimates the orientation from ground frames without an initial guess (docs/identification.md). All frames show the wing as
/// surveyed, from one mounting of the camera.
///
/// # Errors
/// Returns an error if too few markers are found, a frame does not fit the others, or none or more than one solution fits.
pub fn estimate_orientation(
    setup: &Setup,
    frames: &[Vec<Detection>],
) -> Result<OrientationFit, IdentifyError> {
    check_marked(setup, frames)?;
    let first = first_consensus(setup, frames)?;
    let mut orientation = Orientation::from_rotation(first.camera_from_survey);
    let mut identities: Vec<Identities> = frames
        .iter()
        .map(|f| identities_on_ground(setup, &orientation, f))
        .collect();
    let mut fitted = None;
    // The bias of the outlines depends on the attitude, so there are two passes.
    for _ in 0..2 {
        let scene = WingView::on_ground(setup, &orientation);
        let corrected: Vec<_> = frames
            .iter()
            .zip(&identities)
            .map(|(f, i)| correct_centres(&scene, &WingState::zeros(), f, i))
            .collect();
        let images = identified_ground_images(&corrected, &identities);
        let adjusted = adjust_orientation(setup, &orientation.camera_from_survey, images);
        let Some(adjusted) = adjusted.filter(|a| a.used.len() >= MIN_IDENTIFIED) else {
            let found = frames.iter().map(Vec::len).sum();
            return Err(IdentifyError::NoConsensus {
                matched: first.pairs.len(),
                found,
            });
        };
        orientation = adjusted.orientation.clone();
        fitted = Some(adjusted);
    }
    let Some(fitted) = fitted else {
        return Err(IdentifyError::TooFew {
            found: 0,
            needed: MIN_IDENTIFIED,
        });
    };
    let used_frames: Vec<usize> = fitted.used.iter().map(|(s, _)| s.frame).collect();
    if let Some(misfit) = find_misfit(setup, frames, &used_frames) {
        let in_flight = WingView::in_flight(setup, &orientation);
        let cause = frames
            .get(misfit.frame)
            .and_then(|f| in_flight.diagnose_misfit(f));
        return Err(IdentifyError::Misfit(Misfit { cause, ..misfit }));
    }
    let scene = WingView::on_ground(setup, &orientation);
    let bend = estimate_bend(&scene, &fitted);
    for (detections, of_frame) in frames.iter().zip(&mut identities) {
        explain_missing(&scene, detections, of_frame);
    }
    for image in &fitted.rejected {
        if let Some(of_frame) = identities.get_mut(image.frame) {
            if let Some(slot) = of_frame.marker_of.get_mut(image.detection) {
                *slot = None;
            }
            of_frame
                .missing
                .push((image.seen.marker, REJECTED_REASON.to_string()));
        }
    }
    Ok(OrientationFit {
        orientation,
        variance_factor: fitted.variance_factor,
        redundancy: fitted.redundancy,
        bend,
        residuals: fitted
            .used
            .iter()
            .map(|(s, v)| (s.frame, s.seen.marker, *v))
            .collect(),
        identities,
    })
}

/// Returns an error if the survey has points, and too few of them are marked to determine an orientation with the decals.
fn check_marked(setup: &Setup, frames: &[Vec<Detection>]) -> Result<(), IdentifyError> {
    let points = (0..setup.markers.len())
        .filter(|&k| setup.is_point(k))
        .count();
    let decals = setup.markers.len() - points;
    let is_marked = |d: &&Detection| d.marker.is_some_and(|k| setup.is_point(k));
    let marked = frames
        .iter()
        .map(|frame| frame.iter().filter(is_marked).count())
        .max()
        .unwrap_or(0);
    let needed = MIN_IDENTIFIED;
    if points > 0 && decals + marked < needed {
        Err(IdentifyError::Unmarked {
            decals,
            marked,
            needed,
        })
    } else {
        Ok(())
    }
}

/// Estimates how much higher the wing was than surveyed. A bend makes the outer markers look wrong, so rejected images are
/// used too.
fn estimate_bend(scene: &WingView, fitted: &AdjustedOrientation) -> Option<Estimate> {
    let to_survey = scene.beam.frame.wing_from_survey.inverse();
    let by_bend: Vec<_> = scene
        .beam
        .bend_displacements()
        .iter()
        .map(|by| to_survey * by)
        .collect();
    let images = fitted
        .used
        .iter()
        .map(|(image, _)| image)
        .chain(&fitted.rejected)
        .cloned()
        .collect();
    refine::estimate_bend(
        scene.setup,
        &fitted.orientation.camera_from_survey,
        &by_bend,
        images,
    )
}

/// Finds a frame that hardly fits the other frames; a single frame was decided by its consensus. Neither additional false
/// detections (if half of the survey is identified) nor frames with few markers are a misfit.
fn find_misfit(setup: &Setup, frames: &[Vec<Detection>], used_frames: &[usize]) -> Option<Misfit> {
    let misfit = |(frame, detections): (usize, &Vec<Detection>)| {
        let matched = used_frames.iter().filter(|f| **f == frame).count();
        let found = detections.iter().filter(|d| is_usable(d)).count();
        let few = 2 * matched < found && 2 * matched < setup.markers.len();
        (matched < MIN_IDENTIFIED || few).then_some(Misfit {
            frame,
            matched,
            found,
            cause: None,
        })
    };
    frames
        .iter()
        .enumerate()
        .filter(|_| frames.len() > 1)
        .find_map(misfit)
}

/// Returns the consensus of the best frame, or the most informative error if no frame has one.
fn first_consensus(setup: &Setup, frames: &[Vec<Detection>]) -> Result<Consensus, IdentifyError> {
    let mut best: Option<Consensus> = None;
    let mut failure = IdentifyError::TooFew {
        found: 0,
        needed: MIN_IDENTIFIED,
    };
    for frame in frames {
        match find_consensus(setup, frame) {
            Ok(next) => {
                if best
                    .as_ref()
                    .is_none_or(|b| b.pairs.len() < next.pairs.len())
                {
                    best = Some(next);
                }
            }
            Err(error) => failure = more_promising_error(failure, error),
        }
    }
    best.ok_or(failure)
}

fn more_promising_error(a: IdentifyError, b: IdentifyError) -> IdentifyError {
    let rank = |e: &IdentifyError| match e {
        IdentifyError::TooFew { found, .. } => *found,
        IdentifyError::NoConsensus { matched, .. } => 1_000 + matched,
        _ => 10_000,
    };
    if rank(&b) > rank(&a) { b } else { a }
}

/// Identifies the markers of a ground frame by the matching in flight with a wing that cannot bend.
fn identities_on_ground(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
) -> Identities {
    let scene = WingView::on_ground(setup, orientation);
    let problem = MatchingProblem::new(&scene, detections);
    let fixed = 1e-9;
    let turn = CONSENSUS_SIGMA;
    let sigma = WingState::from([fixed, fixed, fixed, fixed, fixed, turn, turn, turn]);
    let prior = StatePrior {
        mean: WingState::zeros(),
        sigma,
    };
    let start = pairs_from_rotation(setup, detections, &orientation.camera_from_survey);
    match problem.refine(&prior, &start) {
        Some(refined) => build_identities(&problem, &decide_pairs(&problem, refined)),
        None => Identities {
            marker_of: vec![None; detections.len()],
            missing: (0..setup.markers.len())
                .map(|j| (j, "no orientation fits this frame".into()))
                .collect(),
            ..Identities::default()
        },
    }
}

/// Explains missing markers of which a similar detection is at the expected position.
fn explain_missing(scene: &WingView<'_>, detections: &[Detection], identities: &mut Identities) {
    let outlines = scene.marker_outlines(&WingState::zeros());
    let named = |i: usize| identities.marker_of.get(i).copied().flatten().is_some();
    let free: Vec<&Detection> = (0..detections.len())
        .filter(|i| !named(*i))
        .map(|i| &detections[i])
        .collect();
    for (marker, reason) in &mut identities.missing {
        let (surveyed, Some(Some(outline))) =
            (&scene.setup.markers[*marker], outlines.get(*marker))
        else {
            continue;
        };
        let similar = |d: &&&Detection| {
            is_usable(d)
                && looks_like(d, scene.setup, *marker, outline.semi_major_px)
                && (d.centre_px - outline.ellipse_px).norm() < outline.semi_major_px
        };
        if let Some(seen) = free.iter().find(similar) {
            *reason = format!(
                "a {} is at its position ({:.0}, {:.0}) px, but with another outline: it is partly hidden, or its \
                 diameter_m is wrong",
                surveyed.shape.name(),
                seen.centre_px.x,
                seen.centre_px.y
            );
        }
    }
}

fn identified_ground_images(
    frames: &[Vec<Detection>],
    identities: &[Identities],
) -> Vec<GroundImage> {
    let mut images = Vec::new();
    for (frame, (detections, of_frame)) in frames.iter().zip(identities).enumerate() {
        for (detection, (d, marker)) in detections.iter().zip(&of_frame.marker_of).enumerate() {
            if let Some(marker) = *marker {
                let seen = Observation {
                    marker,
                    pixel: d.centre_px,
                    covariance_px2: *d.covariance_px2,
                };
                images.push(GroundImage {
                    frame,
                    detection,
                    seen,
                });
            }
        }
    }
    images
}
