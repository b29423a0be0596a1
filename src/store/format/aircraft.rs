//! Recorded aircraft data: `aircraft-NNNNNN.jsonl`. The first line names flight and source, every further line holds one
//! line of the feed.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::jsonl;
use crate::clock::Stamp;

/// First line of an aircraft data file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AircraftHead {
    /// Flight of the lines.
    pub flight: String,
    /// Origin and format of the lines, as configured for the feed.
    pub source: Value,
}

/// Line of the feed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AircraftLine {
    /// Time of reception; `null` for lines of a file that was imported after the flight.
    pub at: Option<Stamp>,
    /// Text as received, without line ending; bytes that are not UTF-8 are replaced.
    pub line: String,
}

/// Returns the head and the complete lines; `None` if the first line is damaged.
pub(crate) fn parse_aircraft(bytes: &[u8]) -> Option<(AircraftHead, Vec<AircraftLine>)> {
    let first = bytes.split_inclusive(|byte| *byte == b'\n').next()?;
    let head = serde_json::from_slice(first).ok()?;
    let lines = jsonl::parse_lines::<AircraftLine>(bytes.get(first.len()..)?).good;
    Some((head, lines.into_iter().map(|(_, line)| line).collect()))
}

/// Returns the length of the complete lines, bytes, and their flight; `None` if the first line is not complete.
pub(crate) fn intact_prefix(bytes: &[u8]) -> Option<(usize, String)> {
    let good = jsonl::parse_lines::<Value>(bytes).good_length;
    let (head, _) = parse_aircraft(bytes.get(..good)?)?;
    Some((good, head.flight))
}
