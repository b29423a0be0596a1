//! Identities of a ground frame that a gross error hides: the setup is modified until most detections fit.

use super::super::bias::correct_centres;
use super::super::consensus::list_candidates;
use super::super::fit::{MatchedPair, select_one_to_one};
use super::super::outline::DiscOutline;
use super::super::scene::{WingView, is_usable};
use super::super::{Identities, OrientationFit, estimate_orientation};
use super::cause::{Cause, UNITS, is_bent, span_m};
use super::evidence::{Evidence, Pose, predict_outlines, start_pose};
use super::subject::Subject;
use super::{Diagnosis, GROSS, named_image, rank_causes};
use crate::detect::Detection;
use crate::observation::Estimate;
use crate::ordering::sort_by_value;
use crate::setup::{Orientation, Setup, Shape};

/// Ratio of detections to markers above which a frame is clutter: a diagnosis would mean nothing and take seconds.
pub(super) const CLUTTER_RATIO: usize = 3;
/// Half width of a window that the scan in flight covers, px: three standard deviations of a mounting's repeatability of 90
/// px.
pub(super) const WINDOW_PX: f64 = 270.0;
/// Standard deviations of a direction, rad, with which identities are searched: errors of a few pixels, and gross ones.
const WIDE_RAD: [f64; 2] = [1e-3, 4e-3];
/// Number of rotations from which identities are completed.
const CANDIDATES: usize = 4;
/// Distances within which detections are paired in the rounds of completion, px.
const GATES_PX: [f64; 6] = [80.0, 40.0, 25.0, 15.0, 12.0, 12.0];
/// Largest ratio of the sizes of a detection and the predicted marker.
const SIZE_RATIO: f64 = 1.35;
/// Minimum number of pairs, two more than the unknowns of a flexible camera determine.
const MIN_PAIRS: usize = 6;
/// Range and step of trial deflections over the span: from taxiing with full tanks to the strongest gust on a slender wing.
const DEFLECTIONS: [f64; 9] = [-0.04, -0.02, 0.02, 0.04, 0.06, 0.08, 0.10, 0.12, 0.14];

/// Conclusion if no modification of the setup explains markers, of which there are enough.
pub const OTHER_AIRCRAFT: &str = "no other lens, place, unit, axes or bend explains most of the markers, so that the frame \
    probably shows another aircraft, or the survey is another one";

/// Pairs of a frame under a gross error.
struct Pairing {
    start: Option<(Cause, f64)>,
    pairs: Vec<MatchedPair>,
}

/// Diagnoses a ground frame of unknown attitude; `None` if no modification of the setup explains its markers.
fn diagnose_ground_frame(setup: &Setup, detections: &[Detection]) -> Option<Diagnosis> {
    if detections.len() > CLUTTER_RATIO * setup.markers.len() {
        return None;
    }
    let possible = detections
        .iter()
        .filter(|d| is_usable(d))
        .count()
        .min(setup.markers.len());
    let is_convincing = |p: &Pairing| 3 * p.pairs.len() >= 2 * possible;
    let mut best: Option<Pairing> = None;
    for start in list_starts(setup, detections) {
        let Some(next) = pair_with(setup, detections, start) else {
            continue;
        };
        if best
            .as_ref()
            .is_none_or(|b| next.pairs.len() > b.pairs.len())
        {
            best = Some(next);
        }
        if best
            .as_ref()
            .is_some_and(|b| 10 * b.pairs.len() >= 9 * possible)
        {
            break;
        }
    }
    let best = best.filter(is_convincing)?;
    let is_flight = matches!(best.start, Some((Cause::Bend, _)));
    let mut found = rank_pairs(setup, detections, &best)?;
    let first = found.ranking.first_mut()?;
    if is_flight && first.cause == Cause::Bend {
        // The shape of a bend in flight is not that of the trial; the identification in flight confirms and measures it.
        let camera_from_survey = first.camera_from_survey;
        let near = Orientation::from_rotation(camera_from_survey);
        let wide = Setup {
            mount_repeatability_px: WINDOW_PX / 3.0,
            ..setup.clone()
        };
        let value = WingView::in_flight(&wide, &near)
            .identify_most(detections)?
            .tip_deflection_m;
        first.size = vec![Estimate { value, sigma: None }];
        first.text = Cause::Bend.describe(&first.size, setup, false);
        return is_bent(value, setup).then_some(found);
    }
    (first.variance_factor < GROSS).then_some(found)
}

