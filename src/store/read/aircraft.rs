//! Lines of the aircraft's data of a flight.

use std::path::Path;

use super::catalogue::{self, FlightRef};
use crate::store::disk::{Disk, StoreError};
use crate::store::format::aircraft::parse_aircraft;
pub use crate::store::format::aircraft::{AircraftLine, AircraftHead};
use crate::store::format::append_file_kinds::AIRCRAFT_DATA;
use crate::store::format::sha256_hex;

/// The closed files of a flight, in order.
pub fn closed_files(disk: &dyn Disk, flight: &FlightRef) -> Result<Vec<String>, StoreError> {
    catalogue::closed_files(disk, flight, &AIRCRAFT_DATA)
}

/// Each file's first line and its others.
pub type AircraftRecording = Vec<(AircraftHead, Vec<AircraftLine>)>;

/// Heads and lines of a flight, the file being written among them; and what could not be read.
pub fn read_aircraft(disk: &dyn Disk, root: &Path, flight: &FlightRef) -> Result<(AircraftRecording, Vec<String>), StoreError> {
    let (mut all, mut notes) = (Vec::new(), Vec::new());
    catalogue::for_each_file(disk, root, flight, &AIRCRAFT_DATA, |path, bytes| {
        match parse_aircraft(bytes) {
            Some((head, lines)) if head.flight == flight.id => all.push((head, lines)),
            Some(_) => {}
            None => notes.push(format!("{}: its first line is damaged; run `wingd verify`", path.display())),
        }
        Ok::<_, StoreError>(())
    })?;
    Ok((all, notes))
}

/// Digest over the aircraft's data of a flight as it is now: what results with them follow from. `None` without any.
pub fn aircraft_digest(disk: &dyn Disk, root: &Path, flight: &FlightRef) -> Result<Option<String>, StoreError> {
    let (all, _) = read_aircraft(disk, root, flight)?;
    let mut text = String::new();
    for (head, lines) in &all {
        text.push_str(&serde_json::to_string(head).unwrap_or_default());
        lines.iter().for_each(|line| text.push_str(&serde_json::to_string(line).unwrap_or_default()));
    }
    Ok((!all.is_empty()).then(|| sha256_hex(text.as_bytes())))
}
