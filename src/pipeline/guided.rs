//! A frame is searched where an earlier one says.

use super::decode::{self, Part};
use super::stages::{Sighting, Work, unseen};
use crate::camera::Format;
use crate::measure::detect::{self, Detection, Prediction};
#[cfg(doc)]
use crate::measure::identify;
use crate::measure::raster::Raster;

/// The markers of a frame that an earlier one foretells ([`identify::predict`]), without names: only what lies about them is
/// decoded and searched, and where one that was seen is missing, the whole frame. `rejected` stays empty unless it was.
pub fn detect_predicted(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
    predictions: &[Prediction],
) -> Sighting {
    let mut sighting = unseen(name, bytes);
    look_guided(&mut sighting, bytes, format, predictions, |_| None);
    sighting
}

/// How a frame was searched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Search {
    /// All of it.
    Whole,
    /// Where the frame before predicted markers.
    Guided,
}

/// Without predictions the whole frame is searched, and where guided detection misses one that was seen, also where `onwards`
/// says that it is by those found. The picture that comes back may be black where nothing was looked at.
pub(super) fn look_guided(
    sighting: &mut Sighting,
    bytes: &[u8],
    format: Option<&Format>,
    predictions: &[Prediction],
    onwards: impl FnOnce(&[Detection]) -> Option<Vec<Prediction>>,
) -> (Option<Raster>, Search) {
    if predictions.is_empty() {
        return whole(sighting, bytes, format);
    }
    let part = sighting.look(
        || decode::decode_part(bytes, format).map(|part| reading(part, predictions)),
        |raster| detect::detect_guided(raster, predictions),
    );
    let Some(mut part) = part else { return (None, Search::Guided) };
    if detect::is_complete(&sighting.detections, predictions) {
        return (Some(part.into_raster()), Search::Guided);
    }
    if let Some(better) = onwards(&sighting.detections.markers).filter(|better| !better.is_empty()) {
        part = sighting.timed(Work::Decode, || reading(part, &better));
        let found = sighting.timed(Work::Detect, || detect::detect_guided(part.raster(), &better));
        if detect::is_complete(&found, &better) {
            sighting.detections = found;
            return (Some(part.into_raster()), Search::Guided);
        }
    }
    // What is left of it.
    let rest = || {
        let (width, height) = (part.raster().width(), part.raster().height());
        part.read(&vec![0..width; height]);
        Ok(part.into_raster())
    };
    (sighting.look(rest, detect::detect), Search::Whole)
}

/// With what is looked at where markers are predicted.
fn reading(mut part: Part, predictions: &[Prediction]) -> Part {
    let (width, height) = (part.raster().width(), part.raster().height());
    part.read(&detect::columns_read(predictions, width, height));
    part
}

/// The whole frame is searched.
fn whole(sighting: &mut Sighting, bytes: &[u8], format: Option<&Format>) -> (Option<Raster>, Search) {
    (sighting.look(|| decode::decode(bytes, format), detect::detect), Search::Whole)
}