/// Diagnoses ground frames, and again with the setup corrected by the best cause, in which other markers may be identified.
pub fn diagnose_ground(setup: &Setup, frames: &[Vec<Detection>]) -> Option<Diagnosis> {
    let mut first = diagnose_single_ground(setup, frames)?;
    if let Some(corrected) = first
        .causes()
        .first()
        .and_then(|best| best.corrected_setup(setup))
    {
        let second = diagnose_single_ground(&corrected, frames);
        first.set_further(second);
    }
    Some(first)
}

/// Diagnoses ground frames: at their orientation if most markers have one, else with unknown attitude, frame by frame.
fn diagnose_single_ground(setup: &Setup, frames: &[Vec<Detection>]) -> Option<Diagnosis> {
    let visible = |frame: &Vec<Detection>| {
        frame
            .iter()
            .filter(|d| is_usable(d))
            .count()
            .min(setup.markers.len())
    };
    let possible: usize = frames.iter().map(visible).sum();
    let fit = estimate_orientation(setup, frames)
        .ok()
        .filter(|fit| 3 * fit.residuals.len() >= 2 * possible);
    match fit {
        Some(fit) => diagnose_ground_fit(setup, frames, &fit),
        None => frames
            .iter()
            .find_map(|frame| diagnose_ground_frame(setup, frame)),
    }
}

/// Diagnoses the frames of an estimated orientation, rejected images included.
pub fn diagnose_ground_fit(
    setup: &Setup,
    frames: &[Vec<Detection>],
    fit: &OrientationFit,
) -> Option<Diagnosis> {
    let view = WingView::on_ground(setup, &fit.orientation);
    let state = super::super::beam::WingState::zeros();
    let outlines = view.marker_outlines(&state);
    let mut images = vec![];
    for (frame, identities) in frames.iter().zip(&fit.identities) {
        let mut pairs = identities.pairs();
        let named = pairs
            .iter()
            .map(|(i, j)| named_image(&frame[*i], *j))
            .collect();
        add_remaining(
            &mut Subject::new(setup, named),
            frame,
            &outlines,
            &mut pairs,
        );
        let identities = Identities::from_pairs(frame.len(), &pairs);
        let centred = correct_centres(&view, &state, frame, &identities);
        images.extend(pairs.iter().map(|(i, j)| named_image(&centred[*i], *j)));
    }
    rank_causes(&Subject::new(setup, images), None, None)
}

/// Ranks the causes for pairs, and for each remaining marker with the nearest similar detection.
fn rank_pairs(setup: &Setup, detections: &[Detection], found: &Pairing) -> Option<Diagnosis> {
    let images = |pairs: &[MatchedPair], of: &[Detection]| {
        pairs
            .iter()
            .map(|(i, j)| named_image(&of[*i], *j))
            .collect()
    };
    let values: Vec<f64> = found.start.iter().map(|s| s.1).collect();
    let given = found.start.map(|(cause, _)| (cause, values.as_slice()));
    let modified = |subject: &Subject| {
        given.map_or_else(
            || subject.clone(),
            |(cause, values)| cause.apply(subject, values),
        )
    };
    let rough = Subject::new(setup, images(&found.pairs, detections));
    let pose = start_pose(&modified(&rough), None)?;
    let mut right = modified(&rough);
    let outlines = predict_outlines(&right, None, &pose);
    let mut pairs = found.pairs.clone();
    let pixels: Vec<Detection> = turn_detections(&right, detections, given.map(|g| g.0));
    add_remaining(&mut right, &pixels, &outlines, &mut pairs);
    let attitude = Orientation::from_rotation(pose.camera_from_survey);
    let identities = Identities::from_pairs(detections.len(), &pairs);
    let centred = correct_centres(
        &WingView::on_ground(&right.setup, &attitude),
        &pose.state,
        detections,
        &identities,
    );
    rank_causes(&Subject::new(setup, images(&pairs, &centred)), None, given)
}

