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
//! All stages share the wing model of `skin.rs`, `beam.rs` and `scene.rs`; those of frames in flight are functions of the
//! [`WingView`].

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

use super::detect::{Detection, MarkerPrediction};
use super::estimation::quality::critical_w;
use super::observation::{Estimate, Observation};
use super::setup::{Orientation, Setup};

pub use diagnose::{MismatchCause, diagnose_ground_frames};
pub use ground::estimate_orientation;
pub use locate::MIN_SEPARATION_PX;
pub use scene::WingView;

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

impl Identities {
    /// Returns the identified detections as observations, in the order of the survey.
    pub fn observations(&self, detections: &[Detection]) -> Vec<Observation> {
        let named = detections.iter().zip(&self.marker_of);
        let mut list: Vec<Observation> = named
            .filter_map(|(d, marker)| {
                Some(Observation { marker: (*marker)?, pixel: d.centre_px, covariance_px2: *d.covariance_px2 })
            })
            .collect();
        list.sort_by_key(|o| o.marker);
        list
    }
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

    /// Returns the mean observations of the identified markers, weighted over the ground frames.
    pub fn ground_observations(&self, setup: &Setup, frames: &[Vec<Detection>]) -> Vec<Observation> {
        let view = WingView::in_flight(setup, &self.orientation);
        let observed = frames
            .iter()
            .zip(&self.identities)
            .flat_map(|(found, identities)| identities.observations(&view.remove_perspective_bias(found, identities)));
        Observation::mean_observations(setup.markers.len(), observed)
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

/// Largest change of the tip's deflection from one frame to the next, m.
pub const MAX_DEFLECTION_CHANGE_M: f64 = 0.2;
