//! A frame is searched where an earlier one says.

use super::decode;
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
/// says that it is by those found. The picture that comes back may be black where nothing was read.
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
    let tiles = |width, height| detect::tiles_read(predictions, width, height);
    let part = sighting.look(
        || decode::decode_part(bytes, format, &tiles),
        |raster| detect::detect_guided(raster, predictions),
    );
    if part.is_none() {
        return (None, Search::Guided);
    }
    if detect::is_complete(&sighting.detections, predictions) {
        return (part, Search::Guided);
    }
    let better = onwards(&sighting.detections.markers);
    look_again(sighting, bytes, format, (part, predictions, better))
}

/// With better predictions, in what was decoded if they lie there; and where that does not do, in the whole frame.
fn look_again(
    sighting: &mut Sighting,
    bytes: &[u8],
    format: Option<&Format>,
    (part, predictions, better): (Option<Raster>, &[Prediction], Option<Vec<Prediction>>),
) -> (Option<Raster>, Search) {
    let lies_there = |raster: &Raster, better: &[Prediction]| {
        let [read, needed] =
            [predictions, better].map(|p| detect::tiles_read(p, raster.width(), raster.height()));
        read.hold(&needed)
    };
    let Some(better) = better.filter(|better| !better.is_empty()) else {
        return whole(sighting, bytes, format);
    };
    let again = |raster: &Raster, sighting: &mut Sighting| {
        let found = sighting.timed(Work::Detect, || detect::detect_guided(raster, &better));
        let complete = detect::is_complete(&found, &better);
        if complete {
            sighting.detections = found;
        }
        complete
    };
    if let Some(raster) = part.filter(|raster| lies_there(raster, &better)) {
        if again(&raster, sighting) {
            return (Some(raster), Search::Guided);
        }
        return whole(sighting, bytes, format);
    }
    let raster = match sighting.timed(Work::Decode, || decode::decode(bytes, format)) {
        Ok(raster) => raster,
        Err(error) => return (sighting.look(|| Err(error), detect::detect), Search::Whole),
    };
    if again(&raster, sighting) {
        return (Some(raster), Search::Guided);
    }
    sighting.detections = sighting.timed(Work::Detect, || detect::detect(&raster));
    (Some(raster), Search::Whole)
}

/// The whole frame is searched.
fn whole(sighting: &mut Sighting, bytes: &[u8], format: Option<&Format>) -> (Option<Raster>, Search) {
    (sighting.look(|| decode::decode(bytes, format), detect::detect), Search::Whole)
}
