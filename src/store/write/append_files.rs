//! What is recorded beside the series of frames: the aircraft's data as it comes, live results in columns, what people mark
//! in the frames.

use std::sync::PoisonError;

use serde_json::Value;
use sha2::{Digest, Sha256};

use super::segment::{self, AppendFile, AppendPiece, OpenSegment};
use super::store::Store;
use crate::clock::Stamp;
use crate::store::disk::StoreError;
use crate::store::format::aircraft::{AircraftLine, AircraftHead};
use crate::store::format::columns::{self, LiveTable, LiveRow};
use crate::store::format::jsonl;
use crate::store::format::append_file_kinds::{AIRCRAFT_DATA, LIVE_RESULTS, MANUAL_MARKS};
use crate::store::format::manual_marks::{self, ManualMark};

impl Store {
    /// Records lines durably with the newest flight; `false` where there is no flight yet. Below the reserve it refuses:
    /// frames and results go first.
    pub fn add_aircraft_lines(&self, source: &Value, lines: &[AircraftLine]) -> Result<bool, StoreError> {
        let Some(flight) = self.current_flight() else { return Ok(false) };
        self.add_aircraft_lines_to(&flight, source, lines)
    }

    /// The same with a flight that is named.
    pub fn add_aircraft_lines_to(
        &self,
        flight: &str,
        source: &Value,
        lines: &[AircraftLine],
    ) -> Result<bool, StoreError> {
        self.refuse_below_reserve()?;
        let path = self.root().join(AIRCRAFT_DATA.open_name);
        let piece = |bytes| AppendPiece { bytes, tag: [0; 32] };
        let head = AircraftHead { flight: flight.to_owned(), source: source.clone() };
        let first = jsonl::encode_line(&head).map_err(StoreError::io(&path, "write"))?;
        let begin = || Ok(piece(first.clone()));
        let written = |_| Ok(piece(lines.iter().map(jsonl::encode_line).collect::<Result<Vec<_>, _>>()?.concat()));
        self.append_piece(&self.aircraft, flight, first.clone(), begin, written)?;
        Ok(true)
    }

    /// Closes what is open, so that the flight's sums cover it.
    pub fn close_aircraft_file(&self) -> Result<(), StoreError> {
        self.close_append_file(&self.aircraft)
    }

    /// Records results of up to now durably, as one block; begins a flight where the rules have one begin, and files as
    /// they are needed. Below the reserve it refuses: frames and their results go first.
    ///
    /// An error that the rows do not fit the table is one of [`std::io::ErrorKind::InvalidInput`]. After any error none
    /// of the rows is recorded.
    pub fn append_live_rows(&self, table: &LiveTable, rows: &[LiveRow], now: &Stamp) -> Result<(), StoreError> {
        if rows.is_empty() {
            return Ok(());
        }
        self.refuse_below_reserve()?;
        let flight = self.flight_for_recording(now)?;
        let path = self.root().join(LIVE_RESULTS.open_name);
        let of = serde_json::to_vec(table).map_err(|e| StoreError::io(&path, "write")(e.into()))?;
        let head = columns::LiveHead {
            format: columns::FORMAT,
            flight: flight.clone(),
            began: now.clone(),
            table: table.clone(),
        };
        let first = || {
            let bytes = jsonl::encode_line(&head)?;
            let tag = columns::first_block_digest(&bytes);
            Ok(AppendPiece { bytes, tag })
        };
        let block = |before| columns::encode_block(table, rows, &before).map(|(bytes, tag)| AppendPiece { bytes, tag });
        self.append_piece(&self.live, &flight, of, first, block)
    }

    /// Adds what a person marked in frames of a flight, durably when this returns: beside the frames and what was detected in
    /// them, over neither.
    pub fn add_marks(&self, flight: &str, marks: &[ManualMark]) -> Result<(), StoreError> {
        let path = self.root().join(MANUAL_MARKS.open_name);
        let piece = |bytes| AppendPiece { bytes, tag: [0; 32] };
        let head = manual_marks::ManualMarksHead { flight: flight.to_owned() };
        let first = jsonl::encode_line(&head).map_err(StoreError::io(&path, "write"))?;
        let begin = || Ok(piece(first.clone()));
        let written = |_| Ok(piece(marks.iter().map(jsonl::encode_line).collect::<Result<Vec<_>, _>>()?.concat()));
        self.append_piece(&self.marks, flight, first.clone(), begin, written)
    }

