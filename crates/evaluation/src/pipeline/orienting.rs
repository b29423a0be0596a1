//! Estimation of the camera's orientation from ground frames, with second passes for markers that were not found at first.

use nalgebra::{Matrix2, Vector2};

use super::guard::PANIC_REASON;
use super::stages::{self, ProcessedFrame};
use crate::installation::{ManualObservation, ManualPosition};
use crate::record::Reason;
use wingd_measure::detect;
use wingd_measure::detect::Detection;
use wingd_measure::detect::ExpectedMarker;
use wingd_measure::identify;
use wingd_measure::identify::WingView;
use wingd_measure::identify::{IdentifyError, OrientationFit, PredictedMarker};
use wingd_measure::observation::Observation;
use wingd_measure::points;
use wingd_measure::raster::Raster;
use wingd_measure::setup::{Orientation, PointTemplate, Setup, Shape, SurveyMarker};
use wingd_measure::view::MAX_PASSES;

/// Frame of the wing on the ground.
#[derive(Clone)]
pub struct GroundFrame {
    /// Detections of the frame.
    pub processed: ProcessedFrame,
    raster: Raster,
    manual: Vec<ManualObservation>,
    /// Markers whose manual marks contradict the survey, each with the reason.
    contradictions: Vec<(usize, String)>,
}

impl GroundFrame {
    /// Returns the decoded image.
    pub fn raster(&self) -> &Raster {
        &self.raster
    }

    /// Sets the manual observations of the frame; they replace detections of the same markers.
    pub fn set_manual_observations(&mut self, observations: Vec<ManualObservation>) {
        self.manual = observations;
    }
}

/// Decodes a ground frame and detects its markers.
///
/// # Errors
/// Returns an error if the frame cannot be read or does not have the calibrated camera's size.
pub fn process_ground_frame(
    name: &str,
    bytes: &[u8],
    setup: &Setup,
) -> Result<GroundFrame, Reason> {
    let (mut processed, raster) = stages::detect_only(name, bytes, None);
    raster
        .iter()
        .for_each(|raster| processed.check_size(raster, setup));
    match (processed.failure.take(), raster) {
        (None, Some(raster)) => Ok(GroundFrame {
            processed,
            raster,
            manual: vec![],
            contradictions: vec![],
        }),
        (reason, _) => Err(reason.unwrap_or_else(|| PANIC_REASON.into())),
    }
}

/// Returns the detected markers of each frame.
pub fn detected_markers(frames: &[GroundFrame]) -> Vec<Vec<Detection>> {
    frames
        .iter()
        .map(|frame| frame.processed.detections.markers.clone())
        .collect()
}

/// Estimates the orientation from ground frames, perspective bias removed.
///
/// A first orientation predicts the image of every marker, and second passes measure those that are missing or poorly
/// visible. Markers that these do not find either are omitted with a reason. The frames are updated with the detections.
///
/// # Errors
/// Returns an error if the frames fit the survey in no orientation.
pub fn orient_frames(
    setup: &Setup,
    frames: &mut [GroundFrame],
) -> Result<OrientationFit, IdentifyError> {
    let mut fit = first_orientation(setup, frames)?;
    for _ in 0..MAX_PASSES {
        let before: Vec<_> = frames
            .iter()
            .map(|frame| frame.processed.detections.clone())
            .collect();
        let mut changed = false;
        let wing = WingView::on_ground(setup, &fit.orientation);
        for (frame, identities) in frames.iter_mut().zip(&fit.identities) {
            let found = &mut frame.processed.detections;
            let mut expected = wing.predict_second_pass(&found.markers, identities);
            expected.retain(|e: &ExpectedMarker| {
                frame
                    .manual
                    .iter()
                    .all(|observation| observation.marker != e.marker)
            });
            changed |= detect::second_pass(&frame.raster, found, &expected);
        }
        apply_manual_observations(setup, Some(&fit), frames);
        // A second pass that moves no marker may have increased the standard deviations.
        match identify::estimate_orientation(setup, &detected_markers(frames)) {
            Ok(again) => fit = again,
            Err(_) => {
                for (frame, before) in frames.iter_mut().zip(before) {
                    frame.processed.detections = before;
                }
                break;
            }
        }
        if !changed {
            break;
        }
    }
    fit.orientation.ground = fit.ground_observations(setup, &detected_markers(frames));
    cut_templates(setup, frames, &mut fit);
    record_rejected(frames, &mut fit);
    Ok(fit)
}

