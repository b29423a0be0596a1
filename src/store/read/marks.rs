//! What people marked in the frames of a flight.

use std::path::Path;

use super::catalogue::{self, FlightRef};
use crate::store::disk::{Disk, StoreError};
use crate::store::format::kinds::MARKS;
use crate::store::format::marks::parse;
pub use crate::store::format::marks::{Mark, MarkAction, MarkSource, Place, standing};
use crate::store::format::sha256;

/// All marks of a flight in the order in which they were made, those of the file being written among them; and what could not
/// be read.
pub fn read(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> Result<(Vec<Mark>, Vec<String>), StoreError> {
    let (mut all, mut notes) = (Vec::new(), Vec::new());
    catalogue::each_file(disk, root, flight, &MARKS, |path, bytes| {
        match parse(bytes) {
            Some((head, marks)) if head.flight == flight.id => all.extend(marks),
            Some(_) => {}
            None => notes.push(format!("{}: its first line is damaged; run `wingd verify`", path.display())),
        }
        Ok::<_, StoreError>(())
    })?;
    Ok((all, notes))
}

/// Digest over the marks that count: what results with them follow from. `None` without any.
pub fn digest(marks: &[Mark]) -> Option<String> {
    let lines: Vec<String> =
        standing(marks).iter().filter_map(|mark| serde_json::to_string(mark).ok()).collect();
    (!lines.is_empty()).then(|| sha256(lines.join("\n").as_bytes()))
}
