//! A picture in which a person marks what the detector did not find: where the others foretell each marker, what the
//! detector measures where the hand points, and what is solved with it. Nothing of what was detected is changed.

use nalgebra::Vector2;

use super::guard::{BROKE_OFF, guarded};
use super::orienting::{self, GroundFrame};
use super::stages::{self, ProcessedFrame};
use super::{Job, decode, solve_sighting};
use crate::camera::Format;
use crate::installation::{Installation, ManualObservation, ManualPosition};
use crate::measure::adjust::Observation;
use crate::measure::detect::{self, Detection, ExpectedMarker, MarkerPrediction};
use crate::measure::identify::{self, OrientationFit, PredictedMarker};
use crate::measure::raster::Raster;
use crate::measure::setup::Orientation;
use crate::record::{ImageRecord, Reason, Status};

/// How well a centre is pointed at on a screen, standard deviation of each coordinate, px. Chosen: an eye that sees edges of
/// two or three pixels halves a marker to about that.
pub const HAND_SIGMA_PX: f64 = 2.0;
/// Standard deviations of the hand within which the detector's own fit is of what the hand points at.
const WITHIN: f64 = 3.0;

/// A picture on the desk.
pub struct MarkingSession {
    /// What was detected.
    seen: LoadedImage,
}

enum LoadedImage {
    Flight { raster: Raster, sighting: Box<ProcessedFrame>, orientation: Box<Orientation> },
    Ground(Box<GroundFrame>),
}

/// What a picture says with what a person says of it.
pub struct MarkingResult {
    /// The result; on ground only the markers' part of it, and the orientation in words as its remark.
    pub record: ImageRecord,
    /// What it stands on.
    pub observations: Vec<Observation>,
    /// Where the picture should show the markers that lie in it.
    pub predicted: Vec<PredictedMarker>,
    /// By which the detector's measurements become centres.
    orientation: Option<Orientation>,
}

impl MarkingSession {
    /// Decodes and detects as `solve` does, or as `orient` does where `orientation` is `None`.
    ///
    /// # Errors
    /// Where the picture cannot be read, or is not of the calibrated camera's size.
    pub fn open(
        name: &str,
        bytes: &[u8],
        format: Option<&Format>,
        installation: &Installation,
        orientation: Option<&Orientation>,
    ) -> Result<Self, Reason> {
        let look = || match orientation {
            None => Ok(LoadedImage::Ground(Box::new(orienting::sight(name, bytes, installation)?))),
            Some(orientation) => {
                let raster = decode::decode(bytes, format).map_err(Reason::of)?;
                if let Some(fault) = stages::size_fault(&raster, installation) {
                    return Err(fault);
                }
                let sighting =
                    stages::process_frame(name, bytes, format, installation, Some(orientation)).into();
                Ok(LoadedImage::Flight { raster, sighting, orientation: orientation.clone().into() })
            }
        };
        let seen = guarded(look).unwrap_or_else(|| Err(BROKE_OFF.into()))?;
        Ok(Self { seen })
    }

    /// Its pixels.
    pub fn raster(&self) -> &Raster {
        match &self.seen {
            LoadedImage::Flight { raster, .. } => raster,
            LoadedImage::Ground(frame) => frame.raster(),
        }
    }

    /// What it says with what a person says of it.
    pub fn solve(&self, said: &[ManualObservation], installation: &Installation) -> MarkingResult {
        let solve = || match &self.seen {
            LoadedImage::Flight { sighting, orientation, .. } => {
                in_flight(sighting, orientation, said, installation)
            }
            LoadedImage::Ground(frame) => on_ground(frame, said, installation),
        };
        guarded(solve).unwrap_or_else(|| MarkingResult {
            record: ImageRecord::failed("", crate::record::Method::None, BROKE_OFF),
            observations: vec![],
            predicted: vec![],
            orientation: None,
        })
    }

    /// What the detector measures of a marker whose centre a person points at, `hand_sigma_px` well, with its own standard
    /// deviation; `None` where it finds nothing like it there, or tells it worse than the hand.
    pub fn refined(
        &self,
        said: &MarkingResult,
        installation: &Installation,
        (marker, at): (usize, Vector2<f64>),
        hand_sigma_px: f64,
    ) -> Option<ManualPosition> {
        let measured = || {
            let (setup, orientation) = (&installation.setup, said.orientation.as_ref()?);
            let foretold = said.predicted.iter().find(|f| f.marker == marker)?;
            let reach = WITHIN * hand_sigma_px;
            let centre_px = at + foretold.prediction.centre_px - foretold.point_px;
            let search_px = Vector2::repeat(reach);
            let prediction = MarkerPrediction { centre_px, search_px, ..foretold.prediction.clone() };
            let plain = detect::detect_guided(self.raster(), std::slice::from_ref(&prediction)).markers;
            let closer = || self.closer(marker, &prediction);
            let near = |d: &Detection| (d.centre_px - centre_px).norm() <= reach;
            let found = plain.into_iter().find(near).or_else(|| closer().filter(near))?;
            let centred = identify::correct_marker_centre(setup, orientation, &said.observations, marker, &found);
            let covariance_px2 = *centred.covariance_px2;
            let surer = covariance_px2.trace() < 2.0 * hand_sigma_px * hand_sigma_px;
            surer.then_some(ManualPosition { pixel: centred.centre_px, covariance_px2 })
        };
        guarded(measured).flatten()
    }

