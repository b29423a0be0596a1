//! Ground frames become an orientation, and with it what was not found at first is sought again.

use nalgebra::{Matrix2, Vector2};

use super::guard::BROKE_OFF;
use super::located::LOOKS;
use super::stages::{self, ProcessedFrame};
use crate::installation::{Installation, ManualObservation, ManualPosition};
use crate::measure::detect::{self, Detection, ExpectedMarker};
use crate::measure::identify::{self, IdentifyError, OrientationFit, PredictedMarker};
use crate::measure::raster::Raster;
use crate::measure::setup::{Setup, SurveyMarker};
use crate::record::Reason;

/// A frame of the wing on ground.
#[derive(Clone)]
pub struct GroundFrame {
    /// What was seen in it.
    pub sighting: ProcessedFrame,
    raster: Raster,
    said: Vec<ManualObservation>,
}

impl GroundFrame {
    /// Its pixels.
    pub fn raster(&self) -> &Raster {
        &self.raster
    }

    /// What a person says of its markers: it stands for what is detected of them.
    pub fn set_manual_observations(&mut self, said: Vec<ManualObservation>) {
        self.said = said;
    }
}

/// Decodes a ground frame and detects.
///
/// # Errors
/// The reason, where the frame cannot be read or is not of the calibrated camera's size.
pub fn sight(name: &str, bytes: &[u8], installation: &Installation) -> Result<GroundFrame, Reason> {
    let (mut sighting, raster) = stages::detect_only(name, bytes, None);
    let fault = raster.as_ref().and_then(|raster| stages::size_fault(raster, installation));
    match (sighting.failure.take().or(fault), raster) {
        (None, Some(raster)) => Ok(GroundFrame { sighting, raster, said: vec![] }),
        (reason, _) => Err(reason.unwrap_or_else(|| BROKE_OFF.into())),
    }
}

/// The markers seen in each frame.
pub fn markers(frames: &[GroundFrame]) -> Vec<Vec<Detection>> {
    frames.iter().map(|frame| frame.sighting.detections.markers.clone()).collect()
}

/// The orientation with what the frames show of each marker, perspective bias removed. As in flight, a first orientation
/// foretells every marker's image, and what is missing there or hardly seen is looked at more closely: only what that
/// look does not find either is left out, with a reason. The frames get what was found.
///
/// # Errors
/// Where the frames fit the survey in no orientation.
pub fn orient(setup: &Setup, frames: &mut [GroundFrame]) -> Result<OrientationFit, IdentifyError> {
    let mut fit = first(setup, frames)?;
    for _ in 0..LOOKS {
        let before: Vec<_> = frames.iter().map(|frame| frame.sighting.detections.clone()).collect();
        let mut changed = false;
        for (frame, identities) in frames.iter_mut().zip(&fit.identities) {
            let found = &mut frame.sighting.detections;
            let mut expected =
                identify::predict_ground_second_pass(setup, &fit.orientation, &found.markers, identities);
            expected.retain(|e: &ExpectedMarker| frame.said.iter().all(|said| said.marker != e.marker));
            changed |= detect::second_pass(&frame.raster, found, &expected);
        }
        take_in(setup, Some(&fit), frames);
        // A look that leaves everything in its place may have made it less sure.
        match identify::estimate_orientation(setup, &markers(frames)) {
            Ok(again) => fit = again,
            Err(_) => {
                for (frame, before) in frames.iter_mut().zip(before) {
                    frame.sighting.detections = before;
                }
                break;
            }
        }
        if !changed {
            break;
        }
    }
    fit.orientation.ground = stages::ground_sights(setup, &markers(frames), &fit);
    say_rejected(frames, &mut fit);
    Ok(fit)
}

/// The orientation by what was detected, and with what people say; where the detections alone fit nothing, by both.
fn first(setup: &Setup, frames: &mut [GroundFrame]) -> Result<OrientationFit, IdentifyError> {
    let alone = identify::estimate_orientation(setup, &markers(frames));
    if frames.iter().all(|frame| frame.said.is_empty()) {
        return alone;
    }
    take_in(setup, alone.as_ref().ok(), frames);
    identify::estimate_orientation(setup, &markers(frames))
}

/// Puts in each frame what a person says of its markers in the place of what was detected of them.
fn take_in(setup: &Setup, fit: Option<&OrientationFit>, frames: &mut [GroundFrame]) {
    let foretold = fit.map_or(vec![], |fit| identify::predict_ground_markers(setup, &fit.orientation, &[]));
    for (k, frame) in frames.iter_mut().enumerate().filter(|(_, frame)| !frame.said.is_empty()) {
        let of_detection = fit.and_then(|fit| fit.identities.get(k)).map(|i| i.marker_of.clone());
        let rejected = |marker: usize| frame.said.iter().any(|s| s.marker == marker && s.place.is_none());
        let all = &mut frame.sighting.detections.markers;
        // Names are of the detections as they stood: after a look they are asked by their places alone.
        if let Some(of_detection) = of_detection.filter(|of| of.len() == all.len()) {
            let mut of_detection = of_detection.into_iter();
            all.retain(|_| of_detection.next().flatten().is_none_or(|marker| !rejected(marker)));
        }
        for said in &frame.said {
            let (Some(place), Some(marker)) = (said.place, setup.markers.get(said.marker)) else { continue };
            let new = detection(setup, marker, &place, foretold.iter().find(|f| f.marker == said.marker));
            let apart =
                |d: &Detection| (d.centre_px - new.centre_px).norm() > new.semi_minor_px.max(HAND_OFF_PX);
            all.retain(apart);
            all.push(new);
        }
    }
}

/// What was detected nearer to where a hand points is of the same marker, px: three standard deviations of a hand
/// ([`HAND_SIGMA_PX`](super::marking::HAND_SIGMA_PX)).
const HAND_OFF_PX: f64 = 6.0;
/// Minor over major semi-axis of a marker on a wing where nothing tells how it is seen; hardly counts.
const SLANT: f64 = 0.5;

/// A place by hand as a detection: its outline's centre is beside the marker's.
fn detection(
    setup: &Setup,
    marker: &SurveyMarker,
    place: &ManualPosition,
    foretold: Option<&PredictedMarker>,
) -> Detection {
    let distance_m = (marker.position_m - setup.projection_centre_m).norm().max(marker.diameter_m);
    let major = 0.5 * marker.diameter_m / distance_m * setup.lens.focal_px();
    let outline = foretold.map(|f| &f.prediction);
    let aside = foretold.map_or(Vector2::zeros(), |f| f.prediction.centre_px - f.point_px);
    let covariance: Matrix2<f64> = place.covariance_px2;
    Detection {
        shape: marker.shape,
        centre_px: place.pixel + aside,
        covariance_px2: covariance.into(),
        semi_major_px: outline.map_or(major, |p| p.semi_major_px),
        semi_minor_px: outline.map_or(SLANT * major, |p| p.semi_minor_px),
        angle_rad: outline.map_or(0.0, |p| p.angle_rad),
        fit_rms: 0.0,
        contrast: 0.0,
    }
}

/// A marker that a person rejected is missing for that reason.
fn say_rejected(frames: &[GroundFrame], fit: &mut OrientationFit) {
    for (frame, identities) in frames.iter().zip(&mut fit.identities) {
        for said in frame.said.iter().filter(|said| said.place.is_none()) {
            identities.missing.retain(|(marker, _)| *marker != said.marker);
            identities.missing.push((said.marker, stages::rejection(said)));
        }
    }
}
