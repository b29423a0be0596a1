//! Guided search of a frame at positions that an earlier frame predicts.

use super::decode::{self, PartialImage};
use super::located::PartialSource;
use super::stages::{ProcessedFrame, Work, new_frame};
use crate::camera::Format;
use crate::measure::detect::{self, Detection, MarkerPrediction};
#[cfg(doc)]
use crate::measure::identify;
use crate::measure::raster::Raster;
use crate::measure::tiles::Tiles;

/// Detects the markers that an earlier frame predicts ([`identify::predict_next_frame`]), without names.
///
/// Only the area around them is decoded and searched; the full frame is searched if one of them is missing. `rejected`
/// stays empty unless it was.
pub fn detect_predicted(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
    predictions: &[MarkerPrediction],
) -> ProcessedFrame {
    let mut processed = new_frame(name, bytes);
    search_guided(&mut processed, bytes, format, predictions, |_| None);
    processed
}

/// Extent of the search in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SearchMode {
    /// Search of the full frame.
    Full,
    /// Search around the positions that the previous frame predicts.
    Guided,
}

/// Detects markers around `predictions`, and in the full frame if there are none.
///
/// If a marker of the previous frame is missing, the positions that `predict_again` derives from the markers found are
/// searched, then the full frame. The returned image may be black where it was not decoded.
pub(super) fn search_guided(
    processed: &mut ProcessedFrame,
    bytes: &[u8],
    format: Option<&Format>,
    predictions: &[MarkerPrediction],
    predict_again: impl FnOnce(&[Detection]) -> Option<Vec<MarkerPrediction>>,
) -> (Option<PartialImage>, SearchMode) {
    if predictions.is_empty() {
        let part = processed.detect_in(|| decode::decode_partial(bytes, format, &Tiles::all), detect::detect);
        return (part, SearchMode::Full);
    }
    let tiles = |width, height| detect::tiles_read(predictions, width, height);
    let guided = |raster: &Raster| detect::detect_guided(raster, predictions);
    let Some(mut part) = processed.detect_in(|| decode::decode_partial(bytes, format, &tiles), guided) else {
        return (None, SearchMode::Guided);
    };
    if detect::is_complete(&processed.detections, predictions) {
        return (Some(part), SearchMode::Guided);
    }
    if let Some(refined) = predict_again(&processed.detections.markers).filter(|refined| !refined.is_empty()) {
        let raster = processed.timed(Work::Decode, || part.decoded_around(&refined));
        let found = processed.timed(Work::Detect, || detect::detect_guided(raster, &refined));
        if detect::is_complete(&found, &refined) {
            processed.detections = found;
            return (Some(part), SearchMode::Guided);
        }
    }
    processed.detect_full(&mut part);
    (Some(part), SearchMode::Full)
}
