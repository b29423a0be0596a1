//! Markers -> identities and orientation.
//!
//! | stage | in | out | file |
//! |---|---|---|---|
//! | consensus | detections of a ground frame | rotation, rough | `consensus.rs`, `attitude.rs` |
//! | adjustment | ground frames with identities | rotation with covariance | `ground.rs`, `refine.rs` |
//! | scan | detections in flight | deflections and shifts worth a try | `scan.rs` |
//! | matching | one of these | pairs and a fitted state | `matching.rs`, `fit.rs` |
//! | decision | pairs | identities beyond doubt, reasons for the others | `decide.rs`, `flight.rs` |
//! | bias | identified outlines | images of the centres | `bias.rs`, `outline.rs` |
//! | cause | a frame that fits nothing | what it fits after all | `explain.rs` |
//! | prediction | one frame's identities | where to look in the next | `known.rs` |
//! | location | looks at parts of a frame | where it shows the markers | `locate.rs` |
//!
//! The wing behind all of them is in `skin.rs`, `beam.rs` and `scene.rs`.

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

pub use diagnose::Cause;
pub use locate::MIN_SEPARATION_PX;

/// Which detection is which marker.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Identities {
    /// Per detection: index in [`Setup::markers`], or `None` for a false or unclear one.
    pub marker_of: Vec<Option<usize>>,
    /// Per marker of the survey without a detection: one sentence that says why.
    pub missing: Vec<(usize, String)>,
    /// Estimated tip deflection of the consensus, m.
    pub tip_deflection_m: f64,
}

/// Why identities or an orientation could not be had.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IdentifyError {
    /// Not enough detections to decide.
    #[error(
        "only {found} markers found, at least {needed} are needed; check exposure and focus of the frame"
    )]
    TooFew {
        /// Detections at hand.
        found: usize,
        /// Detections needed.
        needed: usize,
    },
    /// Two or more solutions fit alike.
    #[error(
        "{solutions} different identifications fit the detections alike; survey more markers or make the layout less regular"
    )]
    Ambiguous {
        /// How many.
        solutions: usize,
    },
    /// A frame among others fits nothing.
    #[error("ground frame {}: {}", .0.frame + 1, .0)]
    Misfit(Misfit),
    /// Nothing fits.
    #[error(
        "the detected markers fit the survey in no orientation (best: {matched} of {found}); check that the frame shows this wing, then the survey, the projection centre and the camera calibration"
    )]
    NoConsensus {
        /// Matched in the best try.
        matched: usize,
        /// Detections at hand.
        found: usize,
    },
}

/// One frame of several that does not fit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("only {matched} of its {found} markers lie where the other frames put them; {}: leave it out", .cause.map_or_else(|| UNKNOWN_CAUSE.to_owned(), |c| c.to_string()))]
pub struct Misfit {
    /// Which, from 0.
    pub frame: usize,
    /// Markers that fit.
    pub matched: usize,
    /// Detections at hand.
    pub found: usize,
    /// What it fits after all.
    pub cause: Option<Cause>,
}

/// Of a frame that fits nothing.
const UNKNOWN_CAUSE: &str = "it is of another mounting, of a wing in flight or of another scene";

/// An orientation from one or more ground frames.
#[derive(Clone, Debug, PartialEq)]
pub struct OrientationFit {
    /// The estimate with its covariance.
    pub orientation: Orientation,
    /// Weighted squared residuals over the redundancy.
    pub variance_factor: f64,
    /// Conditions less parameters.
    pub redundancy: usize,
    /// How much higher the wing stood in the ground frames than surveyed, by bending, at its tip, m; a posteriori where the
    /// variance factor is above 1. `None` where the sights do not tell.
    pub bend: Option<Estimate>,
    /// Per frame, per identified marker: (frame, marker index, residual observed - computed, px).
    pub residuals: Vec<(usize, usize, Vector2<f64>)>,
    /// Per frame: identities.
    pub identities: Vec<Identities>,
}

/// Level of significance of the test of the bend.
const BEND_ALPHA: f64 = 0.001;

impl OrientationFit {
    /// Whether the wing was bent since the survey: a bend is no chance, one-dimensional test at a level of 0.001.
    pub fn is_bent(&self) -> bool {
        let w = |bend: &Estimate| bend.sigma.filter(|sigma| *sigma > 0.0).map(|sigma| bend.value / sigma);
        self.bend.as_ref().and_then(w).is_some_and(|w| w.abs() > critical_w(BEND_ALPHA))
    }

    /// Every marker of the survey that no frame's image of was used, and why.
    pub fn unused_markers(&self, setup: &Setup) -> Vec<(usize, String)> {
        let used = |k: usize| self.residuals.iter().any(|(_, marker, _)| *marker == k);
        let reason = |k: usize| {
            let told = self.identities.iter().flat_map(|i| &i.missing).find(|(marker, _)| *marker == k);
            told.map_or_else(|| "not found in any frame".into(), |(_, reason)| reason.clone())
        };
        (0..setup.markers.len()).filter(|k| !used(*k)).map(|k| (k, reason(k))).collect()
    }
}

/// Orientation from ground frames with no initial guess (docs/model.md). All frames show the
/// wing as surveyed, from one mounting of the camera.
pub fn estimate_orientation(setup: &Setup, frames: &[Vec<Detection>]) -> Result<OrientationFit, IdentifyError> {
    ground::orient_frames(setup, frames)
}