/// Number of standard deviations of the survey within which a point is searched for in a further ground frame.
const TEMPLATE_SIGMAS: f64 = 4.0;

/// Cuts the templates of the points. The first frame in which a point is marked and fits defines it; in the other frames
/// the place is that which its template shows.
fn cut_templates(setup: &Setup, frames: &[GroundFrame], fit: &mut OrientationFit) {
    let mut first: Vec<(usize, PointTemplate)> = vec![];
    for (k, frame) in frames.iter().enumerate() {
        for mark in frame
            .manual
            .iter()
            .filter(|mark| setup.is_point(mark.marker))
        {
            let is_used = fit
                .residuals
                .iter()
                .any(|(frame, marker, _)| (*frame, *marker) == (k, mark.marker));
            let is_new = first
                .iter()
                .all(|(_, template)| template.marker != mark.marker);
            let (Some(place), true) = (mark.place, is_used && is_new) else {
                continue;
            };
            first.extend(
                points::cut_template(&frame.raster, mark.marker, place.pixel)
                    .map(|template| (k, template)),
            );
            let ground = fit
                .orientation
                .ground
                .iter_mut()
                .filter(|o| o.marker == mark.marker);
            ground.for_each(|o| (o.pixel, o.covariance_px2) = (place.pixel, place.covariance_px2));
        }
    }
    let mut templates: Vec<PointTemplate> =
        first.iter().map(|(_, template)| template.clone()).collect();
    let defined = Orientation {
        templates: templates.clone(),
        ..fit.orientation.clone()
    };
    for patch in WingView::on_ground(setup, &defined).predict_patches_on_ground(TEMPLATE_SIGMAS) {
        let Some((defining, template)) = first.get(patch.template) else {
            continue;
        };
        let others = frames.iter().enumerate().filter(|(k, _)| k != defining);
        templates.extend(others.filter_map(|(_, frame)| {
            let found = points::match_point(&frame.raster, template, &patch).ok()?;
            points::cut_template(&frame.raster, template.marker, found.place_px)
        }));
    }
    templates.sort_by_key(|template| template.marker);
    fit.orientation.templates = templates;
    // A point without a place is a task for the user, not a failure of the detector.
    for marker in (0..setup.markers.len()).filter(|k| setup.is_point(*k)) {
        if frames
            .iter()
            .all(|frame| frame.manual.iter().all(|mark| mark.marker != marker))
        {
            fit.explain_unused(marker, UNMARKED_POINT);
        }
    }
}

/// Reason why a point that nobody marked is not used.
const UNMARKED_POINT: &str = "it has no decal and was not marked: mark it in a ground frame with `wingd mark --ground`, and \
     give the marks with --observations";

/// Estimates the first orientation from the detections, then from detections and manual observations. If the detections
/// alone fit nothing, both are used at once.
fn first_orientation(
    setup: &Setup,
    frames: &mut [GroundFrame],
) -> Result<OrientationFit, IdentifyError> {
    let alone = identify::estimate_orientation(setup, &detected_markers(frames));
    if frames.iter().all(|frame| frame.manual.is_empty()) {
        return alone;
    }
    if let Ok(fit) = &alone {
        find_contradictions(setup, fit, frames)?;
    }
    apply_manual_observations(setup, alone.as_ref().ok(), frames);
    identify::estimate_orientation(setup, &detected_markers(frames))
        .map_err(|error| diagnose_marks(setup, frames, None).map_or(error, IdentifyError::Marks))
}

