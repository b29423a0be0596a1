//! Detection of markers at the positions that the installation predicts, and second passes over identified markers.

use nalgebra::Vector2;

use crate::measure::detect::{self, Detection, Detections, ExpectedMarker, GuidedDetector, MarkerPrediction};
use crate::measure::identify::{self, IdentifyError, Identities};
use crate::measure::jpeg::PartialImage;
use crate::measure::raster::Raster;
use crate::measure::setup::{Orientation, Setup, Shape};

/// Distance from its predicted position within which a missing marker is searched for, px: ten times the error of a simple
/// beam's predictions.
const DISPLACED_SEARCH_PX: f64 = 100.0;
/// Largest relative difference between the length of a marker's image and the one predicted from survey and distance: of a
/// circle, and of quadrants, whose white area is less well determined.
const SIZE_TOLERANCES: (f64, f64) = (0.05, 0.15);

/// Image of which the parts around predicted markers can be requested.
pub trait PartialSource {
    /// Returns the image with the surroundings of the predicted markers decoded.
    fn decoded_around(&mut self, predictions: &[MarkerPrediction]) -> &Raster;
}

impl PartialSource for &Raster {
    fn decoded_around(&mut self, _: &[MarkerPrediction]) -> &Raster {
        self
    }
}

impl PartialSource for PartialImage {
    fn decoded_around(&mut self, predictions: &[MarkerPrediction]) -> &Raster {
        let (width, height) = (self.raster().width(), self.raster().height());
        self.decode_tiles(detect::tiles_read(predictions, width, height));
        self.raster()
    }
}

/// Detects the markers of an image from the nearest outwards ([`identify::locate_markers`]); `None` if that fails.
pub(super) fn detect_located(
    source: &mut impl PartialSource,
    setup: &Setup,
    orientation: &Orientation,
) -> Option<Detections> {
    let mut detector = GuidedDetector::new(source.decoded_around(&[]));
    let locate = |targets: &[MarkerPrediction]| detector.detect_coarse(source.decoded_around(targets), targets);
    let predictions = identify::locate_markers(setup, orientation, locate)?;
    Some(detector.detect(source.decoded_around(&predictions), &predictions))
}

/// Detects candidates for missing markers away from their predicted positions, for any bending of the wing.
///
/// Markers that the ground frames did not show are not searched for.
pub(super) fn detect_displaced(
    source: &mut impl PartialSource,
    setup: &Setup,
    orientation: &Orientation,
    (found, identities): &(Detections, Identities),
) -> Vec<Detection> {
    let mut missing = identify::predict_second_pass(setup, orientation, &found.markers, identities);
    let on_ground = |e: &ExpectedMarker| orientation.ground.iter().any(|observation| observation.marker == e.marker);
    missing.retain(|e| e.found.is_none() && on_ground(e));
    let wider =
        |e: ExpectedMarker| MarkerPrediction { search_px: Vector2::repeat(DISPLACED_SEARCH_PX), ..e.prediction };
    let missing: Vec<MarkerPrediction> = missing.into_iter().map(wider).collect();
    if missing.is_empty() {
        return Vec::new();
    }
    let mut detector = GuidedDetector::from_detections(found);
    let same =
        |one: &Detection, other: &Detection| (one.centre_px - other.centre_px).norm() < identify::MIN_SEPARATION_PX;
    let search_px = Vector2::repeat(identify::MIN_SEPARATION_PX);
    let similar = |m: &Detection| {
        let similar =
            missing.iter().find(|p| matches_marker(m, p)).filter(|_| !found.markers.iter().any(|known| same(known, m)));
        similar.map(|p| MarkerPrediction { centre_px: m.centre_px, search_px, ..p.clone() })
    };
    let candidates = detector.detect_coarse(source.decoded_around(&missing), &missing);
    let similar_predictions: Vec<MarkerPrediction> = candidates.iter().filter_map(similar).collect();
    if similar_predictions.is_empty() {
        Vec::new()
    } else {
        detector.detect(source.decoded_around(&similar_predictions), &similar_predictions).markers
    }
}

/// Returns whether a detection has the shape and size of a marker.
fn matches_marker(found: &Detection, marker: &MarkerPrediction) -> bool {
    let most = if found.shape == Shape::Circle { SIZE_TOLERANCES.0 } else { SIZE_TOLERANCES.1 };
    found.shape == marker.shape && (found.semi_major_px / marker.semi_major_px - 1.0).abs() < most
}

/// Largest number of second passes.
pub(super) const MAX_PASSES: usize = 3;

/// Identifies detections and refines them by second passes over `source`; perspective bias is not removed.
///
/// # Errors
/// Returns an error if no consensus identifies the markers.
pub fn identify_and_refine(
    setup: &Setup,
    orientation: &Orientation,
    source: &mut impl PartialSource,
    found: Detections,
) -> Result<(Detections, Identities), IdentifyError> {
    let identities = identify::identify_markers(setup, orientation, &found.markers)?;
    Ok(refine_detections(setup, orientation, source, found, identities))
}

pub(super) fn refine_detections(
    setup: &Setup,
    orientation: &Orientation,
    source: &mut impl PartialSource,
    mut found: Detections,
    mut identities: Identities,
) -> (Detections, Identities) {
    // More precise measurements improve the predictions of the others.
    for _ in 0..MAX_PASSES {
        let expected = identify::predict_second_pass(setup, orientation, &found.markers, &identities);
        let places: Vec<MarkerPrediction> = expected.iter().map(|e| e.prediction.clone()).collect();
        let mut refined = found.clone();
        if !detect::second_pass(source.decoded_around(&places), &mut refined, &expected) {
            return (refined, identities);
        }
        let Ok(again) = identify::identify_markers(setup, orientation, &refined.markers) else { break };
        (found, identities) = (refined, again);
    }
    (found, identities)
}