    /// Closes what is open, so that the flight's sums cover it.
    pub fn close_marks_file(&self) -> Result<(), StoreError> {
        self.close_append_file(&self.marks)
    }

    /// Closes the file being written into its flight, so that the flight's sums cover it.
    pub fn close_live_file(&self) -> Result<(), StoreError> {
        self.close_append_file(&self.live)
    }
}

/// Appending to files that grow.
impl Store {
    /// Appends a piece durably. `of` is what all of a file is of: another one closes the file and begins one with
    /// `first`, as does one that is too long. `piece` gets what it follows from.
    fn append_piece(
        &self,
        growing: &AppendFile,
        flight: &str,
        of: Vec<u8>,
        first: impl FnOnce() -> std::io::Result<AppendPiece>,
        piece: impl FnOnce([u8; 32]) -> std::io::Result<AppendPiece>,
    ) -> Result<(), StoreError> {
        let path = self.root().join(growing.kind.open_name);
        let mut open = growing.open.lock().unwrap_or_else(PoisonError::into_inner);
        if open.as_ref().is_some_and(|s| s.descriptor != of || s.flight != flight || s.length > growing.kind.max_length)
        {
            self.close_segment(growing, &mut open)?;
        }
        let mut segment = match open.take() {
            Some(segment) => segment,
            None => self.begin_segment(growing, flight, of, first)?,
        };
        // Bytes that cannot be made are no fault of the file.
        let piece = match piece(segment.tag) {
            Ok(piece) => piece,
            Err(error) => {
                *open = Some(segment);
                return Err(StoreError::io(&path, "write")(error));
            }
        };
        self.disk().extend_file(&path, segment.length, &piece.bytes)?;
        segment.add_piece(&piece);
        *open = Some(segment);
        Ok(())
    }

    /// One that a failure left is closed first.
    fn begin_segment(
        &self,
        growing: &AppendFile,
        flight: &str,
        of: Vec<u8>,
        first: impl FnOnce() -> std::io::Result<AppendPiece>,
    ) -> Result<OpenSegment, StoreError> {
        let (disk, path) = (self.disk(), self.root().join(growing.kind.open_name));
        if disk.exists(&path) {
            self.close_segment(growing, &mut None)?;
        }
        let first = first().map_err(StoreError::io(&path, "write"))?;
        disk.save_file(&path, &first.bytes)?;
        disk.sync_directory(self.root())?;
        let mut segment =
            OpenSegment { flight: flight.to_owned(), descriptor: of, length: 0, hasher: Sha256::new(), tag: first.tag };
        segment.add_piece(&first);
        Ok(segment)
    }

    /// Closes what is open or left, so that the flight's sums cover it.
    fn close_append_file(&self, growing: &AppendFile) -> Result<(), StoreError> {
        let mut open = growing.open.lock().unwrap_or_else(PoisonError::into_inner);
        let left = self.disk().exists(&self.root().join(growing.kind.open_name));
        if open.is_some() || left { self.close_segment(growing, &mut open) } else { Ok(()) }
    }

