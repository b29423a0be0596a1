//! Solution of one camera's frames as they arrive (docs/live.md): detection guided by the previous frame, adjustment with
//! the information of all previous frames.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::curvature::CurvatureEstimate;
use super::stages::{ProcessedFrame, StageTime};
use super::{SolveJob, correct_refraction, decode, flight_priors, recording};
use crate::frame_format::Format;
use crate::installation::Installation;
use crate::pipeline::guard::{PANIC_REASON, catch_panic};
use crate::record::{ImageRecord, Provenance, Reason};
use wingd_base::clock::exposure::Exposure;
use wingd_measure::adjust::AdjustError;
use wingd_measure::adjust::LiveAdjustment;
use wingd_measure::detect;
use wingd_measure::detect::{Detection, MarkerPrediction};
use wingd_measure::estimation::quality::GlobalTest;
use wingd_measure::identify::WingView;
use wingd_measure::identify::{Identities, MAX_DEFLECTION_CHANGE_M};
use wingd_measure::setup::Orientation;
use wingd_measure::tiles::Tiles;
use wingd_measure::view;
use wingd_measure::view::Work;
use wingd_measure::view::{FrameView, SearchMode};

/// Image of a marker, as an ellipse in the frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outline {
    /// Survey id; `null` for an unidentified marker.
    pub id: Option<String>,
    /// Centre, px.
    pub u_px: f64,
    pub v_px: f64,
    pub semi_major_px: f64,
    pub semi_minor_px: f64,
    /// Direction of the major axis, from u to v, degrees.
    pub angle_deg: f64,
}

/// Result of tracking in one frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrackedFrame {
    /// Search of the full frame, or guided by the preceding frame.
    pub search: SearchMode,
    /// Number of the camera's mounting, from 1; each mount disturbance begins the next one. 0 before the first solution.
    pub mounting: usize,
    /// True if this frame showed a mount disturbance.
    pub mount_disturbed: bool,
    /// Outlines of the detected markers.
    pub outlines: Vec<Outline>,
    /// Curvature of the wing with its covariance, if the frame is solved, stored for bending moments; the line of JSON omits
    /// it, because its record has the coefficients.
    #[serde(skip)]
    pub curvature: Option<CurvatureEstimate>,
    /// Result, solved or failed, without provenance and correlations.
    #[serde(flatten)]
    pub record: ImageRecord,
}

impl TrackedFrame {
    /// Creates the result of a frame without numbers, whose record says why.
    pub fn failed(record: ImageRecord) -> Self {
        let (outlines, curvature) = (vec![], None);
        Self {
            record,
            search: SearchMode::Full,
            mounting: 0,
            mount_disturbed: false,
            outlines,
            curvature,
        }
    }
}

/// Result of a live frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LiveResult {
    /// Number of the frame since the start, from 1.
    pub number: u64,
    /// Time of exposure.
    #[serde(flatten)]
    pub exposure: Exposure,
    /// Time from the middle of the exposure to this result, ms.
    pub latency_ms: f64,
    /// Frames skipped since the start.
    pub skipped: u64,
    #[serde(flatten)]
    pub tracked: TrackedFrame,
}

impl LiveResult {
    /// Returns whether the result has numbers.
    pub fn is_solved(&self) -> bool {
        self.tracked.record.is_solved()
    }

    /// Returns the deflection of the outermost marker, m.
    pub fn tip_deflection_m(&self) -> Option<f64> {
        self.tracked
            .record
            .tip
            .as_ref()
            .filter(|_| self.is_solved())
            .map(|tip| tip.deflection_m)
    }

    /// Returns the result as one JSON object without a line end.
    pub fn json_line(&self) -> String {
        serde_json::to_string(self).unwrap_or_else(|error| {
            serde_json::json!({ "number": self.number, "error": error.to_string() }).to_string()
        })
    }

    /// Returns the number of curvature coefficients.
    pub fn curvature_terms(&self) -> usize {
        self.tracked
            .curvature
            .as_ref()
            .map_or(0, |curvature| curvature.per_m.len())
    }

