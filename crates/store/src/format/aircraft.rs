//! Recorded aircraft data: `aircraft-NNNNNN.jsonl`. The first line names flight and source, every further line holds one
//! line of the feed.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use wingd_base::clock::Stamp;

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