    /// Whatever comes of it the next piece begins a file of its own.
    fn close_segment(&self, growing: &AppendFile, open: &mut Option<OpenSegment>) -> Result<(), StoreError> {
        let segment = open.take();
        let mut index = self.lock_index();
        let flight = match segment {
            // Every byte of it was answered for: it need not be read.
            Some(OpenSegment { flight, length, hasher, .. }) => {
                let sha256 = hex::encode(hasher.finalize());
                segment::commit_segment(self.store_root(), growing.kind, &flight, length as u64, sha256)?;
                Some(flight)
            }
            None => segment::close_leftover(self.store_root(), growing.kind)?,
        };
        index.unsealed.extend(flight);
        self.seal_all(&mut index);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use std::path::Path;
    use std::sync::Arc;

    use serde_json::json;

    use crate::store::aircraft::read_aircraft;
    use crate::store::manifest::{SeriesCause, SeriesState};
    use crate::store::{FlightRef, SeriesPlan, RealDisk, Recovery, StoreConfig, bundle, catalogue, layout, verify};

    use super::*;

    fn stamp(second: u64) -> Stamp {
        let utc: jiff::Timestamp = "2026-03-01T08:00:00Z".parse().unwrap();
        Stamp {
            utc: utc + std::time::Duration::from_secs(second),
            utc_synchronised: true,
            boot_id: "b".to_owned(),
            since_boot_s: second as f64,
        }
    }

    fn open(root: &Path) -> (Store, Recovery) {
        let config = StoreConfig { reserve_mb: 0, ..StoreConfig::new(root) };
        Store::open(Arc::new(RealDisk), config).unwrap()
    }

    fn with_flight(root: &Path) -> Store {
        let (store, _) = open(root);
        let plan = SeriesPlan { cause: SeriesCause::Scheduled, shots: 1 };
        let (series, _) = store.begin_series(plan, &stamp(10)).unwrap();
        store.close_series(series, SeriesState::Interrupted, &stamp(20), vec![]).unwrap();
        store
    }

    fn line(n: u64) -> AircraftLine {
        AircraftLine { at: Some(stamp(n)), line: format!("IWG1,{n}") }
    }

    fn flight(store: &Store) -> FlightRef {
        catalogue::list_flights(store.disk(), store.root()).unwrap().remove(0)
    }

    #[test]
    fn lines_wait_for_a_flight_and_are_covered_once_closed() {
        let dir = tempfile::tempdir().unwrap();
        assert!(!open(dir.path()).0.add_aircraft_lines(&json!("x"), &[line(1)]).unwrap(), "no flight yet");
        let store = with_flight(dir.path());
        for n in 0..10 {
            assert!(store.add_aircraft_lines(&json!({"udp": "a"}), &[line(2 * n), line(2 * n + 1)]).unwrap());
        }
        assert!(verify::verify_path(store.disk(), dir.path()).is_sound());
        store.add_aircraft_lines(&json!({"udp": "b"}), &[line(99)]).unwrap();
        store.close_aircraft_file().unwrap();
        let (all, notes) = read_aircraft(store.disk(), dir.path(), &flight(&store)).unwrap();
        assert_eq!((all.len(), all[0].1.len(), all[1].1.len(), notes.len()), (2, 20, 1, 0));
        assert_eq!(all[0].1[3].line, "IWG1,3");
        let sums = std::fs::read_to_string(flight(&store).folder.join("SHA256SUMS")).unwrap();
        assert!(
            sums.contains("  aircraft-000001.jsonl") && sums.contains("  aircraft-000002.jsonl"),
            "{sums}"
        );
        assert!(verify::verify_path(store.disk(), dir.path()).is_sound());
        let bundle = bundle::bundle_flight(store.disk(), dir.path(), &flight(&store)).unwrap();
        assert_eq!(bundle.items.iter().filter(|item| item.name.contains("aircraft-")).count(), 2);
    }

    #[test]
    fn what_a_power_cut_left_is_closed_at_the_next_start_without_its_torn_line() {
        let dir = tempfile::tempdir().unwrap();
        let store = with_flight(dir.path());
        store.add_aircraft_lines(&json!("x"), &[line(1), line(2)]).unwrap();
        drop(store);
        let path = dir.path().join(layout::AIRCRAFT_FILE);
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.extend(b"{\"at\":null,\"li");
        std::fs::write(&path, bytes).unwrap();
        let (store, _) = open(dir.path());
        let (all, _) = read_aircraft(store.disk(), dir.path(), &flight(&store)).unwrap();
        assert_eq!((all.len(), all[0].1.len(), path.exists()), (1, 2, false));
        let report = verify::verify_path(store.disk(), dir.path());
        assert!(report.is_sound(), "{report:?}");
    }

    #[test]
    fn changed_missing_and_added_files_are_faults() {
        let dir = tempfile::tempdir().unwrap();
        let store = with_flight(dir.path());
        store.add_aircraft_lines(&json!("x"), &[line(1)]).unwrap();
        store.close_aircraft_file().unwrap();
        let folder = flight(&store).folder;
        let (file, kept) = (folder.join("aircraft-000001.jsonl"), folder.join("aircraft-000002.jsonl"));
        let whole = std::fs::read(&file).unwrap();
        let faults = || -> Vec<u8> {
            let report = verify::verify_path(&RealDisk, dir.path());
            report.faults.iter().map(|f| f.invariant).collect()
        };
        assert!(faults().is_empty());
        let other: Vec<u8> = whole.iter().map(|b| if *b == b'1' { b'2' } else { *b }).collect();
        std::fs::write(&file, other).unwrap();
        assert_eq!(faults(), [20_u8]);
        std::fs::remove_file(&file).unwrap();
        assert_eq!(faults(), [20_u8]);
        std::fs::write(&file, &whole).unwrap();
        std::fs::write(&kept, &whole).unwrap();
        assert_eq!(faults(), [20_u8]);
    }
}
