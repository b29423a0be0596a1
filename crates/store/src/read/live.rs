//! Live results of a flight: many per second, in files whose blocks hold columns ([`columns`](crate::columns)).

use std::path::Path;

use super::catalogue::{self, FlightRef};
use crate::disk::{Disk, StoreError, StoreResult};
use crate::format::append_file_kinds::LIVE_RESULTS;
use crate::format::columns::LiveFile;
use wingd_base::clock::Stamp;

/// Lists the closed files with live results of a flight, in order.
pub fn closed_files(disk: &dyn Disk, flight: &FlightRef) -> StoreResult<Vec<String>> {
    catalogue::closed_files(disk, flight, &LIVE_RESULTS)
}

/// Calls `read` with a flight's files in the order written, the one being written last. `read` returns the number of bytes
/// that were not intact; the returned notes report them.
pub fn for_each_live_file<E: From<StoreError>>(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
    mut read: impl FnMut(LiveFile<'_>) -> Result<usize, E>,
) -> Result<Vec<String>, E> {
    let mut notes = Vec::new();
    catalogue::for_each_file(disk, root, flight, &LIVE_RESULTS, |path, bytes| {
        let place = path.display();
        let Some(file) = LiveFile::parse(bytes) else {
            notes.push(format!(
                "{place}: its first line is damaged; run `wingd verify`"
            ));
            return Ok(());
        };
        let rest = if file.head.flight == flight.id {
            read(file)?
        } else {
            0
        };
        if rest > 0 {
            notes.push(format!(
                "{place}: its last {rest} bytes are torn or damaged; run `wingd verify`"
            ));
        }
        Ok::<_, E>(())
    })?;
    Ok(notes)
}

/// Returns the time at which the last closed file of a flight was begun.
pub(crate) fn last_file_start(disk: &dyn Disk, flight: &FlightRef) -> Option<Stamp> {
    let last = closed_files(disk, flight).ok()?.pop()?;
    let bytes = disk.read(&flight.folder.join(last)).ok()?;
    LiveFile::parse(&bytes).map(|file| file.head.began)
}