/// Identities in flight, from the orientation and the consensus over the tip deflection.
pub fn identify_markers(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
) -> Result<Identities, IdentifyError> {
    flight::identify_frame(&scene::Scene::new(setup, orientation, true), detections)
}

/// What a frame fits that [`identify`] refused, if anything tells.
pub fn diagnose_flight_frame(setup: &Setup, orientation: &Orientation, detections: &[Detection]) -> Option<Cause> {
    diagnose::diagnose_flight_frame(setup, orientation, detections)
}

/// What one of the frames fits that [`orient`] refused, with its index, if anything tells.
pub fn diagnose_ground_frames(setup: &Setup, frames: &[Vec<Detection>]) -> Option<(usize, Cause)> {
    frames.iter().enumerate().find_map(|(k, frame)| Some((k, diagnose::diagnose_ground_frame(setup, frame)?)))
}

/// Image of each identified marker's true centre: the ellipse's perspective bias removed with the
/// surveyed diameter and the local normal (docs/model.md). Same order and length as
/// `detections`; unidentified ones come back unchanged.
pub fn remove_perspective_bias(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<Detection> {
    wing_state::remove_bias(&scene::Scene::new(setup, orientation, true), detections, identities)
}

/// Where this frame should show the markers, and which of them were found: what [`crate::detect::look_closer`] looks
/// for. Empty where the identities are too few.
pub fn predict_second_pass(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<ExpectedMarker> {
    wing_state::predict_second_pass(&scene::Scene::new(setup, orientation, true), detections, identities)
}

/// Where a frame shows a marker, foretold by the others.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictedMarker {
    /// Index in [`Setup::markers`].
    pub marker: usize,
    /// Its outline.
    pub prediction: MarkerPrediction,
    /// Image of its centre, px; the outline's own centre is beside it.
    pub point_px: Vector2<f64>,
}

/// Where a frame shows the markers, by observations whose names are beyond doubt, as a person's are: from the first one on,
/// for nothing is to be checked by them. Without any, as on ground. What lies outside the frame is missing.
pub fn predict_markers(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
) -> Vec<PredictedMarker> {
    wing_state::predict_markers(&scene::Scene::new(setup, orientation, true), observations)
}

/// The same for a ground frame.
pub fn predict_ground_markers(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
) -> Vec<PredictedMarker> {
    wing_state::predict_markers(&scene::Scene::new(setup, orientation, false), observations)
}

/// A marker that was measured by its outline, with its centre at the image of the marker's centre: the state of the wing is
/// that of the observations, its own among them.
pub fn correct_marker_centre(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    marker: usize,
    found: &Detection,
) -> Detection {
    wing_state::correct_marker_centre(&scene::Scene::new(setup, orientation, true), observations, marker, found)
}

/// The same for a ground frame, which shows the wing as surveyed: what [`orient`] did not find is sought there before the
/// survey is blamed.
pub fn predict_ground_second_pass(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<ExpectedMarker> {
    wing_state::predict_second_pass(&scene::Scene::new(setup, orientation, false), detections, identities)
}

/// Where the markers of the next frame are expected, from one frame's detections and identities:
/// every marker that should be in the frame, found or not. Empty where the identities are too few.
pub fn predict_next_frame(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<MarkerPrediction> {
    predict_next_frame_within(setup, orientation, detections, identities, MAX_DEFLECTION_CHANGE_M)
}

/// The same where the deflection of the tip may change by `deflection_m`, m, until the next frame.
pub fn predict_next_frame_within(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
    identities: &Identities,
    deflection_m: f64,
) -> Vec<MarkerPrediction> {
    wing_state::predict_next_frame(
        &scene::Scene::new(setup, orientation, true),
        detections,
        identities,
        deflection_m,
    )
}

/// Where a frame shows the markers: those nearest to the camera first, each round telling where the next ones are. `look` finds
/// markers where they are predicted, as [`crate::detect::detect_guided`] does. `None` where that leads nowhere.
pub fn locate_markers(
    setup: &Setup,
    orientation: &Orientation,
    look: impl FnMut(&[MarkerPrediction]) -> Vec<Detection>,
) -> Option<Vec<MarkerPrediction>> {
    locate::locate_markers(&scene::Scene::new(setup, orientation, true), look)
}

/// Where a frame shows all markers by those of it that are `found` already, near the camera, where they hardly move; those that
/// an earlier frame showed, by its `identities`, are expected to be seen. `None` where those found do not fit the wing.
pub fn predict_from_found(
    setup: &Setup,
    orientation: &Orientation,
    found: &[Detection],
    identities: &Identities,
) -> Option<Vec<MarkerPrediction>> {
    locate::predict_from_found(&scene::Scene::new(setup, orientation, true), found, &identities.marker_of)
}

/// The markers that [`locate`] looks for first.
pub fn predict_nearest(setup: &Setup, orientation: &Orientation) -> Vec<MarkerPrediction> {
    locate::predict_nearest(&scene::Scene::new(setup, orientation, true))
}

/// How far the wing may move from one frame to the next: change of the tip's deflection, m.
pub const MAX_DEFLECTION_CHANGE_M: f64 = 0.2;