    /// The look of the detector at a marker whose size is known.
    fn closer(&self, marker: usize, prediction: &MarkerPrediction) -> Option<Detection> {
        let mut found = match &self.seen {
            LoadedImage::Flight { sighting, .. } => sighting.detections.clone(),
            LoadedImage::Ground(frame) => frame.sighting.detections.clone(),
        };
        // What lies there was taken for something else.
        let beside = |d: &Detection| (d.centre_px - prediction.centre_px).norm() > prediction.semi_minor_px;
        found.markers.retain(beside);
        let before = found.markers.clone();
        let expected = ExpectedMarker { prediction: prediction.clone(), found: None, marker };
        detect::second_pass(self.raster(), &mut found, &[expected]);
        found.markers.into_iter().find(|d| before.iter().all(|b| b.centre_px != d.centre_px))
    }
}

fn in_flight(
    sighting: &ProcessedFrame,
    orientation: &Orientation,
    said: &[ManualObservation],
    installation: &Installation,
) -> MarkingResult {
    let mut sighting = sighting.clone();
    sighting.add_manual(said);
    let record = solve_sighting(&sighting, installation, orientation, &Job::default());
    let foretold = identify::predict_markers(&installation.setup, orientation, &sighting.observations);
    let orientation = Some(orientation.clone());
    MarkingResult { record, observations: sighting.observations, predicted: foretold, orientation }
}

fn on_ground(frame: &GroundFrame, said: &[ManualObservation], installation: &Installation) -> MarkingResult {
    let setup = &installation.setup;
    let mut frame = frame.clone();
    frame.set_manual_observations(said.to_vec());
    let mut frames = [frame];
    match orienting::orient(setup, &mut frames) {
        Ok(fit) => {
            let observations: Vec<Observation> = fit.orientation.ground.iter().map(observation).collect();
            let foretold = identify::predict_ground_markers(setup, &fit.orientation, &[]);
            let record = ground_record(&fit, &observations, said, installation);
            MarkingResult { record, observations, predicted: foretold, orientation: Some(fit.orientation) }
        }
        Err(error) => {
            let reason = Some(error.to_string());
            let record = ImageRecord {
                reason,
                markers: ground_markers(&[], said, installation),
                ..ImageRecord::default()
            };
            MarkingResult { record, observations: vec![], predicted: vec![], orientation: None }
        }
    }
}

fn observation(sight: &crate::measure::setup::GroundObservation) -> Observation {
    Observation { marker: sight.marker, pixel: sight.pixel, covariance_px2: sight.covariance_px2 }
}

fn ground_markers(
    observations: &[Observation],
    said: &[ManualObservation],
    installation: &Installation,
) -> Vec<crate::record::MarkerRecord> {
    let observations = observations.to_vec();
    let mut sighting = ProcessedFrame { observations, ..ProcessedFrame::default() };
    sighting.add_manual(said);
    super::recording::markers(&sighting, installation)
}

/// The markers of a ground frame as results have them, the orientation in words.
fn ground_record(
    fit: &OrientationFit,
    observations: &[Observation],
    said: &[ManualObservation],
    installation: &Installation,
) -> ImageRecord {
    let mut markers = ground_markers(observations, said, installation);
    for (marker, reason) in fit.unused_markers(&installation.setup) {
        if let Some(line) = markers.get_mut(marker) {
            line.reason = Some(reason);
        }
    }
    for (_, marker, residual) in &fit.residuals {
        if let Some(line) = markers.get_mut(*marker) {
            // Results have adjusted less observed.
            (line.residual_u_px, line.residual_v_px) = (Some(-residual.x), Some(-residual.y));
            (line.used, line.reason) = (true, None);
        }
    }
    let sigma = fit.orientation.covariance_rad2.map_or(String::new(), |c| {
        let [x, y, z] = [0, 1, 2].map(|k| 1e3 * c[(k, k)].max(0.0).sqrt());
        format!(", standard deviations about camera x, y, z {x:.3}, {y:.3}, {z:.3} mrad")
    });
    let words = format!("orientation from {} markers{sigma}", fit.residuals.len());
    ImageRecord {
        status: Status::Ok,
        variance_factor: Some(fit.variance_factor).filter(|v| v.is_finite()),
        redundancy: Some(fit.redundancy),
        markers,
        remarks: vec![words],
        ..ImageRecord::default()
    }
}
