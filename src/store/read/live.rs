//! Live results: many a second, in files of a flight whose blocks hold columns ([`columns`](crate::store::columns)).

use std::path::Path;

use super::catalogue::{self, FlightRef};
use crate::clock::Stamp;
use crate::store::disk::{Disk, StoreError};
use crate::store::format::columns::{FLAG, LiveFile, LiveHead, ValueKind, LiveRow, UTC, WORD};
use crate::store::format::append_file_kinds::LIVE_RESULTS;

/// Columns that other commands look for, where a table has them.
pub mod names {
    /// Middle of the exposure; unit [`UTC`](crate::store::columns::UTC).
    pub const UTC: &str = "utc";
    /// Of the same, s.
    pub const SINCE_BOOT: &str = "since_boot";
    /// The result's number, from 1 at each start of live mode.
    pub const NUMBER: &str = "number";
    /// Coefficients of the bending line's curvature, 1/m, from the first on.
    pub const CURVATURE: &str = "curvature";
    /// Their covariance, 1/m^2: of k coefficients k (k + 1) / 2 values, the upper triangle row by row.
    pub const CURVATURE_COVARIANCE: &str = "curvature_covariance";
    /// In the source: what results follow from, as in `results.jsonl`.
    pub const PROVENANCE: &str = "provenance";
    /// In the source: what the numbers of each column of unit [`WORD`](crate::store::columns::WORD) mean, from 0 on.
    pub const WORDS: &str = "words";
    /// Whether the frame was solved.
    pub const SOLVED: &str = "solved";
    /// Why it was not: a word.
    pub const REASON: &str = "reason";
    /// What determines the instant: a word.
    pub const EXPOSURE_SOURCE: &str = "exposure_source";
    /// Of the instant against this machine's clock, s.
    pub const EXPOSURE_SIGMA: &str = "exposure_sigma";
    /// Of the machine's clock, s.
    pub const CLOCK_SIGMA: &str = "clock_sigma";
    /// Whether a service disciplined the clock.
    pub const UTC_SYNCHRONISED: &str = "utc_synchronised";
    /// Whether the global test accepts.
    pub const GLOBAL_TEST_PASSED: &str = "global_test_passed";
    /// Standard deviations are a priori or a posteriori: a word.
    pub const SIGMA_KIND: &str = "sigma_kind";
    /// Which of the tip's deflections is told best: a word.
    pub const TIP_REFERENCE: &str = "tip_reference";
}

/// Name, unit and kind of what a row has once.
pub type ScalarColumn = (&'static str, &'static str, ValueKind);

/// What a row of live mode has once, in order.
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

/// The closed files of a flight, in order.
pub fn closed_files(disk: &dyn Disk, flight: &FlightRef) -> Result<Vec<String>, StoreError> {
    catalogue::closed_files(disk, flight, &LIVE_RESULTS)
}

/// Each file's first line and its rows.
pub type LiveRecording = Vec<(LiveHead, Vec<LiveRow>)>;

/// All live results of a flight, those of the file being written among them; and what could not be read.
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

/// Gives a flight's files one after another, in the order written, the one being written last. What is done with a file
/// returns how many of its bytes were not whole; notes say so.
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

/// When the last file of a flight was begun.
pub(crate) fn last_file_start(disk: &dyn Disk, flight: &FlightRef) -> Option<Stamp> {
    let last = closed_files(disk, flight).ok()?.pop()?;
    let bytes = disk.read(&flight.folder.join(last)).ok()?;
    LiveFile::parse(&bytes).map(|file| file.head.began)
}
