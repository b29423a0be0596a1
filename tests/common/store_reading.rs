//! Readers of complete files of a store; the program reads them piece by piece.

use std::path::Path;

use wingd::store::columns::{LiveHead, LiveRow};
use wingd::store::manifest::ResultLine;
use wingd::store::{Disk, FlightRef, SeriesRef, StoreError, StoreResult, catalogue, layout, live};

/// First line and rows of every file.
pub type LiveRecording = Vec<(LiveHead, Vec<LiveRow>)>;

/// Reads all live results of a flight, including the file being written; returns them with notes on unreadable data.
pub fn read_live(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> StoreResult<(LiveRecording, Vec<String>)> {
    let mut all = LiveRecording::new();
    let notes = live::for_each_live_file(disk, root, flight, |mut file| {
        let mut rows = Vec::new();
        while let Some(block) = file.next_block() {
            rows.extend(block.rows().unwrap_or_default());
        }
        let rest = file.torn_length();
        all.push((file.head, rows));
        Result::<usize, StoreError>::Ok(rest)
    })?;
    Ok((all, notes))
}

/// Reads the intact lines of a series' `results.jsonl`, in the order written; empty if there is none.
pub fn read_results(disk: &dyn Disk, series: &SeriesRef) -> StoreResult<Vec<ResultLine>> {
    let mut results = Vec::new();
    let file = series.folder.join(layout::RESULTS_FILE);
    catalogue::for_each_line(disk, &file, |_, line| {
        results.extend(serde_json::from_slice::<ResultLine>(line).ok());
    })?;
    Ok(results)
}