    /// Returns whether the global test rejects, so that the standard deviations are doubtful.
    pub fn is_rejected(&self) -> bool {
        self.tracked.record.global_test == Some(GlobalTest::Rejected)
    }
}

/// Markers of the previous frame.
struct PreviousFrame {
    detections: Vec<Detection>,
    identities: Identities,
    /// Time of exposure since boot, s.
    at_s: f64,
}

impl PreviousFrame {
    /// Predicts the markers' images in the next frame; the search area grows with the time since this one.
    fn predict_markers(&self, wing: &WingView, at_s: f64) -> Vec<MarkerPrediction> {
        let elapsed_s = at_s - self.at_s;
        if !(0.0..=MAX_GAP_S).contains(&elapsed_s) {
            return vec![];
        }
        let deflection_m =
            (MAX_TIP_SPEED_M_S * elapsed_s).clamp(MAX_DEFLECTION_CHANGE_M, MAX_DISTANCE_M);
        wing.predict_next_frame(&self.detections, &self.identities, deflection_m)
    }
}

/// Largest speed of the tip, m/s: a deflection of 0.25 m at 2 Hz, about the natural frequency of large wings.
const MAX_TIP_SPEED_M_S: f64 = 3.0;
/// Largest change of the tip's deflection in gusts after any time, m. If it is larger, markers are missing and the full
/// frame is searched.
const MAX_DISTANCE_M: f64 = 0.6;
/// Longest gap over which markers are predicted, s.
const MAX_GAP_S: f64 = 5.0;

/// Live solution of one camera, with the information of all frames so far.
pub struct Tracker {
    installation: Arc<Installation>,
    orientation: Orientation,
    job: SolveJob,
    live: LiveAdjustment,
    /// Markers that predict the next frame; `None` before the first frame and after a loss.
    seen: Option<PreviousFrame>,
    /// Exposure of the last solved frame since boot, s.
    last_s: Option<f64>,
}

impl Tracker {
    /// Creates a tracker without any frame.
    ///
    /// # Errors
    /// Returns an error if the installation cannot be adjusted.
    pub fn new(
        installation: Arc<Installation>,
        orientation: Orientation,
        job: SolveJob,
    ) -> Result<Self, AdjustError> {
        let (options, _) =
            flight_priors::with_flight_prior(job.options.clone(), &installation, &[]);
        let live = LiveAdjustment::new(installation.setup.clone(), orientation.clone(), options)?;
        Ok(Self {
            installation,
            orientation,
            job,
            live,
            seen: None,
            last_s: None,
        })
    }

    /// Solves the next frame, exposed `at_s` seconds after boot. An error is in the record; the state is then unchanged.
    pub fn track_frame(
        &mut self,
        name: &str,
        bytes: &[u8],
        format: Option<&Format>,
        at_s: f64,
    ) -> TrackedFrame {
        let tracked = catch_panic(|| {
            let mut processed = ProcessedFrame {
                image: name.into(),
                ..ProcessedFrame::default()
            };
            let search = self.search(&mut processed, bytes, format, at_s);
            self.solve_processed_frame(processed, search, at_s)
        });
        tracked.unwrap_or_else(|| {
            self.build_failed_frame(
                &ProcessedFrame {
                    image: name.into(),
                    ..ProcessedFrame::default()
                },
                PANIC_REASON,
            )
        })
    }

