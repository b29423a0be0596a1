//! A frame is searched where an earlier one says.

use super::decode::{self, PartialImage};
use super::located::Picture;
use super::stages::{ProcessedFrame, Work, unseen};
use crate::camera::Format;
use crate::measure::detect::{self, Detection, MarkerPrediction};
#[cfg(doc)]
use crate::measure::identify;
use crate::measure::raster::Raster;
use crate::measure::tiles::Tiles;

/// The markers of a frame that an earlier one foretells ([`identify::predict`]), without names: only what lies about them is
/// decoded and searched, and where one that was seen is missing, the whole frame. `rejected` stays empty unless it was.
pub fn detect_predicted(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
    predictions: &[MarkerPrediction],
) -> ProcessedFrame {
    let mut sighting = unseen(name, bytes);
    look_guided(&mut sighting, bytes, format, predictions, |_| None);
    sighting
}

/// How a frame was searched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Search {
    /// All of it.
    Full,
    /// Where the frame before predicted markers.
    Guided,
}

/// Without predictions the whole frame is searched, and where guided detection misses one that was seen, also where `onwards`
/// says that it is by those found. The picture that comes back may be black where nothing was read.
pub(super) fn look_guided(
    sighting: &mut ProcessedFrame,
    bytes: &[u8],
    format: Option<&Format>,
    predictions: &[MarkerPrediction],
    onwards: impl FnOnce(&[Detection]) -> Option<Vec<MarkerPrediction>>,
) -> (Option<PartialImage>, Search) {
    if predictions.is_empty() {
        let part = sighting.look(|| decode::decode_part(bytes, format, &Tiles::all), detect::detect);
        return (part, Search::Full);
    }
    let tiles = |width, height| detect::tiles_read(predictions, width, height);
    let guided = |raster: &Raster| detect::detect_guided(raster, predictions);
    let Some(mut part) = sighting.look(|| decode::decode_part(bytes, format, &tiles), guided) else {
        return (None, Search::Guided);
    };
    if detect::is_complete(&sighting.detections, predictions) {
        return (Some(part), Search::Guided);
    }
    if let Some(better) = onwards(&sighting.detections.markers).filter(|better| !better.is_empty()) {
        let raster = sighting.timed(Work::Decode, || part.about(&better));
        let found = sighting.timed(Work::Detect, || detect::detect_guided(raster, &better));
        if detect::is_complete(&found, &better) {
            sighting.detections = found;
            return (Some(part), Search::Guided);
        }
    }
    sighting.look_at_all(&mut part);
    (Some(part), Search::Full)
}
