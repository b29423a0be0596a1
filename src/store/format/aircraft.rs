//! Lines of the aircraft's data as they came. The first line of a file says whose they are, each further one is a line
//! of the feed.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::jsonl;
use crate::clock::Stamp;

/// The first line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// The flight that the lines belong to.
    pub flight: String,
    /// Where they come from and how they are to be read, in the feed's words.
    pub source: Value,
}

/// A line of the feed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AircraftLine {
    /// When it came; `null` for lines of a file that came after the flight.
    pub at: Option<Stamp>,
    /// As it came, without its end; bytes that are no text are replaced.
    pub line: String,
}

/// Head and whole lines; `None` where the first line is damaged.
pub(crate) fn parse(bytes: &[u8]) -> Option<(Head, Vec<AircraftLine>)> {
    let first = bytes.split_inclusive(|byte| *byte == b'\n').next()?;
    let head = serde_json::from_slice(first).ok()?;
    let lines = jsonl::parse::<AircraftLine>(bytes.get(first.len()..)?).good;
    Some((head, lines.into_iter().map(|(_, line)| line).collect()))
}

/// How many bytes are whole lines, and the flight that they belong to; `None` where not even the first line is.
pub(crate) fn whole(bytes: &[u8]) -> Option<(usize, String)> {
    let good = jsonl::parse::<Value>(bytes).good_length;
    let (head, _) = parse(bytes.get(..good)?)?;
    Some((good, head.flight))
}