/// Number of standard deviations beyond which a manual mark contradicts the detected markers.
const CONTRADICTION_SIGMAS: f64 = 5.0;

/// Excludes markers whose manual marks contradict the orientation from the detections, with the cause.
///
/// # Errors
/// Returns an error if more than one of three marks does.
fn find_contradictions(
    setup: &Setup,
    fit: &OrientationFit,
    frames: &mut [GroundFrame],
) -> Result<(), IdentifyError> {
    let predicted = WingView::on_ground(setup, &fit.orientation).predict_markers(&[]);
    let off_px = |mark: &ManualObservation| {
        let place = mark.place?;
        let point_px = predicted
            .iter()
            .find(|p| p.marker == mark.marker)
            .map(|p| p.point_px);
        let off_px = point_px.map_or(f64::INFINITY, |point_px| (place.pixel - point_px).norm());
        let sigma_px = place.covariance_px2.trace().max(0.0).sqrt();
        (off_px > MANUAL_DISTANCE_PX.max(CONTRADICTION_SIGMAS * sigma_px)).then_some(off_px)
    };
    let found: Vec<(usize, usize, f64)> = frames
        .iter()
        .enumerate()
        .flat_map(|(k, frame)| frame.manual.iter().map(move |mark| (k, mark)))
        .filter_map(|(k, mark)| Some((k, mark.marker, off_px(mark)?)))
        .collect();
    if found.is_empty() {
        return Ok(());
    }
    let marks = frames
        .iter()
        .flat_map(|frame| &frame.manual)
        .filter(|mark| mark.place.is_some())
        .count();
    let cause = diagnose_marks(setup, frames, Some(fit));
    if found.len() > 2 && 3 * found.len() > marks {
        let why = cause.map_or(String::new(), |cause| format!(": {cause}"));
        let text = format!(
            "{} of {marks} manual marks contradict the survey and the detected markers{why}",
            found.len()
        );
        return Err(IdentifyError::Marks(text));
    }
    for (frame, marker, off_px) in found {
        let unknown = || {
            format!("its manual mark is {off_px:.0} px from the expected position: mark it again")
        };
        let reason = cause.clone().unwrap_or_else(unknown);
        frames[frame].contradictions.push((marker, reason));
    }
    Ok(())
}

/// Diagnoses the manual marks of all frames, with the detections of other markers if there is an orientation.
fn diagnose_marks(
    setup: &Setup,
    frames: &[GroundFrame],
    fit: Option<&OrientationFit>,
) -> Option<String> {
    let marks = frames.iter().flat_map(|frame| &frame.manual);
    let observation = |mark: &ManualObservation| {
        let place = mark.place?;
        Some(Observation {
            marker: mark.marker,
            pixel: place.pixel,
            covariance_px2: place.covariance_px2,
        })
    };
    let mut all: Vec<Observation> = marks.filter_map(observation).collect();
    let manual = all.len();
    let detected = fit.map_or(vec![], |fit| {
        fit.ground_observations(setup, &detected_markers(frames))
    });
    all.extend(detected.into_iter().filter(|o| {
        frames
            .iter()
            .flat_map(|f| &f.manual)
            .all(|m| m.marker != o.marker)
    }));
    let outlines: Vec<_> = all
        .iter()
        .enumerate()
        .map(|(k, o)| {
            let marker = setup.markers.get(o.marker)?;
            (k >= manual).then_some((marker.shape, None))
        })
        .collect();
    identify::diagnose_observations(setup, None, &all, &outlines)?.text()
}

