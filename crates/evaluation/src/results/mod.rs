//! Figures, tables and exports of results, for people and for other programs.
//!
//! | file | input | output |
//! |---|---|---|
//! | `summary` | the records of a series | means, standard deviations, scatter |
//! | `table` | records, detections, summaries | text for a terminal |
//! | `aircraft` | a store | the aircraft data of each shot |
//! | `source` | a store | the data of a report |
//! | `kinds` | messages of many frames | one line for each kind of message |
//! | `frame_ranking` | records | the frames to check first |
//! | `overview` | a store | one line per series of a flight, without reading full records |

pub mod aircraft;
pub mod frame_ranking;
pub mod kinds;
pub mod overview;
pub mod source;
pub mod summary;
pub mod table;

#[cfg(any(test, feature = "sample"))]
pub mod sample;

use crate::aircraft::{AircraftState, UnusedLines};
use crate::frame_format::Format;
use crate::record::{CurveRecord, ImageRecord};
use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;
use wingd_measure::geometry::WingFrame;
use wingd_measure::setup::{Setup, SurveyMarker};

/// Series as the report needs it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeriesData {
    pub flight: String,
    /// Name, unique in the store.
    pub name: String,
    /// Start time, if known.
    pub begun: Option<Stamp>,
    /// Ended early by a crash or a power failure.
    pub interrupted: bool,
    /// Number of planned shots.
    pub planned: usize,
    /// Results in the order of the shots.
    pub records: Vec<ImageRecord>,
    /// Mean curve of the records; empty if it has not been computed.
    pub curve: Vec<CurveRecord>,
    /// Marker counts of each record; empty if the records contain their markers.
    pub counts: Vec<MarkerCount>,
    /// Key of the inputs of the records.
    pub inputs: Option<String>,
    /// Requested shots, failed ones included.
    pub shots: Vec<ShotData>,
    /// Remarks for the reader.
    pub remarks: Vec<String>,
}

impl SeriesData {
    /// Returns the result of a shot's frame.
    pub fn record_for_shot(&self, shot: &ShotData) -> Option<&ImageRecord> {
        self.records
            .iter()
            .find(|r| Some(&r.image) == shot.image.as_ref())
    }

    /// Returns the shot of a result.
    pub fn shot_for_record(&self, record: &ImageRecord) -> Option<&ShotData> {
        self.shots
            .iter()
            .find(|s| s.image.as_ref() == Some(&record.image))
    }
}

/// Number of markers of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MarkerCount {
    /// Markers used in the adjustment.
    pub used: usize,
    /// Markers of the survey.
    pub surveyed: usize,
}

impl MarkerCount {
    /// Counts the markers of a full record.
    pub fn from_record(record: &ImageRecord) -> Self {
        Self {
            used: record.used_count(),
            surveyed: record.markers.len(),
        }
    }
}

/// Shot, as in the manifest of the series.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShotData {
    /// Number from 1.
    pub number: u32,
    /// File name of the frame; `None` if the camera delivered none.
    pub image: Option<String>,
    /// Original file name, if the frame was imported from a file.
    pub source: Option<String>,
    /// Time of the camera request.
    pub stamp: Option<Stamp>,
    /// Time of the exposure.
    pub exposure: Option<Exposure>,
    /// Aircraft data at the exposure.
    pub aircraft: AircraftState,
    /// SHA-256 of the frame, hexadecimal.
    pub sha256: Option<String>,
    /// Pixel format of the frame.
    pub format: Option<Format>,
    /// Failed attempts, before the frame or instead of it.
    pub failures: Vec<String>,
}

/// Returns the distinct values in the order of their first appearance.
pub fn distinct_values<T: PartialEq>(all: impl Iterator<Item = T>) -> Vec<T> {
    let mut known = Vec::new();
    for one in all {
        if !known.contains(&one) {
            known.push(one);
        }
    }
    known
}

/// Marker as surveyed on ground.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundMarker {
    /// Marker id of the survey.
    pub id: String,
    /// Position in the survey frame, m.
    pub position_m: [f64; 3],
}

/// Installation data of a report: ground shape and camera position.
#[derive(Clone, Debug, PartialEq)]
pub struct ReportSite {
    /// Name given by the user.
    pub name: String,
    /// Wing frame, with its origin in the projection centre.
    pub wing: WingFrame,
    /// Surveyed markers.
    pub ground: Vec<GroundMarker>,
}

impl From<&Setup> for ReportSite {
    fn from(setup: &Setup) -> Self {
        let marker = |m: &SurveyMarker| GroundMarker {
            id: m.id.clone(),
            position_m: m.position_m.into(),
        };
        Self {
            name: setup.name.clone(),
            wing: setup.wing_frame(),
            ground: setup.markers.iter().map(marker).collect(),
        }
    }
}

/// Image of a frame shown in the report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FramePicture {
    pub series: String,
    /// File name of the frame.
    pub image: String,
    /// File content as delivered by the camera.
    pub bytes: Vec<u8>,
    /// Pixel format, if known.
    pub format: Option<Format>,
    /// Reason for missing `bytes`.
    pub fault: Option<String>,
}

/// Record of a frame with all its data.
#[derive(Clone, Debug, PartialEq)]
pub struct FullRecord {
    pub series: String,
    /// Record with markers and curve.
    pub record: ImageRecord,
}

/// Data of a report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReportData {
    /// Series in order of time.
    pub series: Vec<SeriesData>,
    /// Installation, if available.
    pub site: Option<ReportSite>,
    /// Images shown: of the frames below, in their order.
    pub pictures: Vec<FramePicture>,
    /// Full records, in the order of [`frame_ranking`].
    pub frames: Vec<FullRecord>,
    /// Unused lines of the aircraft data, and the number of samples; `None` without aircraft data.
    pub feed: Option<(UnusedLines, usize)>,
    /// Ids of the store's other flights.
    pub other_flights: Vec<String>,
    /// Names and texts that the user adds to the head, such as aircraft and author.
    pub fields: Vec<(String, String)>,
    /// Unreadable files and refused series.
    pub notes: Vec<String>,
    /// Warnings about the results shown, such as results from other inputs.
    pub warnings: Vec<String>,
}

/// Builds the page of a report, without external resources. Commands of the recorder get it as a value, so that the on-board
/// build needs none.
pub type ReportBuilder = fn(&ReportData) -> String;
