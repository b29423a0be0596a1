//! Kinds of append-only files of a flight: aircraft data, live results, manual marks.

use super::aircraft::AircraftHead;
use super::chain::{ChainEvent, ClosedFile};
use super::manual_marks::ManualMarksHead;
use super::{columns, jsonl, layout};

/// Kind of an append-only file.
#[derive(Debug)]
pub(crate) struct AppendFileKind {
    /// Name in the root while it is being written.
    pub open_name: &'static str,
    /// Noun for messages.
    pub label: &'static str,
    /// Beginning of file names below `partial/`.
    pub stem: &'static str,
    /// Returns the name of the closed file in a flight, by its number from 1.
    pub closed_name: fn(u64) -> String,
    /// Returns the number in the name of a closed file.
    pub closed_number: fn(&str) -> Option<u64>,
    /// Returns the length of the intact content, bytes, and its flight; `None` if the first line is not complete.
    pub intact_prefix: fn(&[u8]) -> Option<(usize, String)>,
    /// Constructor of the chain event that closes the file.
    pub event: fn(ClosedFile) -> ChainEvent,
    /// Number of its invariant in docs/store.md.
    pub invariant: u8,
    /// Length beyond which a file is closed and another one begun, bytes.
    pub max_length: usize,
}

/// Recorded aircraft data.
pub(crate) const AIRCRAFT_DATA: AppendFileKind = AppendFileKind {
    open_name: layout::AIRCRAFT_FILE,
    label: "aircraft data",
    stem: "aircraft",
    closed_name: layout::aircraft_name,
    closed_number: layout::aircraft_number,
    intact_prefix: |bytes| jsonl::intact_prefix(bytes, |head: AircraftHead| head.flight),
    event: ChainEvent::Aircraft,
    invariant: 20,
    max_length: 1 << 20,
};

/// Results of live mode.
pub(crate) const LIVE_RESULTS: AppendFileKind = AppendFileKind {
    open_name: layout::LIVE_FILE,
    label: "live results",
    stem: "live",
    closed_name: layout::live_name,
    closed_number: layout::live_number,
    intact_prefix: columns::intact_prefix,
    event: ChainEvent::Live,
    invariant: 21,
    // Read completely into memory, by readers and at the start after a power cut.
    max_length: 8 << 20,
};

/// Manual marks.
pub(crate) const MANUAL_MARKS: AppendFileKind = AppendFileKind {
    open_name: layout::MARKS_FILE,
    label: "manual marks",
    stem: "marks",
    closed_name: layout::marks_name,
    closed_number: layout::marks_number,
    intact_prefix: |bytes| jsonl::intact_prefix(bytes, |head: ManualMarksHead| head.flight),
    event: ChainEvent::Marks,
    invariant: 22,
    max_length: 1 << 20,
};

/// Every kind of append-only file.
pub(crate) const APPEND_FILE_KINDS: [&AppendFileKind; 3] =
    [&AIRCRAFT_DATA, &LIVE_RESULTS, &MANUAL_MARKS];
