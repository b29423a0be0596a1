//! Everything that people and other programs read of results is made here: figures, tables and exports.
//!
//! | file | from | to |
//! |---|---|---|
//! | `summary` | the records of a series | means, standard deviations, scatter |
//! | `table` | records, detections, summaries | text for a terminal |
//! | `aircraft` | a store | the aircraft's data of each shot |
//! | `source` | a store | what the report shows |
//! | `stress` | the bending lines of a flight, the stiffness | moments, extremes, cycles, damage |
//! | `doubt` | records | which frames are to be looked at first |
//! | `compare` | two sets of results | what changed |
//! | `overview` | a store | a flight's series in a line each, without reading whole records |
//! | `html` | that | one page that opens offline |
//! | `export` | that | CSV, Parquet, VTK |
//! | `protocol` | the record of an image | its adjustment as a text to read |
//! | `plan_figure` | a plan | resolution and predicted uncertainty along the span, SVG |
//! | `layout_figure` | a layout of markers | the wing from above to scale, and as the camera sees it, SVG |
//! | `overlay` | a frame and its detections | a picture to look at |

pub mod aircraft;
#[cfg(feature = "boards")]
pub mod calibration;
pub mod compare;
pub mod export;
pub mod frame_ranking;
pub mod grid;
pub mod html;
pub mod labels;
pub mod layout_figure;
pub mod number;
pub mod overlay;
pub mod overview;
pub mod plan_figure;
pub mod protocol;
pub mod source;
pub mod stress;
pub mod summary;
pub mod table;

#[cfg(test)]
mod sample;

use crate::aircraft::{State, Unused};
use crate::camera::Format;
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;
use crate::measure::geometry::WingFrame;
use crate::measure::setup::{Setup, SurveyMarker};
use crate::record::{CurveRecord, ImageRecord};

/// A series as the report needs it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeriesData {
    /// The flight it belongs to.
    pub flight: String,
    /// Unique in the store.
    pub name: String,
    /// When it began, where that is known.
    pub begun: Option<Stamp>,
    /// A crash or a power cut ended it early.
    pub interrupted: bool,
    /// Shots that were wanted.
    pub planned: usize,
    /// Results in the order of the shots.
    pub records: Vec<ImageRecord>,
    /// Mean over the records; empty where it is still to be computed from them.
    pub curve: Vec<CurveRecord>,
    /// Markers of each record; empty where the records have them.
    pub counts: Vec<MarkerCount>,
    /// Key of the inputs that the records were computed from.
    pub inputs: Option<String>,
    /// Every shot asked for, failed ones included.
    pub shots: Vec<ShotData>,
    /// What a person should read.
    pub remarks: Vec<String>,
}

impl SeriesData {
    /// The result of a shot's frame.
    pub fn record_of(&self, shot: &ShotData) -> Option<&ImageRecord> {
        self.records.iter().find(|r| Some(&r.image) == shot.image.as_ref())
    }

    /// The shot that a result is of.
    pub fn shot_of(&self, record: &ImageRecord) -> Option<&ShotData> {
        self.shots.iter().find(|s| s.image.as_ref() == Some(&record.image))
    }
}

/// Markers of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MarkerCount {
    /// That took part in the adjustment.
    pub used: usize,
    /// Of the survey.
    pub surveyed: usize,
}

impl MarkerCount {
    /// Of a record that has its markers.
    pub fn of(record: &ImageRecord) -> Self {
        Self { used: record.used(), surveyed: record.markers.len() }
    }
}

/// A shot as the series' manifest keeps it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShotData {
    /// From 1.
    pub number: u32,
    /// File name of the frame; `None` where the camera gave none.
    pub image: Option<String>,
    /// The name that it came under, where it came from a file.
    pub source: Option<String>,
    /// When the camera was asked.
    pub stamp: Option<Stamp>,
    /// When the frame was exposed.
    pub exposure: Option<Exposure>,
    /// What the aircraft's data say of it.
    pub aircraft: State,
    /// SHA-256 of the frame, hexadecimal.
    pub sha256: Option<String>,
    /// How to read the frame.
    pub format: Option<Format>,
    /// Attempts that failed, before the frame or instead of it.
    pub failures: Vec<String>,
}

/// Each once, in the order of their first appearance.
pub fn distinct<T: PartialEq>(all: impl Iterator<Item = T>) -> Vec<T> {
    let mut known = Vec::new();
    for one in all {
        if !known.contains(&one) {
            known.push(one);
        }
    }
    known
}

/// A marker as surveyed on ground.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundMarker {
    /// Survey id.
    pub id: String,
    /// Survey frame, m.
    pub position_m: [f64; 3],
}

/// What an installation adds to the results: the ground shape and the camera's place.
#[derive(Clone, Debug, PartialEq)]
pub struct Site {
    /// The user's name of it.
    pub name: String,
    /// Origin in the projection centre.
    pub wing: WingFrame,
    /// The survey.
    pub ground: Vec<GroundMarker>,
}

impl From<&Setup> for Site {
    fn from(setup: &Setup) -> Self {
        let marker = |m: &SurveyMarker| GroundMarker { id: m.id.clone(), position_m: m.position_m.into() };
        Self {
            name: setup.name.clone(),
            wing: setup.wing_frame(),
            ground: setup.markers.iter().map(marker).collect(),
        }
    }
}

/// A stored frame to be shown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// Its series.
    pub series: String,
    /// Its file name.
    pub image: String,
    /// As delivered.
    pub bytes: Vec<u8>,
    /// How to read them, where that is known.
    pub format: Option<Format>,
    /// Why there are no bytes.
    pub fault: Option<String>,
}

/// A frame's record as it was written.
#[derive(Clone, Debug, PartialEq)]
pub struct Whole {
    /// Its series.
    pub series: String,
    /// With markers and curve.
    pub record: ImageRecord,
}

/// All that a report shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReportData {
    /// In order of time.
    pub series: Vec<SeriesData>,
    /// The installation, where it is at hand.
    pub site: Option<Site>,
    /// Frames to be shown: of the records below, in their order.
    pub pictures: Vec<Picture>,
    /// Whole records, those to be looked at first before all.
    pub frames: Vec<Whole>,
    /// Lines of the aircraft's data that say nothing, and those that do; `None` without any.
    pub feed: Option<(Unused, usize)>,
    /// What could not be read, and series that were refused.
    pub notes: Vec<String>,
    /// What is to be known of what is shown: results of other inputs.
    pub warnings: Vec<String>,
}
