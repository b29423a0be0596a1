//! Manual marking of markers that the detector did not find in an image: predicted positions, measurement near the marked
//! point, and the solution with the marks. Detections are not changed.

use nalgebra::Vector2;

use super::guard::{PANIC_REASON, catch_panic};
use super::orienting::{self, GroundFrame};
use super::stages::{self, ProcessedFrame};
use super::{SolveJob, decode, solve_processed_frame};
use crate::frame_format::Format;
use crate::installation::{Installation, ManualObservation, ManualPosition};
use crate::record::{ImageRecord, Reason, RecordStatus};
use wingd_measure::adjust::Observation;
use wingd_measure::detect;
use wingd_measure::detect::ExpectedMarker;
use wingd_measure::detect::{Detection, MarkerPrediction};
use wingd_measure::identify::WingView;
use wingd_measure::identify::{OrientationFit, PredictedMarker};
use wingd_measure::raster::Raster;
use wingd_measure::setup::{Orientation, Setup};
use wingd_measure::view::ViewFault;

/// Standard deviation of a centre marked on a screen, px, in each coordinate. Chosen: a person who sees edges of 2 to 3 px
/// halves a marker to about that.
pub const MANUAL_SIGMA_PX: f64 = 2.0;
/// Distance from the marked point, in its standard deviations, within which the detector's measurement is accepted.
const MAX_OFFSET_SIGMAS: f64 = 3.0;

/// Image that a person marks, with its detections.
pub enum MarkingSession {
    /// Frame in flight.
    Flight {
        raster: Raster,
        processed: Box<ProcessedFrame>,
        orientation: Box<Orientation>,
    },
    /// Frame of the wing on the ground.
    Ground(Box<GroundFrame>),
}

/// Solution of an image with manual marks.
pub struct MarkingResult {
    /// Result; for a ground frame only its markers, with the orientation in words as a remark.
    pub record: ImageRecord,
    /// Observations that the result is computed from.
    pub observations: Vec<Observation>,
    /// Predicted images of the markers that are in view.
    pub predicted: Vec<PredictedMarker>,
    /// Orientation that converts measured outlines to marker centres.
    orientation: Option<Orientation>,
}

impl MarkingSession {
    /// Decodes an image and detects markers as `solve` does, or as `orient` does if `orientation` is `None`.
    ///
    /// # Errors
    /// Returns an error if the image cannot be read or does not have the calibrated camera's size.
    pub fn open(
        name: &str,
        bytes: &[u8],
        format: Option<&Format>,
        setup: &Setup,
        orientation: Option<&Orientation>,
    ) -> Result<Self, Reason> {
        let load = || match orientation {
            None => Ok(Self::Ground(Box::new(orienting::process_ground_frame(
                name, bytes, setup,
            )?))),
            Some(orientation) => {
                let raster = decode::decode_image(bytes, format).map_err(Reason::from_error)?;
                if let Some(fault) = ViewFault::from_size(&raster, &setup.lens) {
                    return Err(Reason::from_error(fault));
                }
                let processed =
                    stages::process_frame(name, bytes, format, setup, Some(orientation)).into();
                Ok(Self::Flight {
                    raster,
                    processed,
                    orientation: orientation.clone().into(),
                })
            }
        };
        catch_panic(load).unwrap_or_else(|| Err(PANIC_REASON.into()))
    }

    /// Returns the decoded image.
    pub fn raster(&self) -> &Raster {
        match self {
            Self::Flight { raster, .. } => raster,
            Self::Ground(frame) => frame.raster(),
        }
    }

    /// Solves the image with the manual observations.
    pub fn solve(
        &self,
        manual: &[ManualObservation],
        installation: &Installation,
    ) -> MarkingResult {
        let solve = || match self {
            Self::Flight {
                processed,
                orientation,
                ..
            } => solve_flight_image(processed, orientation, manual, installation),
            Self::Ground(frame) => solve_ground_image(frame, manual, installation),
        };
        catch_panic(solve).unwrap_or_else(|| MarkingResult {
            record: ImageRecord::failed("", PANIC_REASON),
            observations: vec![],
            predicted: vec![],
            orientation: None,
        })
    }

