//! Manual marks in the frames of a flight.

use std::path::Path;

use super::catalogue::{self, FlightRef};
use crate::disk::{Disk, StoreResult};
use crate::format::append_file_kinds::MANUAL_MARKS;
use crate::format::manual_marks::ManualMarksHead;
pub use crate::format::manual_marks::{
    ManualMark, MarkAction, MarkPosition, MarkSource, effective_marks,
};
use crate::format::sha256_hex;

/// Reads all manual marks of a flight in the order in which they were made, including the file being written; returns them
/// with notes on unreadable files.
pub fn read_marks(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> StoreResult<(Vec<ManualMark>, Vec<String>)> {
    let flight_of: fn(&ManualMarksHead) -> &str = |head| &head.flight;
    let (all, notes) = catalogue::read_headed_files(disk, root, flight, &MANUAL_MARKS, flight_of)?;
    Ok((
        all.into_iter().flat_map(|(_, marks)| marks).collect(),
        notes,
    ))
}

/// Computes the digest of the valid marks, an input of results that use them; `None` if there are none.
pub fn marks_digest(marks: &[ManualMark]) -> Option<String> {
    let lines: Vec<String> = effective_marks(marks)
        .iter()
        .filter_map(|mark| serde_json::to_string(mark).ok())
        .collect();
    (!lines.is_empty()).then(|| sha256_hex(lines.join("\n").as_bytes()))
}
