//! Lines of the aircraft's data of a flight.

use std::path::Path;

use super::catalogue::{self, FlightRef};
use crate::store::disk::{Disk, StoreError};
use crate::store::format::aircraft::parse;
pub use crate::store::format::aircraft::{AircraftLine, Head};
use crate::store::format::kinds::AIRCRAFT;
use crate::store::format::sha256;

/// The closed files of a flight, in order.
pub fn files(disk: &dyn Disk, flight: &FlightRef) -> Result<Vec<String>, StoreError> {
    catalogue::files(disk, flight, &AIRCRAFT)
}

/// Each file's first line and its others.
pub type Recorded = Vec<(Head, Vec<AircraftLine>)>;

/// Heads and lines of a flight, the file being written among them; and what could not be read.
pub fn read(disk: &dyn Disk, root: &Path, flight: &FlightRef) -> Result<(Recorded, Vec<String>), StoreError> {
    let (mut all, mut notes) = (Vec::new(), Vec::new());
    catalogue::each_file(disk, root, flight, &AIRCRAFT, |path, bytes| {
        match parse(bytes) {
            Some((head, lines)) if head.flight == flight.id => all.push((head, lines)),
            Some(_) => {}
            None => notes.push(format!("{}: its first line is damaged; run `wingd verify`", path.display())),
        }
        Ok::<_, StoreError>(())
    })?;
    Ok((all, notes))
}

/// Digest over the aircraft's data of a flight as it is now: what results with them follow from. `None` without any.
pub fn digest(disk: &dyn Disk, root: &Path, flight: &FlightRef) -> Result<Option<String>, StoreError> {
    let (all, _) = read(disk, root, flight)?;
    let mut text = String::new();
    for (head, lines) in &all {
        text.push_str(&serde_json::to_string(head).unwrap_or_default());
        lines.iter().for_each(|line| text.push_str(&serde_json::to_string(line).unwrap_or_default()));
    }
    Ok((!all.is_empty()).then(|| sha256(text.as_bytes())))
}