    /// Detects and identifies the markers of the next frame, which the previous one predicts.
    fn search(
        &mut self,
        processed: &mut ProcessedFrame,
        bytes: &[u8],
        format: Option<&Format>,
        at_s: f64,
    ) -> SearchMode {
        let wing = WingView::in_flight(&self.installation.setup, &self.orientation);
        let seen = self.seen.take();
        let predictions = seen
            .as_ref()
            .map_or(vec![], |seen| seen.predict_markers(&wing, at_s));
        let first = |width, height| match &predictions[..] {
            [] => Tiles::all(width, height),
            _ => detect::tiles_read(&predictions, width, height),
        };
        let unread = if predictions.is_empty() {
            SearchMode::Full
        } else {
            SearchMode::Guided
        };
        let Some(mut picture) = processed.decode(|| decode::decode_partial(bytes, format, &first))
        else {
            return unread;
        };
        if wing.has_points_alone() {
            let markers =
                processed.timed(|ended| view::process_frame(&mut picture, Some(&wing), ended));
            processed.set_markers(markers);
            return SearchMode::Full;
        }
        // A fast tip is not at its previous position; the markers near the root predict it.
        let predict_again =
            |found: &[Detection]| wing.predict_from_found(found, &seen.as_ref()?.identities);
        let (found, search) = processed
            .timed(|ended| view::search_guided(&mut picture, &predictions, predict_again, ended));
        let markers =
            processed.timed(|ended| FrameView::new(&wing, &mut picture, ended).name(found.clone()));
        // Guided detection does not find markers that need a second pass: if they were predicted, every frame would be
        // searched in full.
        let first = markers.first_identities.clone();
        self.seen = first.map(|identities| PreviousFrame {
            detections: found.markers,
            identities,
            at_s,
        });
        processed.set_markers(markers);
        search
    }

    fn build_failed_frame(&self, processed: &ProcessedFrame, reason: &str) -> TrackedFrame {
        let mut record =
            recording::build_record(processed, &self.installation, &self.job, Err(reason.into()));
        record.provenance = Provenance::default();
        TrackedFrame {
            mounting: self.live.mounting_count(),
            ..TrackedFrame::failed(record)
        }
    }

    fn solve_processed_frame(
        &mut self,
        mut processed: ProcessedFrame,
        search: SearchMode,
        at_s: f64,
    ) -> TrackedFrame {
        let before = self.live.mounting_count();
        let started = std::time::Instant::now();
        let outcome = correct_refraction(&processed, &self.installation, &self.orientation);
        let outcome = outcome.and_then(|(observations, report)| {
            // Negative if the clock was set back or the frame has no time: no time has passed then.
            let elapsed_s = self.last_s.map_or(0.0, |last| (at_s - last).max(0.0));
            let solution = self
                .live
                .adjust_frame(&observations, elapsed_s)
                .map_err(Reason::from_error)?;
            self.last_s = Some(at_s);
            Ok((solution, report))
        });
        processed
            .stages
            .push(StageTime::since(Work::Solve, started));
        let curvature = outcome
            .as_ref()
            .ok()
            .and_then(|(solution, _)| CurvatureEstimate::from_solution(solution));
        let mut record =
            recording::build_record(&processed, &self.installation, &self.job, outcome);
        // Provenance is equal in all lines and written once with the table of results.
        record.provenance = Provenance::default();
        record.quality.correlation = None;
        let mounting = self.live.mounting_count();
        let mount_disturbed = before > 0 && mounting > before;
        TrackedFrame {
            record,
            search,
            mounting,
            mount_disturbed,
            outlines: detected_outlines(&processed, &self.installation),
            curvature,
        }
    }
}

fn detected_outlines(processed: &ProcessedFrame, installation: &Installation) -> Vec<Outline> {
    let name = |i: usize| {
        let marker = (*processed.identities.as_ref()?.marker_of.get(i)?)?;
        Some(installation.setup.markers.get(marker)?.id.clone())
    };
    let tenth = |value: f64| (value * 10.0).round() / 10.0;
    let outline = |(i, seen): (usize, &wingd_measure::detect::Detection)| Outline {
        id: name(i),
        u_px: tenth(seen.centre_px.x),
        v_px: tenth(seen.centre_px.y),
        semi_major_px: tenth(seen.semi_major_px),
        semi_minor_px: tenth(seen.semi_minor_px),
        angle_deg: tenth(seen.angle_rad.to_degrees()),
    };
    processed
        .detections
        .markers
        .iter()
        .enumerate()
        .map(outline)
        .collect()
}
