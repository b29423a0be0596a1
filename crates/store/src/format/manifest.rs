//! Content of the store's JSON files.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::layout;
use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;

/// State of a closed series.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SeriesState {
    /// Every planned shot was tried.
    Complete,
    /// Stopped, crashed or out of space before that.
    Interrupted,
}

/// Reason for recording a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SeriesCause {
    /// Schedule of the recorder.
    Scheduled,
    /// Command `wingd trigger`.
    Triggered,
    /// Frames that an interrupted series left on the camera's card.
    Recovered,
    /// Every n-th frame of live mode, recorded concurrently with other series.
    Live,
    /// Frames around an event in live mode, described in the remarks; they may be older than the series. Also concurrent.
    Event,
    /// Images taken without the recorder, added by `wingd import`.
    Imported,
}

impl SeriesCause {
    /// Returns whether such a series is recorded concurrently with others.
    pub fn is_concurrent(self) -> bool {
        matches!(self, Self::Live | Self::Event)
    }
}

/// Manifest of a series: `series.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeriesManifest {
    /// Format of the manifest.
    pub format: u32,
    /// Name of the series' folder.
    pub series: String,
    /// Name of the flight's folder.
    pub flight: String,
    pub state: SeriesState,
    pub cause: SeriesCause,
    /// Time of the beginning; `null` if the head of the journal was lost.
    pub started: Option<Stamp>,
    /// Time of closing; `null` after a crash.
    pub ended: Option<Stamp>,
    /// Number of requested shots; of an open-ended series the shots taken.
    pub planned_shots: u32,
    /// Camera and settings at the beginning.
    pub camera: Map<String, Value>,
    /// Shots in order.
    pub shots: Vec<Shot>,
    /// Notes for a person: reason of an interruption, findings of the recovery.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
}

impl SeriesManifest {
    /// Returns the beginning of the series; `None` if it is not known, as for imported images without a time, whose stamps
    /// only define the order.
    pub fn start_time(&self) -> Option<Stamp> {
        let first = self.shots.first();
        let dated = self.cause != SeriesCause::Imported
            || first.is_some_and(|shot| shot.exposure.is_some());
        self.started
            .clone()
            .or_else(|| first.map(|shot| shot.stamp.clone()))
            .filter(|_| dated)
    }

    /// Creates the manifest of a series that has begun and has no shot yet.
    pub fn from_journal_head(id: &str, head: JournalHead) -> Self {
        Self {
            format: layout::SERIES_FORMAT,
            series: id.to_owned(),
            flight: head.flight,
            state: SeriesState::Interrupted,
            cause: head.cause,
            started: Some(head.started),
            ended: None,
            planned_shots: head.planned_shots,
            camera: Map::new(),
            shots: Vec::new(),
            remarks: Vec::new(),
        }
    }

    /// Returns the frames of the shots.
    pub fn frames(&self) -> impl Iterator<Item = &FrameEntry> {
        self.shots.iter().filter_map(|shot| shot.frame.as_ref())
    }
}

/// Shot with its frame, or with the reasons for a missing frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shot {
    /// Number from 1.
    pub shot: u32,
    /// Time of the request to the camera.
    pub stamp: Stamp,
    /// Time from request to delivery, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
    /// Time of the exposure (docs/time.md).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<Exposure>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<FrameEntry>,
    /// Failed attempts, before or instead of the frame.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failures: Vec<ShotFailure>,
}

/// Stored frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameEntry {
    /// File name in the series' folder.
    pub file: String,
    /// SHA-256 of the file, hex.
    pub sha256: String,
    /// Length, bytes.
    pub bytes: u64,
    /// Pixel or file format, as reported by the camera.
    pub format: Value,
    /// Camera settings of the shot.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub settings: Map<String, Value>,
}

/// Attempt without a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShotFailure {
    /// Kind: `busy`, `gone`, `timeout`, `refused`, `bad_frame`, `stale`, `store`.
    pub kind: String,
    /// Reason, one sentence.
    pub reason: String,
    /// File below `partial/` that holds the bytes of a bad frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept_as: Option<String>,
}

/// First line of a journal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JournalHead {
    /// Flight of the series.
    pub flight: String,
    /// Time of the beginning.
    pub started: Stamp,
    pub cause: SeriesCause,
    /// Number of requested shots.
    pub planned_shots: u32,
}

/// Line of a journal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JournalLine {
    /// First line.
    Head(JournalHead),
    /// Description of the opened camera.
    Camera(Map<String, Value>),
    /// Note for a person.
    Remark(String),
    /// Written **before** the frame's bytes; the frame is complete if it has this hash.
    Shot(Box<Shot>),
}

/// Manifest of a flight: `flight.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlightManifest {
    /// Name of the flight's folder.
    pub flight: String,
    /// Beginning of the first series.
    pub started: Stamp,
    /// Reason for beginning a new flight.
    pub because: String,
    /// User's name for an imported flight.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
}

/// Next ids: `counter.json`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counter {
    /// Number of the next flight.
    pub next_flight: u64,
    /// Number of the next series.
    pub next_series: u64,
}

impl Counter {
    /// Counter of an empty store.
    pub const FIRST: Self = Self {
        next_flight: 1,
        next_series: 1,
    };

    /// Returns whether the counter leaves room for further ids: a damaged counter must not end the recording.
    pub fn is_plausible(&self) -> bool {
        self.next_flight.max(self.next_series) <= layout::MAX_NUMBER
    }

    /// Advances the next ids past a flight or series, given by its name.
    pub fn advance_past(&mut self, id: &str) {
        let above =
            |next: u64, number: Option<u64>| number.map_or(next, |n| next.max(n.saturating_add(1)));
        self.next_flight = above(self.next_flight, layout::flight_number(id));
        self.next_series = above(self.next_series, layout::series_number(id));
    }

    /// Returns the larger next flight id and the larger next series id.
    pub fn merge(self, other: Self) -> Self {
        Self {
            next_flight: self.next_flight.max(other.next_flight),
            next_series: self.next_series.max(other.next_series),
        }
    }
}

/// Frame being solved, `solving.json`: prevents endless attempts at a frame that crashes the program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SolvingAttempt {
    /// Key of the frame's result.
    pub inputs: String,
    /// Number of attempts so far.
    pub attempts: u32,
}

/// Line of `refused.jsonl`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefusedSeries {
    pub stamp: Stamp,
    pub reason: String,
}

/// Line of `pruned.jsonl`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PrunedFlight {
    /// Manifest of the deleted flight.
    pub flight: FlightManifest,
    /// SHA-256 of the flight's `SHA256SUMS`, which lists every file.
    pub sums_sha256: String,
    /// Verified copy of the flight.
    pub copy: PathBuf,
    /// Bytes removed.
    pub bytes: u64,
}

/// Line of `results.jsonl`: written once, never changed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResultLine {
    /// File name of the frame in the series' folder.
    pub frame: String,
    /// SHA-256 of the frame, hex.
    pub frame_sha256: String,
    /// SHA-256 over the frame's digest and `provenance`, hex: one result for each.
    pub inputs: String,
    /// Inputs of the computation: digests of the installation, program version, parameters.
    pub provenance: Map<String, Value>,
    pub record: Value,
}
