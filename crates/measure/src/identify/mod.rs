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
//! | diagnosis | images that do not fit | causes with sizes | `diagnose/` |
//! | prediction | identities or observations of a frame | predicted images | `wing_state.rs` |
//! | guided search | detections in parts of a frame | predicted images | `locate.rs` |
//! | patches | templates of points | their predicted images | `points.rs` |
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
mod points;
mod refine;
mod scan;
mod scene;
mod skin;
mod wing_state;

use nalgebra::Vector2;

use super::detect::{Detection, MarkerPrediction};
use super::estimation::quality::{GlobalTest, critical_w, global_test};
use super::observation::{Estimate, Observation};
use super::setup::{Orientation, Setup};

pub use diagnose::{
    Cause, Diagnosis, Explanation, OTHER_AIRCRAFT, SizedShape, UNITS, diagnose_ground,
    diagnose_ground_fit, diagnose_observations,
};
pub use flight::MIN_IDENTIFIED;
pub use ground::estimate_orientation;
pub use points::{PATCH_REACH_PX, PatchNodes, PatchPrediction};
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
    /// Number of markers of the survey whose predicted images are in the frame.
    pub visible: usize,
}

impl Identities {
    /// Creates the identities of a number of detections from pairs of a detection and its marker.
    fn from_pairs(detections: usize, pairs: &[fit::MatchedPair]) -> Self {
        let mut marker_of = vec![None; detections];
        pairs.iter().for_each(|(i, j)| marker_of[*i] = Some(*j));
        Self {
            marker_of,
            ..Self::default()
        }
    }

    /// Returns the pairs of a detection and its marker.
    fn pairs(&self) -> Vec<fit::MatchedPair> {
        self.marker_of
            .iter()
            .enumerate()
            .filter_map(|(i, j)| Some((i, (*j)?)))
            .collect()
    }

    /// Returns the number of identified detections.
    pub fn count_named(&self) -> usize {
        self.marker_of.iter().flatten().count()
    }

    /// Returns the identified detections as observations, in the order of the survey.
    pub fn observations(&self, detections: &[Detection]) -> Vec<Observation> {
        let named = detections.iter().zip(&self.marker_of);
        let mut list: Vec<Observation> = named
            .filter_map(|(d, marker)| {
                Some(Observation {
                    marker: (*marker)?,
                    pixel: d.centre_px,
                    covariance_px2: *d.covariance_px2,
                })
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
    #[error(
        "only {found} markers found, at least {needed} are needed; check exposure and focus of the frame"
    )]
    TooFew { found: usize, needed: usize },
    /// Too few points are marked: nothing else finds them.
    #[error(
        "an orientation needs {needed} decals and marked points together, but there are {decals} and {marked}: mark points in a ground frame with `wingd mark --ground`, and name the file of the marks with --observations"
    )]
    Unmarked {
        decals: usize,
        marked: usize,
        needed: usize,
    },
    /// Two or more solutions fit equally well.
    #[error(
        "{solutions} different identifications fit the detections equally well; survey more markers or make the layout less regular"
    )]
    Ambiguous {
        /// Number of solutions.
        solutions: usize,
    },
    /// Manual marks contradict the survey: count and cause.
    #[error("{0}")]
    Marks(String),
    /// A ground frame does not fit the other frames.
    #[error("ground frame {}: {}", .0.frame + 1, .0)]
    Misfit(Misfit),
    /// No solution fits.
    #[error(
        "no orientation fits the detected markers to the survey (best: {matched} of {found}); check the survey, the projection centre and the camera calibration"
    )]
    NoConsensus {
        /// Matched detections of the best solution.
        matched: usize,
        found: usize,
    },
}

impl IdentifyError {
    /// Returns whether the error names its cause, so that no diagnosis is needed.
    pub fn names_cause(&self) -> bool {
        matches!(
            self,
            Self::TooFew { .. } | Self::Unmarked { .. } | Self::Marks(_)
        )
    }
}