/// Replaces, in each frame, detections of markers that have manual observations.
fn apply_manual_observations(
    setup: &Setup,
    fit: Option<&OrientationFit>,
    frames: &mut [GroundFrame],
) {
    let predicted = fit.map_or(vec![], |fit| {
        WingView::on_ground(setup, &fit.orientation).predict_markers(&[])
    });
    for (k, frame) in frames
        .iter_mut()
        .enumerate()
        .filter(|(_, frame)| !frame.manual.is_empty())
    {
        let of_detection = fit
            .and_then(|fit| fit.identities.get(k))
            .map(|i| i.marker_of.clone());
        let contradicts = |marker: usize| {
            frame
                .contradictions
                .iter()
                .any(|(other, _)| *other == marker)
        };
        let rejected = |marker: usize| {
            contradicts(marker)
                || frame
                    .manual
                    .iter()
                    .any(|s| s.marker == marker && s.place.is_none())
        };
        let all = &mut frame.processed.detections.markers;
        // Identities belong to the detections before a second pass; after one, only positions are compared.
        if let Some(of_detection) = of_detection.filter(|of| of.len() == all.len()) {
            let mut of_detection = of_detection.into_iter();
            all.retain(|_| {
                of_detection
                    .next()
                    .flatten()
                    .is_none_or(|marker| !rejected(marker))
            });
        }
        for observation in &frame.manual {
            let (Some(place), Some(marker)) =
                (observation.place, setup.markers.get(observation.marker))
            else {
                continue;
            };
            if contradicts(observation.marker) {
                continue;
            }
            let new = manual_detection(
                setup,
                marker,
                &place,
                predicted.iter().find(|f| f.marker == observation.marker),
            );
            // A point may be next to a decal.
            let apart = |d: &Detection| match new.marker {
                Some(point) => d.marker != Some(point),
                None => {
                    (d.centre_px - new.centre_px).norm() > new.semi_minor_px.max(MANUAL_DISTANCE_PX)
                }
            };
            all.retain(apart);
            all.push(new);
        }
    }
}

/// Distance from a manual position within which a detection is of the same marker, px: three standard deviations of a
/// manual mark ([`MANUAL_SIGMA_PX`](super::marking::MANUAL_SIGMA_PX)).
const MANUAL_DISTANCE_PX: f64 = 6.0;
/// Ratio of the semi-axes, minor to major, of a marker without a prediction; the result hardly depends on it.
const DEFAULT_AXIS_RATIO: f64 = 0.5;

/// Converts a manual position into a detection, whose outline centre is offset from the marker's centre.
fn manual_detection(
    setup: &Setup,
    marker: &SurveyMarker,
    place: &ManualPosition,
    predicted: Option<&PredictedMarker>,
) -> Detection {
    let distance_m = (marker.position_m - setup.projection_centre_m)
        .norm()
        .max(marker.diameter_m);
    let major = 0.5 * marker.diameter_m / distance_m * setup.lens.focal_px();
    let outline = predicted.map(|f| &f.prediction);
    let offset_px = predicted.map_or(Vector2::zeros(), |f| f.prediction.centre_px - f.point_px);
    let covariance: Matrix2<f64> = place.covariance_px2;
    Detection {
        shape: marker.shape,
        centre_px: place.pixel + offset_px,
        covariance_px2: covariance.into(),
        semi_major_px: outline.map_or(major, |p| p.semi_major_px),
        semi_minor_px: outline.map_or(DEFAULT_AXIS_RATIO * major, |p| p.semi_minor_px),
        angle_rad: outline.map_or(0.0, |p| p.angle_rad),
        fit_rms: 0.0,
        contrast: 0.0,
        marker: setup
            .markers
            .iter()
            .position(|m| m.id == marker.id)
            .filter(|_| marker.shape == Shape::Point),
    }
}

/// Records the rejection by a person as the reason why a marker is missing.
fn record_rejected(frames: &[GroundFrame], fit: &mut OrientationFit) {
    for (frame, identities) in frames.iter().zip(&mut fit.identities) {
        for observation in frame
            .manual
            .iter()
            .filter(|observation| observation.place.is_none())
        {
            identities
                .missing
                .retain(|(marker, _)| *marker != observation.marker);
            identities
                .missing
                .push((observation.marker, stages::rejection_reason(observation)));
        }
        for (marker, reason) in &frame.contradictions {
            identities.missing.retain(|(other, _)| other != marker);
            identities.missing.push((*marker, reason.clone()));
        }
    }
}