/// Lists modifications of the setup, the most likely first.
fn list_starts(setup: &Setup, detections: &[Detection]) -> Vec<Option<(Cause, f64)>> {
    let mut starts = vec![None, Some((Cause::Mirrored, 0.0))];
    let log_ratio = log_size_ratio(setup, detections);
    if log_ratio.abs() > 0.1 {
        starts.extend([Cause::SurveyScale, Cause::ImageScale].map(|cause| {
            Some((
                cause,
                if cause == Cause::ImageScale {
                    log_ratio
                } else {
                    -log_ratio
                },
            ))
        }));
    }
    starts.extend(DEFLECTIONS.map(|d| Some((Cause::Bend, d * span_m(setup)))));
    starts.extend([-0.08, 0.08, -0.16, 0.16].map(|s| Some((Cause::ImageScale, s))));
    starts.extend(
        UNITS
            .iter()
            .flat_map(|(_, m)| [m.ln(), -m.ln()])
            .map(|s| Some((Cause::PointScale, s))),
    );
    starts.extend(Cause::list_axes().map(|axes| Some((axes, 0.0))));
    starts
}

/// Returns the logarithm of the ratio of the median size of the detections to that predicted from the survey.
fn log_size_ratio(setup: &Setup, detections: &[Detection]) -> f64 {
    let median = |mut all: Vec<f64>| {
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or(1.0)
    };
    let expected = setup
        .markers
        .iter()
        .filter(|m| m.shape != Shape::Point)
        .map(|m| {
            0.5 * m.diameter_m * setup.lens.focal_px()
                / (m.position_m - setup.projection_centre_m).norm()
        });
    let found = detections
        .iter()
        .filter(|d| d.shape != Shape::Point)
        .map(|d| d.semi_major_px);
    (median(found.collect()) / median(expected.collect())).ln()
}

/// Returns detections with the pixels of a modified image.
pub(super) fn turn_detections(
    subject: &Subject,
    detections: &[Detection],
    cause: Option<Cause>,
) -> Vec<Detection> {
    let all = detections.iter().map(|d| named_image(d, 0)).collect();
    let given = Subject {
        images: all,
        ..subject.clone()
    };
    let pixels = match cause {
        Some(cause @ (Cause::Mirrored | Cause::UpsideDown)) => cause.apply(&given, &[]).images,
        _ => given.images,
    };
    detections
        .iter()
        .zip(pixels)
        .map(|(d, p)| Detection {
            centre_px: p.pixel,
            ..d.clone()
        })
        .collect()
}

/// Pairs markers and detections with a modified setup and a flexible camera.
fn pair_with(
    setup: &Setup,
    detections: &[Detection],
    start: Option<(Cause, f64)>,
) -> Option<Pairing> {
    let given = Subject::new(setup, vec![]);
    let right = start.map_or_else(
        || given.clone(),
        |(cause, value)| cause.apply(&given, &[value]),
    );
    let seen = turn_detections(&right, detections, start.map(|s| s.0));
    let mut wide = right.setup.clone();
    if right.bend_m != 0.0 {
        bend_markers(&mut wide, right.bend_m);
    }
    let mut best: Vec<MatchedPair> = vec![];
    // Trials with the setup as given allow for other errors; those of a modified one are many.
    for wide_rad in &WIDE_RAD[..if start.is_none() { 2 } else { 1 }] {
        for marker in &mut wide.markers {
            marker.sigma_m = *wide_rad * (marker.position_m - wide.projection_centre_m).norm();
        }
        for candidate in list_candidates(&wide, &seen).0.into_iter().take(CANDIDATES) {
            let pairs = complete_pairs(&right, &seen, candidate.pairs);
            if pairs.len() > best.len() {
                best = pairs;
            }
        }
    }
    (best.len() >= MIN_PAIRS).then_some(Pairing { start, pairs: best })
}

/// Displaces the markers by a bend.
fn bend_markers(setup: &mut Setup, bend_m: f64) {
    let level = Orientation::from_rotation(nalgebra::Rotation3::identity());
    let view = WingView::on_ground(setup, &level);
    let mut state = super::super::beam::WingState::zeros();
    state[0] = 3.0 * bend_m / view.beam.length_m.powi(2);
    let places: Vec<_> = view
        .beam
        .marker_positions(&state, 1.0)
        .iter()
        .map(|place| view.beam.frame.survey_point(place))
        .collect();
    setup
        .markers
        .iter_mut()
        .zip(places)
        .for_each(|(marker, place)| marker.position_m = place);
}

