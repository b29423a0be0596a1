//! Manual marks in the frames of a flight.

use std::path::Path;

use super::catalogue::{self, FlightRef};
use crate::disk::{Disk, StoreError, StoreResult};
use crate::format::append_file_kinds::MANUAL_MARKS;
use crate::format::manual_marks::ManualMarksHead;
pub use crate::format::manual_marks::{
    ManualMark, MarkAction, MarkPosition, MarkSource, effective_marks,
};
use crate::format::{jsonl, sha256_hex};

/// Reads all manual marks of a flight in the order in which they were made, including the file being written; returns them
/// with notes on unreadable files.
pub fn read_marks(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> StoreResult<(Vec<ManualMark>, Vec<String>)> {
    let (mut all, mut notes) = (Vec::new(), Vec::new());
    catalogue::for_each_file(disk, root, flight, &MANUAL_MARKS, |path, bytes| {
        match jsonl::parse_headed::<ManualMarksHead, ManualMark>(bytes) {
            Some((head, marks)) if head.flight == flight.id => all.extend(marks),
            Some(_) => {}
            None => notes.push(format!(
                "{}: its first line is damaged; run `wingd verify`",
                path.display()
            )),
        }
        Ok::<_, StoreError>(())
    })?;
    Ok((all, notes))
}

/// Computes the digest of the valid marks, an input of results that use them; `None` if there are none.
pub fn marks_digest(marks: &[ManualMark]) -> Option<String> {
    let lines: Vec<String> = effective_marks(marks)
        .iter()
        .filter_map(|mark| serde_json::to_string(mark).ok())
        .collect();
    (!lines.is_empty()).then(|| sha256_hex(lines.join("\n").as_bytes()))
}
