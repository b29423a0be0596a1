//! Recorded aircraft data of a flight.

use std::path::Path;

use super::catalogue::{self, FlightRef};
use crate::disk::{Disk, StoreResult};
pub use crate::format::aircraft::{AircraftHead, AircraftLine};
use crate::format::append_file_kinds::AIRCRAFT_DATA;
use crate::format::sha256_hex;

/// Lists the closed files with aircraft data of a flight, in order.
pub fn closed_files(disk: &dyn Disk, flight: &FlightRef) -> StoreResult<Vec<String>> {
    catalogue::closed_files(disk, flight, &AIRCRAFT_DATA)
}

/// Head and lines of every file.
pub type AircraftRecording = Vec<(AircraftHead, Vec<AircraftLine>)>;

/// Reads all aircraft data of a flight, including the file being written; returns it with notes on unreadable files.
pub fn read_aircraft(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> StoreResult<(AircraftRecording, Vec<String>)> {
    let flight_of: fn(&AircraftHead) -> &str = |head| &head.flight;
    catalogue::read_headed_files(disk, root, flight, &AIRCRAFT_DATA, flight_of)
}

/// Computes the digest of a flight's current aircraft data, an input of results that use it; `None` if there is none.
pub fn aircraft_digest(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> StoreResult<Option<String>> {
    let (all, _) = read_aircraft(disk, root, flight)?;
    let mut text = String::new();
    for (head, lines) in &all {
        text.push_str(&serde_json::to_string(head).unwrap_or_default());
        lines
            .iter()
            .for_each(|line| text.push_str(&serde_json::to_string(line).unwrap_or_default()));
    }
    Ok((!all.is_empty()).then(|| sha256_hex(text.as_bytes())))
}
