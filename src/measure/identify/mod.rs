//! Identification of markers and orientation of the camera.
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | consensus | detections of a ground frame | coarse rotation | `consensus.rs`, `attitude.rs` |
//! | adjustment | ground frames with identities | rotation with covariance | `ground.rs`, `refine.rs` |
//! | scan | detections in flight | candidate deflections and shifts | `scan.rs` |
//! | matching | one of the candidates | pairs and a fitted state | `matching.rs`, `fit.rs` |
//! | decision | pairs | unambiguous identities, reasons for the others | `decide.rs`, `flight.rs` |
//! | bias | identified outlines | images of the centres | `bias.rs`, `outline.rs` |
//! | diagnosis | a frame that fits nothing | probable cause | `diagnose.rs` |
//! | prediction | identities or observations of a frame | predicted images | `wing_state.rs` |
//! | guided search | detections in parts of a frame | predicted images | `locate.rs` |
//!
//! All stages share the wing model of `skin.rs`, `beam.rs` and `scene.rs`.

mod attitude;
mod beam;
mod bias;
mod consensus;
mod decide;
mod diagnose;
mod fit;
mod flight;
mod ground;
mod locate;
mod matching;
mod outline;
mod refine;
mod scan;
mod scene;
mod skin;
mod wing_state;

use nalgebra::Vector2;

use super::detect::{Detection, ExpectedMarker, MarkerPrediction};
use super::estimation::quality::critical_w;
use super::observation::{Estimate, Observation};
use super::setup::{Orientation, Setup};

pub use diagnose::MismatchCause;
pub use locate::MIN_SEPARATION_PX;

/// Identities of a frame's detections.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Identities {
    /// Index in [`Setup::markers`] for each detection; `None` for a false or ambiguous one.
    pub marker_of: Vec<Option<usize>>,
    /// Markers without a detection, each with the reason in one sentence.
    pub missing: Vec<(usize, String)>,
    /// Estimated tip deflection, m.
    pub tip_deflection_m: f64,
}

/// An error of identification or orientation.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IdentifyError {
    /// Too few markers were detected.
    #[error("only {found} markers found, at least {needed} are needed; check exposure and focus of the frame")]
    TooFew { found: usize, needed: usize },
    /// Two or more solutions fit equally well.
    #[error(
        "{solutions} different identifications fit the detections equally well; survey more markers or make the layout less regular"
    )]
    Ambiguous {
        /// Number of solutions.
        solutions: usize,
    },
    /// A ground frame does not fit the other frames.
    #[error("ground frame {}: {}", .0.frame + 1, .0)]
    Misfit(Misfit),
    /// No solution fits.
    #[error(
        "no orientation fits the detected markers to the survey (best: {matched} of {found}); check that the frame shows this wing, then the survey, the projection centre and the camera calibration"
    )]
    NoConsensus {
        /// Matched detections of the best solution.
        matched: usize,
        found: usize,
    },
}

/// A ground frame that does not fit the other frames.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("only {matched} of its {found} markers fit the other frames; exclude this frame ({})", .cause.map_or_else(|| UNKNOWN_CAUSE.to_owned(), |c| c.to_string()))]
pub struct Misfit {
    /// Index of the frame, from 0.
    pub frame: usize,
    /// Detections that fit.
    pub matched: usize,
    /// Usable detections.
    pub found: usize,
    /// Probable cause.
    pub cause: Option<MismatchCause>,
}

/// Cause in the message of [`Misfit`] if none was diagnosed.
const UNKNOWN_CAUSE: &str = "it shows another mounting, a wing in flight or another scene";

/// An orientation estimated from one or more ground frames.
#[derive(Clone, Debug, PartialEq)]
pub struct OrientationFit {
    /// Orientation with its covariance.
    pub orientation: Orientation,
    /// Weighted sum of squared residuals over the redundancy.
    pub variance_factor: f64,
    /// Conditions minus parameters.
    pub redundancy: usize,
    /// Bend of the wing at its tip in the ground frames, relative to the survey, positive upwards, m; a posteriori if the
    /// variance factor exceeds 1. `None` if the observations do not determine it.
    pub bend: Option<Estimate>,
    /// Residuals of the identified markers: (frame, marker index, observed minus computed, px).
    pub residuals: Vec<(usize, usize, Vector2<f64>)>,
    /// Identities of each frame.
    pub identities: Vec<Identities>,
}

/// Significance level of the test of the bend.
const BEND_ALPHA: f64 = 0.001;

impl OrientationFit {
    /// Returns true if the wing was bent since the survey: the bend is significant in a one-dimensional test at a level of
    /// 0.001.
    pub fn is_bent(&self) -> bool {
        let w = |bend: &Estimate| bend.sigma.filter(|sigma| *sigma > 0.0).map(|sigma| bend.value / sigma);
        self.bend.as_ref().and_then(w).is_some_and(|w| w.abs() > critical_w(BEND_ALPHA))
    }

    /// Lists the markers of the survey of which no image was used, with the reasons.
    pub fn unused_markers(&self, setup: &Setup) -> Vec<(usize, String)> {
        let used = |k: usize| self.residuals.iter().any(|(_, marker, _)| *marker == k);
        let reason = |k: usize| {
            let missing = self.identities.iter().flat_map(|i| &i.missing).find(|(marker, _)| *marker == k);
            missing.map_or_else(|| "not found in any frame".into(), |(_, reason)| reason.clone())
        };
        (0..setup.markers.len()).filter(|k| !used(*k)).map(|k| (k, reason(k))).collect()
    }
}