/// Fits a flexible camera to pairs and pairs again, until most similar detections are within the last distance.
fn complete_pairs(
    right: &Subject,
    seen: &[Detection],
    mut pairs: Vec<MatchedPair>,
) -> Vec<MatchedPair> {
    for gate_px in GATES_PX {
        let images = pairs
            .iter()
            .map(|(i, j)| named_image(&seen[*i], *j))
            .collect();
        let subject = Subject {
            images,
            ..right.clone()
        };
        let solved = || {
            let pose: Pose = start_pose(&subject, None)?;
            Evidence::new(subject.clone(), None, (&subject, &pose))?
                .solve(Some(Cause::Flexible), &[])
        };
        let Some(fit) = solved().filter(|_| pairs.len() >= MIN_PAIRS - 2) else {
            return vec![];
        };
        pairs = nearest_pairs(
            seen,
            &predict_outlines(&fit.subject, None, &fit.pose),
            right,
            gate_px,
        );
    }
    pairs
}

/// Pairs similar detections with predicted outlines, the nearest first.
fn nearest_pairs(
    seen: &[Detection],
    outlines: &[Option<DiscOutline>],
    subject: &Subject,
    gate_px: f64,
) -> Vec<MatchedPair> {
    let mut all: Vec<(f64, MatchedPair)> = vec![];
    for (j, (outline, marker)) in outlines.iter().zip(&subject.setup.markers).enumerate() {
        let Some(outline) = outline else { continue };
        for (i, d) in seen
            .iter()
            .enumerate()
            .filter(|(_, d)| is_usable(d) && d.shape == marker.shape)
        {
            let off_px = (d.centre_px - outline.ellipse_px).norm();
            let ratio = (d.semi_major_px / outline.semi_major_px).ln().abs();
            if off_px < gate_px && ratio < SIZE_RATIO.ln() {
                all.push((off_px, (i, j)));
            }
        }
    }
    sort_by_value(&mut all, |one| one.0);
    select_one_to_one(all)
        .into_iter()
        .map(|(_, pair)| pair)
        .collect()
}

/// Largest square of an image's normalised misclosure after its marker was moved: chi-square of three degrees of freedom,
/// 0.1 %.
const CONSISTENT: f64 = 16.3;

/// Pairs remaining markers with remaining detections if one wrong coordinate explains place and size of the image, or if
/// several have each other's kinds. A false detection beside a hidden marker hardly satisfies either.
fn add_remaining(
    subject: &mut Subject,
    seen: &[Detection],
    outlines: &[Option<DiscOutline>],
    pairs: &mut Vec<MatchedPair>,
) {
    let markers = subject.setup.markers.clone();
    let is_named = |i: usize| pairs.iter().any(|p| p.0 == i) || !is_usable(&seen[i]);
    let free: Vec<usize> = (0..seen.len()).filter(|i| !is_named(*i)).collect();
    let missing = (0..markers.len()).filter(|j| pairs.iter().all(|p| p.1 != *j));
    let (mut similar, mut other) = (vec![], vec![]);
    for (j, outline) in missing.filter_map(|j| Some((j, outlines.get(j).copied().flatten()?))) {
        for &i in &free {
            let (d, off_px) = (&seen[i], (seen[i].centre_px - outline.ellipse_px).norm());
            if d.shape != markers[j].shape && off_px < 0.5 * outline.semi_major_px {
                other.push((off_px, (i, j)));
            } else if d.shape == markers[j].shape
                && (d.semi_major_px / outline.semi_major_px).ln().abs() < SIZE_RATIO.ln()
            {
                similar.push((off_px, (i, j)));
            }
        }
    }
    sort_by_value(&mut similar, |one| one.0);
    similar.retain(|(_, (i, j))| {
        let mut with = subject.clone();
        with.images.push(named_image(&seen[*i], *j));
        let pose = start_pose(subject, None);
        let evidence = pose.and_then(|pose| Evidence::new(with.clone(), None, (&with, &pose)));
        let explains = |evidence: &Evidence, axis: usize| {
            let fit = evidence.solve(Some(Cause::Point(*j, axis)), &[]);
            fit.is_some_and(|fit| evidence.image_square(&fit, subject.images.len()) < CONSISTENT)
        };
        evidence.is_some_and(|evidence| (0..3).any(|axis| explains(&evidence, axis)))
    });
    let mut added = select_one_to_one(similar);
    sort_by_value(&mut other, |one| one.0);
    let other = select_one_to_one(other);
    if other.len() > 1 {
        added.extend(other);
    }
    subject
        .images
        .extend(added.iter().map(|(_, (i, j))| named_image(&seen[*i], *j)));
    pairs.extend(added.into_iter().map(|(_, pair)| pair));
}