    /// Measures a marker near the point that a person marked with the standard deviation `manual_sigma_px`.
    ///
    /// Returns `None` if the detector finds no such marker there or is less precise than the mark.
    pub fn refine_position(
        &self,
        result: &MarkingResult,
        installation: &Installation,
        (marker, at): (usize, Vector2<f64>),
        manual_sigma_px: f64,
    ) -> Option<ManualPosition> {
        let measured = || {
            let (setup, orientation) = (&installation.setup, result.orientation.as_ref()?);
            let predicted = result.predicted.iter().find(|f| f.marker == marker)?;
            let reach = MAX_OFFSET_SIGMAS * manual_sigma_px;
            let centre_px = at + predicted.prediction.centre_px - predicted.point_px;
            let search_px = Vector2::repeat(reach);
            let prediction = MarkerPrediction {
                centre_px,
                search_px,
                ..predicted.prediction.clone()
            };
            let plain =
                detect::detect_guided(self.raster(), std::slice::from_ref(&prediction)).markers;
            let refine = || self.detect_closer(marker, &prediction);
            let near = |d: &Detection| (d.centre_px - centre_px).norm() <= reach;
            let found = plain
                .into_iter()
                .find(near)
                .or_else(|| refine().filter(near))?;
            let wing = WingView::in_flight(setup, orientation);
            let centred = wing.correct_marker_centre(&result.observations, marker, &found);
            let covariance_px2 = *centred.covariance_px2;
            let is_better = covariance_px2.trace() < 2.0 * manual_sigma_px * manual_sigma_px;
            is_better.then_some(ManualPosition {
                pixel: centred.centre_px,
                covariance_px2,
            })
        };
        catch_panic(measured).flatten()
    }

    /// Detects a marker of known size by a second pass.
    fn detect_closer(&self, marker: usize, prediction: &MarkerPrediction) -> Option<Detection> {
        let mut found = match self {
            Self::Flight { processed, .. } => processed.detections.clone(),
            Self::Ground(frame) => frame.processed.detections.clone(),
        };
        // The detection there was identified as something else.
        let elsewhere =
            |d: &Detection| (d.centre_px - prediction.centre_px).norm() > prediction.semi_minor_px;
        found.markers.retain(elsewhere);
        let before = found.markers.clone();
        let expected = ExpectedMarker {
            prediction: prediction.clone(),
            found: None,
            marker,
        };
        detect::second_pass(self.raster(), &mut found, &[expected]);
        found
            .markers
            .into_iter()
            .find(|d| before.iter().all(|b| b.centre_px != d.centre_px))
    }
}

fn solve_flight_image(
    processed: &ProcessedFrame,
    orientation: &Orientation,
    manual: &[ManualObservation],
    installation: &Installation,
) -> MarkingResult {
    let mut processed = processed.clone();
    processed.add_manual(manual);
    let record = solve_processed_frame(&processed, installation, orientation, &SolveJob::default());
    let wing = WingView::in_flight(&installation.setup, orientation);
    let predicted = wing.predict_markers(&processed.observations);
    let orientation = Some(orientation.clone());
    MarkingResult {
        record,
        observations: processed.observations,
        predicted,
        orientation,
    }
}

fn solve_ground_image(
    frame: &GroundFrame,
    manual: &[ManualObservation],
    installation: &Installation,
) -> MarkingResult {
    let setup = &installation.setup;
    let mut frame = frame.clone();
    frame.set_manual_observations(manual.to_vec());
    let mut frames = [frame];
    match orienting::orient_frames(setup, &mut frames) {
        Ok(fit) => {
            let observations = fit.orientation.ground.clone();
            let predicted = WingView::on_ground(setup, &fit.orientation).predict_markers(&[]);
            let record = ground_record(&fit, &observations, manual, installation);
            MarkingResult {
                record,
                observations,
                predicted,
                orientation: Some(fit.orientation),
            }
        }
        Err(error) => {
            let reason = Some(error.to_string());
            let record = ImageRecord {
                reason,
                markers: ground_markers(&[], manual, installation),
                ..ImageRecord::default()
            };
            MarkingResult {
                record,
                observations: vec![],
                predicted: vec![],
                orientation: None,
            }
        }
    }
}

fn ground_markers(
    observations: &[Observation],
    manual: &[ManualObservation],
    installation: &Installation,
) -> Vec<crate::record::MarkerRecord> {
    let observations = observations.to_vec();
    let mut processed = ProcessedFrame {
        observations,
        ..ProcessedFrame::default()
    };
    processed.add_manual(manual);
    super::recording::marker_records(&processed, installation)
}

/// Builds the record of a ground frame: its markers, and the orientation in words.
fn ground_record(
    fit: &OrientationFit,
    observations: &[Observation],
    manual: &[ManualObservation],
    installation: &Installation,
) -> ImageRecord {
    let mut markers = ground_markers(observations, manual, installation);
    for (marker, reason) in fit.unused_markers(&installation.setup) {
        if let Some(line) = markers.get_mut(marker) {
            line.reason = Some(reason);
        }
    }
    for (_, marker, residual) in &fit.residuals {
        if let Some(line) = markers.get_mut(*marker) {
            // Residuals in results are adjusted minus observed.
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
        status: RecordStatus::Ok,
        variance_factor: Some(fit.variance_factor).filter(|v| v.is_finite()),
        redundancy: Some(fit.redundancy),
        markers,
        remarks: vec![words],
        ..ImageRecord::default()
    }
}
