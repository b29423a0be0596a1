//! Live results: many a second, in files of a flight ([`super::segment`]) whose blocks hold columns ([`super::columns`]).

use std::path::Path;

use super::chain::Event;
use super::columns::{self, FORMAT, File, Head, LiveTable, Row};
use super::disk::Disk;
use super::error::StoreError;
use super::segment::{self, Kind, Piece};
use super::{FlightRef, Store, layout};
use crate::clock::Stamp;

pub(crate) const KIND: Kind = Kind {
    open: layout::LIVE_FILE,
    what: "live results",
    stem: "live",
    name: layout::live_name,
    number: layout::live_number,
    whole: columns::whole,
    event: |file, bytes, sha256| Event::Live { file, bytes, sha256 },
    invariant: 21,
    // Read as a whole, at the start after a power cut and by readers.
    longest: 8 << 20,
};

/// Columns that other commands look for, where a table has them.
pub mod names {
    /// Middle of the exposure; unit [`UTC`](super::columns::UTC).
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
}

/// The closed files of a flight, in order.
pub fn files(disk: &dyn Disk, flight: &FlightRef) -> Result<Vec<String>, StoreError> {
    segment::files(disk, flight, &KIND)
}

/// Each file's first line and its rows.
pub type Recorded = Vec<(Head, Vec<Row>)>;

/// All live results of a flight, those of the file being written among them; and what could not be read.
pub fn read(disk: &dyn Disk, root: &Path, flight: &FlightRef) -> Result<(Recorded, Vec<String>), StoreError> {
    let mut all = Recorded::new();
    let notes = each_file(disk, root, flight, |mut file| {
        let mut rows = Vec::new();
        while let Some(block) = file.next_block() {
            rows.extend(block.rows().unwrap_or_default());
        }
        let rest = file.torn();
        all.push((file.head, rows));
        Result::<usize, StoreError>::Ok(rest)
    })?;
    Ok((all, notes))
}

/// Gives a flight's files one after another, in the order written, the one being written last. What is done with a file
/// returns how many of its bytes were not whole; notes say so.
pub fn each_file<E: From<StoreError>>(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
    mut read: impl FnMut(File<'_>) -> Result<usize, E>,
) -> Result<Vec<String>, E> {
    let mut notes = Vec::new();
    let mut give = |path: &Path, bytes: &[u8]| {
        let place = path.display();
        let Some(file) = File::parse(bytes) else {
            notes.push(format!("{place}: its first line is damaged; run `wingd verify`"));
            return Ok(());
        };
        let rest = if file.head.flight == flight.id { read(file)? } else { 0 };
        if rest > 0 {
            notes.push(format!("{place}: its last {rest} bytes are torn or damaged; run `wingd verify`"));
        }
        Result::<(), E>::Ok(())
    };
    // The open file first: a recorder that closes it meanwhile moves it to those that are listed after.
    let path = root.join(layout::LIVE_FILE);
    let mut open = match disk.read(&path) {
        Ok(bytes) => Some(bytes),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
        Err(error) => return Err(StoreError::io(&path, "read")(error).into()),
    };
    for closed in files(disk, flight)?.into_iter().map(|file| flight.folder.join(file)) {
        let bytes = disk.read(&closed).map_err(StoreError::io(&closed, "read"))?;
        open = open.filter(|open| !bytes.starts_with(open));
        give(&closed, &bytes)?;
    }
    if let Some(bytes) = open {
        give(&path, &bytes)?;
    }
    Ok(notes)
}

/// When the last file of a flight was begun.
pub(super) fn last_moment(disk: &dyn Disk, flight: &FlightRef) -> Option<Stamp> {
    let last = files(disk, flight).ok()?.pop()?;
    let bytes = disk.read(&flight.folder.join(last)).ok()?;
    File::parse(&bytes).map(|file| file.head.began)
}

impl Store {
    /// Records results of up to now durably, as one block; begins a flight where the rules have one begin, and files as
    /// they are needed. Below the reserve it refuses: frames and their results go first.
    ///
    /// An error that the rows do not fit the table is one of [`std::io::ErrorKind::InvalidInput`]. After any error none
    /// of the rows is recorded.
    pub fn append_live(&self, table: &LiveTable, rows: &[Row], now: &Stamp) -> Result<(), StoreError> {
        if rows.is_empty() {
            return Ok(());
        }
        self.refuse_below_reserve()?;
        let flight = self.flight_at(now)?;
        let path = self.root.join(layout::LIVE_FILE);
        let of = serde_json::to_vec(table).map_err(|e| StoreError::io(&path, "write")(e.into()))?;
        let head = Head { format: FORMAT, flight: flight.clone(), began: now.clone(), table: table.clone() };
        let first = || {
            let bytes = columns::first_line(&head)?;
            let tag = columns::first_check(&bytes);
            Ok(Piece { bytes, tag })
        };
        let block = |before| columns::block(table, rows, &before).map(|(bytes, tag)| Piece { bytes, tag });
        self.live.append(self, &flight, of, first, block)
    }

    /// Closes the file being written into its flight, so that the flight's sums cover it.
    pub fn close_live(&self) -> Result<(), StoreError> {
        self.live.close(self)
    }
}