/// A ground frame that does not fit the other frames.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("only {matched} of its {found} markers fit the other frames; exclude this frame ({})", .cause.as_deref().unwrap_or(UNKNOWN_CAUSE))]
pub struct Misfit {
    /// Index of the frame, from 0.
    pub frame: usize,
    /// Detections that fit.
    pub matched: usize,
    /// Usable detections.
    pub found: usize,
    /// Probable cause.
    pub cause: Option<String>,
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
/// Significance level of the test of the variance factor: one refusal of 1000 good orientations.
const REFUSAL_ALPHA: f64 = 0.001;

impl OrientationFit {
    /// Returns true if the wing was bent since the survey: the bend is significant in a one-dimensional test at a level of
    /// 0.001.
    pub fn is_bent(&self) -> bool {
        let w = |bend: &Estimate| {
            bend.sigma
                .filter(|sigma| *sigma > 0.0)
                .map(|sigma| bend.value / sigma)
        };
        self.bend
            .as_ref()
            .and_then(w)
            .is_some_and(|w| w.abs() > critical_w(BEND_ALPHA))
    }

    /// Returns why the orientation may not be used; `None` if it may. At least two thirds of the markers whose images are
    /// in the frames must fit, and the variance factor must pass its test.
    pub fn refusal(&self, setup: &Setup) -> Option<String> {
        let visible = self.identities.iter().map(|i| i.visible).max().unwrap_or(0);
        let used = setup.markers.len() - self.unused_markers(setup).len();
        if 3 * used < 2 * visible {
            return Some(format!(
                "only {used} of {visible} visible markers fit the survey"
            ));
        }
        let omega = self.variance_factor * self.redundancy as f64;
        let is_rejected =
            global_test(omega, self.redundancy, REFUSAL_ALPHA) == Some(GlobalTest::Rejected);
        is_rejected.then(|| {
            format!(
                "the variance factor is {:.1} with a redundancy of {}",
                self.variance_factor, self.redundancy
            )
        })
    }

    /// Replaces the reason why a marker was not used; returns false if it was used.
    pub fn explain_unused(&mut self, marker: usize, reason: &str) -> bool {
        let mut missing: Vec<&mut (usize, String)> = self
            .identities
            .iter_mut()
            .flat_map(|i| &mut i.missing)
            .filter(|(other, _)| *other == marker)
            .collect();
        missing.iter_mut().for_each(|one| one.1 = reason.to_owned());
        !missing.is_empty() && self.residuals.iter().all(|(_, other, _)| *other != marker)
    }

    /// Returns the mean observations of the identified markers, weighted over the ground frames.
    pub fn ground_observations(
        &self,
        setup: &Setup,
        frames: &[Vec<Detection>],
    ) -> Vec<Observation> {
        let view = WingView::in_flight(setup, &self.orientation);
        let observed = frames
            .iter()
            .zip(&self.identities)
            .flat_map(|(found, identities)| {
                identities.observations(&view.remove_perspective_bias(found, identities))
            });
        Observation::mean_observations(setup.markers.len(), observed)
    }

    /// Lists the markers of the survey of which no image was used, with the reasons.
    pub fn unused_markers(&self, setup: &Setup) -> Vec<(usize, String)> {
        let used = |k: usize| self.residuals.iter().any(|(_, marker, _)| *marker == k);
        let reason = |k: usize| {
            let missing = self
                .identities
                .iter()
                .flat_map(|i| &i.missing)
                .find(|(marker, _)| *marker == k);
            missing.map_or_else(
                || "not found in any frame".into(),
                |(_, reason)| reason.clone(),
            )
        };
        (0..setup.markers.len())
            .filter(|k| !used(*k))
            .map(|k| (k, reason(k)))
            .collect()
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

/// Returns the smallest and the largest deflection of the outermost marker that a wing can have, m.
pub fn plausible_deflections_m(setup: &Setup) -> [f64; 2] {
    let span_m = diagnose::span_m(setup);
    [
        scan::DEFLECTION_RANGE.0 * span_m,
        scan::DEFLECTION_RANGE.1 * span_m,
    ]
}

/// Largest change of the tip's deflection from one frame to the next, m.
pub const MAX_DEFLECTION_CHANGE_M: f64 = 0.2;