/// Estimates the orientation from ground frames without an initial guess (docs/model.md). All frames show the wing as
/// surveyed, from one mounting of the camera.
///
/// # Errors
/// Returns an error if too few markers are found, a frame does not fit the others, or none or more than one solution fits.
pub fn estimate_orientation(setup: &Setup, frames: &[Vec<Detection>]) -> Result<OrientationFit, IdentifyError> {
    ground::orient_frames(setup, frames)
}

/// Identifies the markers of a frame in flight, given the orientation.
///
/// # Errors
/// Returns an error if too few markers are found, or none or more than one solution fits.
pub fn identify_markers(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
) -> Result<Identities, IdentifyError> {
    flight::identify_frame(&scene::WingView::new(setup, orientation, true), detections)
}

/// Diagnoses a frame that [`identify_markers`] rejected. Returns `None` if no cause is found.
pub fn diagnose_flight_frame(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
) -> Option<MismatchCause> {
    diagnose::diagnose_flight_frame(setup, orientation, detections)
}

/// Diagnoses ground frames that [`estimate_orientation`] rejected. Returns the index of a frame and its cause, or `None` if
/// no cause is found.
pub fn diagnose_ground_frames(setup: &Setup, frames: &[Vec<Detection>]) -> Option<(usize, MismatchCause)> {
    frames.iter().enumerate().find_map(|(k, frame)| Some((k, diagnose::diagnose_ground_frame(setup, frame)?)))
}

/// Moves the identified markers' detections to the images of their true centres: the perspective bias of the ellipse is
/// removed with the surveyed diameter and the local normal (docs/model.md). The result has order and length of
/// `detections`; unidentified ones are unchanged.
pub fn remove_perspective_bias(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<Detection> {
    wing_state::remove_bias(&scene::WingView::new(setup, orientation, true), detections, identities)
}

/// Predicts the markers of a frame for [`crate::detect::second_pass`], with the detections that were identified. Empty if
/// too few are.
pub fn predict_second_pass(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<ExpectedMarker> {
    wing_state::predict_second_pass(&scene::WingView::new(setup, orientation, true), detections, identities)
}

/// Predicted image of a marker.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictedMarker {
    /// Index in [`Setup::markers`].
    pub marker: usize,
    /// Outline for the detector.
    pub prediction: MarkerPrediction,
    /// Image of the marker's centre, px; the outline has its own centre.
    pub point_px: Vector2<f64>,
}

/// Predicts the markers of a frame in flight from observations of known identity, for example manual marks. One observation
/// is enough, because none is needed to check the identities; without observations, the wing is predicted as on the ground.
/// Markers outside the frame are omitted.
pub fn predict_markers(setup: &Setup, orientation: &Orientation, observations: &[Observation]) -> Vec<PredictedMarker> {
    wing_state::predict_markers(&scene::WingView::new(setup, orientation, true), observations)
}

/// Predicts the markers of a ground frame, as [`predict_markers`] does for a frame in flight.
pub fn predict_ground_markers(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
) -> Vec<PredictedMarker> {
    wing_state::predict_markers(&scene::WingView::new(setup, orientation, false), observations)
}

/// Moves a marker's measured outline to the image of the marker's centre. The state of the wing is fitted to the
/// observations and this outline.
pub fn correct_marker_centre(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    marker: usize,
    found: &Detection,
) -> Detection {
    wing_state::correct_marker_centre(&scene::WingView::new(setup, orientation, true), observations, marker, found)
}

/// Predicts the markers of a ground frame for a second pass, which searches for the markers that [`estimate_orientation`]
/// did not find before the survey is blamed.
pub fn predict_ground_second_pass(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<ExpectedMarker> {
    wing_state::predict_second_pass(&scene::WingView::new(setup, orientation, false), detections, identities)
}

/// Predicts the markers of the next frame, found or not, from the identities of a frame. Empty if too few detections are
/// identified.
pub fn predict_next_frame(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<MarkerPrediction> {
    predict_next_frame_within(setup, orientation, detections, identities, MAX_DEFLECTION_CHANGE_M)
}

/// Predicts the markers of the next frame if the deflection of the tip may change by `deflection_m`, m.
pub fn predict_next_frame_within(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
    identities: &Identities,
    deflection_m: f64,
) -> Vec<MarkerPrediction> {
    wing_state::predict_next_frame(
        &scene::WingView::new(setup, orientation, true),
        detections,
        identities,
        deflection_m,
    )
}

/// Searches for the markers of a frame, the nearest to the camera first; each round predicts the next markers. `detect_at`
/// detects markers in predicted areas, as [`crate::detect::detect_guided`] does. Returns predictions of all markers, or
/// `None` if the search fails.
pub fn locate_markers(
    setup: &Setup,
    orientation: &Orientation,
    detect_at: impl FnMut(&[MarkerPrediction]) -> Vec<Detection>,
) -> Option<Vec<MarkerPrediction>> {
    locate::locate_markers(&scene::WingView::new(setup, orientation, true), detect_at)
}

/// Predicts all markers of a frame from `found` detections near the camera, where the wing hardly moves. Markers of
/// `identities`, from an earlier frame, are predicted as visible. Returns `None` if the detections do not fit the wing.
pub fn predict_from_found(
    setup: &Setup,
    orientation: &Orientation,
    found: &[Detection],
    identities: &Identities,
) -> Option<Vec<MarkerPrediction>> {
    locate::predict_from_found(&scene::WingView::new(setup, orientation, true), found, &identities.marker_of)
}

/// Predicts the markers that [`locate_markers`] searches for first.
pub fn predict_nearest(setup: &Setup, orientation: &Orientation) -> Vec<MarkerPrediction> {
    locate::predict_nearest(&scene::WingView::new(setup, orientation, true))
}

/// Largest change of the tip's deflection from one frame to the next, m.
pub const MAX_DEFLECTION_CHANGE_M: f64 = 0.2;
