//! Live results of a flight: many per second, in files whose blocks hold columns ([`columns`](crate::store::columns)).

use std::path::Path;

use super::catalogue::{self, FlightRef};
use crate::clock::Stamp;
use crate::store::disk::{Disk, StoreError};
use crate::store::format::append_file_kinds::LIVE_RESULTS;
use crate::store::format::columns::{FLAG, LiveFile, LiveHead, LiveRow, UTC, ValueKind, WORD};

/// Names of columns, and of lists in the source, that other commands look up if a table has them.
pub mod names {
    /// Middle of the exposure; unit [`UTC`](crate::store::columns::UTC).
    pub const UTC: &str = "utc";
    /// Middle of the exposure since boot, s.
    pub const SINCE_BOOT: &str = "since_boot";
    /// Number of the result, from 1 at each start of live mode.
    pub const NUMBER: &str = "number";
    /// Coefficients of the bending line's curvature, 1/m.
    pub const CURVATURE: &str = "curvature";
    /// Covariance of the curvature coefficients, 1/m²: k (k + 1) / 2 values, the upper triangle row by row.
    pub const CURVATURE_COVARIANCE: &str = "curvature_covariance";
    /// Provenance in the source, as in `results.jsonl`.
    pub const PROVENANCE: &str = "provenance";
    /// Word lists in the source, for each column of unit [`WORD`](crate::store::columns::WORD).
    pub const WORDS: &str = "words";
    /// Flag: the frame was solved.
    pub const SOLVED: &str = "solved";
    /// Reason for a frame without solution: a word.
    pub const REASON: &str = "reason";
    /// Source of the exposure time: a word.
    pub const EXPOSURE_SOURCE: &str = "exposure_source";
    /// Standard deviation of the exposure time on this machine's clock, s.
    pub const EXPOSURE_SIGMA: &str = "exposure_sigma";
    /// Standard deviation of the machine's clock, s.
    pub const CLOCK_SIGMA: &str = "clock_sigma";
    /// Flag: a service disciplined the clock.
    pub const UTC_SYNCHRONISED: &str = "utc_synchronised";
    /// Flag: the global test passed.
    pub const GLOBAL_TEST_PASSED: &str = "global_test_passed";
    /// Kind of the standard deviations, a priori or a posteriori: a word.
    pub const SIGMA_KIND: &str = "sigma_kind";
    /// Reference of the reported tip deflection: a word.
    pub const TIP_REFERENCE: &str = "tip_reference";
}

/// Column with one value per row: name, unit and kind.
pub type ScalarColumn = (&'static str, &'static str, ValueKind);

/// Columns with one value per row of live mode, in order.
pub const SCALAR_COLUMNS: [ScalarColumn; 25] = [
    (names::UTC, UTC, ValueKind::U64),
    (names::SINCE_BOOT, "s", ValueKind::F64),
    (names::EXPOSURE_SIGMA, "s", ValueKind::F32),
    (names::CLOCK_SIGMA, "s", ValueKind::F32),
    (names::NUMBER, "", ValueKind::U64),
    ("skipped", "", ValueKind::U64),
    (names::SOLVED, "", ValueKind::U8),
    ("full_search", "", ValueKind::U8),
    ("mounting", "", ValueKind::U32),
    ("mount_disturbed", "", ValueKind::U8),
    ("latency", "ms", ValueKind::F32),
    ("variance_factor", "", ValueKind::F32),
    (names::GLOBAL_TEST_PASSED, "", ValueKind::U8),
    ("tip_deflection", "m", ValueKind::F32),
    ("sigma_tip_deflection", "m", ValueKind::F32),
    ("tip_deflection_ground", "m", ValueKind::F32),
    ("sigma_tip_deflection_ground", "m", ValueKind::F32),
    ("tip_deflection_root", "m", ValueKind::F32),
    ("sigma_tip_deflection_root", "m", ValueKind::F32),
    ("redundancy", "", ValueKind::U32),
    (names::UTC_SYNCHRONISED, FLAG, ValueKind::U8),
    (names::EXPOSURE_SOURCE, WORD, ValueKind::U8),
    (names::REASON, WORD, ValueKind::U8),
    (names::SIGMA_KIND, WORD, ValueKind::U8),
    (names::TIP_REFERENCE, WORD, ValueKind::U8),
];

/// Lists the closed files with live results of a flight, in order.
pub fn closed_files(disk: &dyn Disk, flight: &FlightRef) -> Result<Vec<String>, StoreError> {
    catalogue::closed_files(disk, flight, &LIVE_RESULTS)
}

/// First line and rows of every file.
pub type LiveRecording = Vec<(LiveHead, Vec<LiveRow>)>;

/// Reads all live results of a flight, including the file being written; returns them with notes on unreadable data.
pub fn read_live(disk: &dyn Disk, root: &Path, flight: &FlightRef) -> Result<(LiveRecording, Vec<String>), StoreError> {
    let mut all = LiveRecording::new();
    let notes = for_each_live_file(disk, root, flight, |mut file| {
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
            notes.push(format!("{place}: its first line is damaged; run `wingd verify`"));
            return Ok(());
        };
        let rest = if file.head.flight == flight.id { read(file)? } else { 0 };
        if rest > 0 {
            notes.push(format!("{place}: its last {rest} bytes are torn or damaged; run `wingd verify`"));
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
