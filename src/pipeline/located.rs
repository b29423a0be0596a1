//! Markers where the installation says to look, and closer looks at them when they have names.

use nalgebra::Vector2;

use crate::measure::detect::{self, Detection, Detections, ExpectedMarker, GuidedDetector, MarkerPrediction};
use crate::measure::identify::{self, IdentifyError, Identities};
use crate::measure::jpeg::PartialImage;
use crate::measure::raster::Raster;
use crate::measure::setup::{Orientation, Setup, Shape};

/// How far aside of its place a missing marker is looked for, px: ten times as far as a simple beam's predictions fail.
const ASIDE_PX: f64 = 100.0;
/// By how much the length of a marker may differ from what the survey and its distance say, as a share: of a disc, and of
/// quadrants, whose white is told less well.
const SAME_SIZE: (f64, f64) = (0.05, 0.15);

/// A picture that is looked at where markers are predicted.
pub trait Picture {
    /// What is looked at about them is there.
    fn about(&mut self, predictions: &[MarkerPrediction]) -> &Raster;
}

impl Picture for &Raster {
    fn about(&mut self, _: &[MarkerPrediction]) -> &Raster {
        self
    }
}

impl Picture for PartialImage {
    fn about(&mut self, predictions: &[MarkerPrediction]) -> &Raster {
        let (width, height) = (self.raster().width(), self.raster().height());
        self.decode_tiles(detect::tiles_read(predictions, width, height));
        self.raster()
    }
}

/// A picture's markers, from the nearest outwards ([`identify::locate`]); `None` where that leads nowhere.
pub(super) fn detected(
    picture: &mut impl Picture,
    setup: &Setup,
    orientation: &Orientation,
) -> Option<Detections> {
    let mut looker = GuidedDetector::new(picture.about(&[]));
    let look = |sought: &[MarkerPrediction]| looker.detect_coarse(picture.about(sought), sought);
    let predictions = identify::locate_markers(setup, orientation, look)?;
    Some(looker.detect(picture.about(&predictions), &predictions))
}

/// What shows aside of the places of markers that are missing and is like them, however the wing is bent. What the ground frames
/// did not show, no frame need show.
pub(super) fn aside(
    picture: &mut impl Picture,
    setup: &Setup,
    orientation: &Orientation,
    (found, identities): &(Detections, Identities),
) -> Vec<Detection> {
    let mut missing = identify::predict_second_pass(setup, orientation, &found.markers, identities);
    let on_ground = |e: &ExpectedMarker| orientation.ground.iter().any(|sight| sight.marker == e.marker);
    missing.retain(|e| e.found.is_none() && on_ground(e));
    let wider = |e: ExpectedMarker| MarkerPrediction { search_px: Vector2::repeat(ASIDE_PX), ..e.prediction };
    let missing: Vec<MarkerPrediction> = missing.into_iter().map(wider).collect();
    if missing.is_empty() {
        return Vec::new();
    }
    let mut looker = GuidedDetector::again(found);
    let same =
        |one: &Detection, other: &Detection| (one.centre_px - other.centre_px).norm() < identify::MIN_SEPARATION_PX;
    let search_px = Vector2::repeat(identify::MIN_SEPARATION_PX);
    let like = |m: &Detection| {
        let like = missing
            .iter()
            .find(|p| is_like(m, p))
            .filter(|_| !found.markers.iter().any(|known| same(known, m)));
        like.map(|p| MarkerPrediction { centre_px: m.centre_px, search_px, ..p.clone() })
    };
    let shown = looker.detect_coarse(picture.about(&missing), &missing);
    let there: Vec<MarkerPrediction> = shown.iter().filter_map(like).collect();
    if there.is_empty() { Vec::new() } else { looker.detect(picture.about(&there), &there).markers }
}

/// Whether something has a marker's shape and size.
fn is_like(found: &Detection, marker: &MarkerPrediction) -> bool {
    let most = if found.shape == Shape::Circle { SAME_SIZE.0 } else { SAME_SIZE.1 };
    found.shape == marker.shape && (found.semi_major_px / marker.semi_major_px - 1.0).abs() < most
}

/// Closer looks at most.
pub(super) const LOOKS: usize = 3;

/// Detections, some of them after closer looks at `picture`, and who is who; perspective bias is not removed.
///
/// # Errors
/// Where no consensus names the markers.
pub fn identified(
    setup: &Setup,
    orientation: &Orientation,
    picture: &mut impl Picture,
    found: Detections,
) -> Result<(Detections, Identities), IdentifyError> {
    let identities = identify::identify_markers(setup, orientation, &found.markers)?;
    Ok(looked_closer(setup, orientation, picture, found, identities))
}

pub(super) fn looked_closer(
    setup: &Setup,
    orientation: &Orientation,
    picture: &mut impl Picture,
    mut found: Detections,
    mut identities: Identities,
) -> (Detections, Identities) {
    // What is measured better foretells the others better.
    for _ in 0..LOOKS {
        let expected = identify::predict_second_pass(setup, orientation, &found.markers, &identities);
        let places: Vec<MarkerPrediction> = expected.iter().map(|e| e.prediction.clone()).collect();
        let mut closer = found.clone();
        if !detect::second_pass(picture.about(&places), &mut closer, &expected) {
            return (closer, identities);
        }
        let Ok(again) = identify::identify_markers(setup, orientation, &closer.markers) else { break };
        (found, identities) = (closer, again);
    }
    (found, identities)
}
