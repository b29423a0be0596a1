//! The store's files as values.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::layout;
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;

/// How a series ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Every planned shot was tried.
    Complete,
    /// Stopped, crashed or out of space before that.
    Interrupted,
}

/// Why a series was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Cause {
    /// By the schedule.
    Scheduled,
    /// By `wingd trigger`.
    Triggered,
    /// Frames that an interrupted series left on the camera's card.
    Recovered,
    /// Frames of live mode, every n-th. Beside other series; so is the next.
    Live,
    /// The frames around an event in live mode; the remarks say which. They may be from before the series began.
    Event,
    /// Pictures of a camera that no recorder asked, taken in by `wingd import`.
    Imported,
}

impl Cause {
    /// Whether such a series is taken while another may be under way.
    pub fn is_beside(self) -> bool {
        matches!(self, Self::Live | Self::Event)
    }
}

/// `series.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeriesManifest {
    /// Of the store.
    pub format: u32,
    /// Its folder's name.
    pub series: String,
    /// Its flight's folder name.
    pub flight: String,
    /// How it ended.
    pub state: State,
    /// Why it was taken.
    pub cause: Cause,
    /// When it began; `null` where the journal's head was lost.
    pub started: Option<Stamp>,
    /// When it was closed; `null` after a crash.
    pub ended: Option<Stamp>,
    /// Shots that were wanted; where that was open, those that were taken.
    pub planned_shots: u32,
    /// The camera and its settings at the beginning.
    pub camera: Map<String, Value>,
    /// In order.
    pub shots: Vec<Shot>,
    /// What a person should read: why it was interrupted, what was found at recovery.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
}

impl SeriesManifest {
    /// When it began; `None` where nothing says so, as of imported pictures without a time: their stamps only order them.
    pub fn began(&self) -> Option<Stamp> {
        let first = self.shots.first();
        let dated = self.cause != Cause::Imported || first.is_some_and(|shot| shot.exposure.is_some());
        self.started.clone().or_else(|| first.map(|shot| shot.stamp.clone())).filter(|_| dated)
    }

    /// Of a series that was begun and has no shot yet.
    pub fn begun(id: &str, head: JournalHead) -> Self {
        Self {
            format: layout::SERIES_FORMAT,
            series: id.to_owned(),
            flight: head.flight,
            state: State::Interrupted,
            cause: head.cause,
            started: Some(head.started),
            ended: None,
            planned_shots: head.planned_shots,
            camera: Map::new(),
            shots: Vec::new(),
            remarks: Vec::new(),
        }
    }

    /// The frames that its shots name.
    pub fn frames(&self) -> impl Iterator<Item = &FrameEntry> {
        self.shots.iter().filter_map(|shot| shot.frame.as_ref())
    }
}

/// One shot: a frame, or the reasons why there is none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shot {
    /// From 1.
    pub shot: u32,
    /// When the camera was asked.
    pub stamp: Stamp,
    /// From asking to delivery, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
    /// When the frame was exposed (docs/time.md).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<Exposure>,
    /// The frame, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<FrameEntry>,
    /// Attempts that failed, before the frame or instead of it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failures: Vec<Failure>,
}

/// A stored frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameEntry {
    /// In the series' folder.
    pub file: String,
    /// Hex.
    pub sha256: String,
    /// Length.
    pub bytes: u64,
    /// How to read the bytes, in the camera's words.
    pub format: Value,
    /// What the camera says of the shot.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub settings: Map<String, Value>,
}

/// An attempt without a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// `busy`, `gone`, `timeout`, `refused`, `bad_frame`, `stale`, `store`.
    pub kind: String,
    /// One sentence.
    pub reason: String,
    /// File below `partial/` that keeps the bytes of a bad frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept_as: Option<String>,
}

/// First line of a journal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JournalHead {
    /// The flight that the series belongs to.
    pub flight: String,
    /// When it began.
    pub started: Stamp,
    /// Why.
    pub cause: Cause,
    /// Shots that are wanted.
    pub planned_shots: u32,
}

/// A line of a journal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JournalLine {
    /// The first.
    Head(JournalHead),
    /// The camera opened.
    Camera(Map<String, Value>),
    /// What a person should read.
    Remark(String),
    /// Written **before** the frame's bytes: a frame is whole when its hash says so.
    Shot(Box<Shot>),
}

/// `flight.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlightManifest {
    /// Its folder's name.
    pub flight: String,
    /// When its first series began.
    pub started: Stamp,
    /// Why it was taken for a new flight.
    pub because: String,
    /// What the user calls it, where it was imported under a name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
}

/// `counter.json`: the next ids.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counter {
    /// Of a flight.
    pub next_flight: u64,
    /// Of a series.
    pub next_series: u64,
}

impl Counter {
    /// Of an empty store.
    pub const FIRST: Self = Self { next_flight: 1, next_series: 1 };

    /// Puts the next ids above those of a flight or series, by its name.
    pub fn pass(&mut self, id: &str) {
        let above = |next: u64, number: Option<u64>| number.map_or(next, |n| next.max(n.saturating_add(1)));
        self.next_flight = above(self.next_flight, layout::flight_number(id));
        self.next_series = above(self.next_series, layout::series_number(id));
    }

    /// Above all that two counters know of.
    pub fn max(self, other: Self) -> Self {
        let (next_flight, next_series) =
            (self.next_flight.max(other.next_flight), self.next_series.max(other.next_series));
        Self { next_flight, next_series }
    }
}

/// `solving.json`: the frame under work, so that one that brings the program down is not tried for ever.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Solving {
    /// Key of its result.
    pub inputs: String,
    /// Beginnings so far.
    pub attempts: u32,
}

/// A line of `refused.jsonl`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refusal {
    /// When.
    pub stamp: Stamp,
    /// Why.
    pub reason: String,
}

/// A line of `pruned.jsonl`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pruned {
    /// The flight as it was.
    pub flight: FlightManifest,
    /// SHA-256 of its `SHA256SUMS`, which name every file.
    pub sums_sha256: String,
    /// The copy that was verified.
    pub copy: PathBuf,
    /// Removed with it.
    pub bytes: u64,
}

/// A line of `results.jsonl`: written once, never changed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResultLine {
    /// File in the series' folder.
    pub frame: String,
    /// The frame's hash, hex.
    pub frame_sha256: String,
    /// Hash over the frame's hash and `provenance`, hex: one result for each.
    pub inputs: String,
    /// What the result was computed from: digests of the installation, program version, parameters.
    pub provenance: Map<String, Value>,
    /// The result itself.
    pub record: Value,
}
