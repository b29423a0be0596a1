//! Append-only data recorded in addition to series of frames: aircraft data, live results, manual marks.

use std::sync::PoisonError;

use serde::Serialize;
use serde_json::Value;
use sha2::{Digest, Sha256};

use super::segment::{self, AppendFile, AppendPiece, OpenSegment};
use super::store::Store;
use crate::disk::{StoreError, StoreResult};
use crate::format::aircraft::{AircraftHead, AircraftLine};
use crate::format::append_file_kinds::LIVE_RESULTS;
use crate::format::columns::{self, LiveRow, LiveTable};
use crate::format::jsonl;
use crate::format::manual_marks::{self, ManualMark};
use wingd_base::clock::Stamp;

impl Store {
    /// Records lines durably with the newest flight; returns `false` if there is no flight yet. Refuses below the reserve,
    /// because frames and results have priority.
    pub fn add_aircraft_lines(&self, source: &Value, lines: &[AircraftLine]) -> StoreResult<bool> {
        let Some(flight) = self.current_flight() else {
            return Ok(false);
        };
        self.add_aircraft_lines_to(&flight, source, lines)?;
        Ok(true)
    }

    /// Records lines durably with a given flight.
    pub fn add_aircraft_lines_to(
        &self,
        flight: &str,
        source: &Value,
        lines: &[AircraftLine],
    ) -> StoreResult<()> {
        self.refuse_below_reserve()?;
        let head = AircraftHead {
            flight: flight.to_owned(),
            source: source.clone(),
        };
        self.append_lines(&self.aircraft, flight, &head, lines)
    }

    /// Closes the open file with aircraft data, so that the flight's sums cover it.
    pub fn close_aircraft_file(&self) -> StoreResult<()> {
        self.close_append_file(&self.aircraft)
    }

    /// Records live results durably, as one block; begins a flight if the rules require one, and files as needed. Refuses
    /// below the reserve, because frames and their results have priority.
    ///
    /// # Errors
    /// Returns an error of [`std::io::ErrorKind::InvalidInput`] if the rows do not match the table. After any error none of
    /// the rows is recorded.
    pub fn append_live_rows(
        &self,
        table: &LiveTable,
        rows: &[LiveRow],
        now: &Stamp,
    ) -> StoreResult<()> {
        if rows.is_empty() {
            return Ok(());
        }
        self.refuse_below_reserve()?;
        let flight = self.flight_for_recording(now)?;
        let path = self.root().join(LIVE_RESULTS.open_name);
        let descriptor =
            serde_json::to_vec(table).map_err(|e| StoreError::io(&path, "write")(e.into()))?;
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
        let block = |before| {
            columns::encode_block(table, rows, &before)
                .map(|(bytes, tag)| AppendPiece { bytes, tag })
        };
        self.append_piece(&self.live, &flight, descriptor, first, block)
    }

    /// Records manual marks in frames of a flight durably, in addition to the frames and their detections, which stay
    /// unchanged.
    pub fn add_marks(&self, flight: &str, marks: &[ManualMark]) -> StoreResult<()> {
        let head = manual_marks::ManualMarksHead {
            flight: flight.to_owned(),
        };
        self.append_lines(&self.marks, flight, &head, marks)
    }

    /// Closes the open file with manual marks, so that the flight's sums cover it.
    pub fn close_marks_file(&self) -> StoreResult<()> {
        self.close_append_file(&self.marks)
    }

    /// Closes the open file with live results, so that the flight's sums cover it.
    pub fn close_live_file(&self) -> StoreResult<()> {
        self.close_append_file(&self.live)
    }
}

/// Appending to files.
impl Store {
    /// Appends lines to a file that begins with a head.
    fn append_lines<T: Serialize>(
        &self,
        file: &AppendFile,
        flight: &str,
        head: &impl Serialize,
        lines: &[T],
    ) -> StoreResult<()> {
        let path = self.root().join(file.kind.open_name);
        let first = jsonl::encode_line(head).map_err(StoreError::io(&path, "write"))?;
        let piece = |bytes| AppendPiece {
            bytes,
            tag: [0; 32],
        };
        let begin = || Ok(piece(first.clone()));
        let encoded = |_| {
            let lines = lines.iter().map(jsonl::encode_line);
            Ok(piece(lines.collect::<Result<Vec<_>, _>>()?.concat()))
        };
        self.append_piece(file, flight, first.clone(), begin, encoded)
    }

    /// Appends a piece durably. A file has one `descriptor`; another descriptor, flight, or an exceeded length closes the
    /// file and begins one with `first`. `piece` receives the tag of the piece before.
    fn append_piece(
        &self,
        file: &AppendFile,
        flight: &str,
        descriptor: Vec<u8>,
        first: impl FnOnce() -> std::io::Result<AppendPiece>,
        piece: impl FnOnce([u8; 32]) -> std::io::Result<AppendPiece>,
    ) -> StoreResult<()> {
        let path = self.root().join(file.kind.open_name);
        let mut open = file.open.lock().unwrap_or_else(PoisonError::into_inner);
        if open.as_ref().is_some_and(|s| {
            s.descriptor != descriptor || s.flight != flight || s.length > file.kind.max_length
        }) {
            self.close_segment(file, &mut open)?;
        }
        let mut segment = match open.take() {
            Some(segment) => segment,
            None => self.begin_segment(file, flight, descriptor, first)?,
        };
        // The file stays valid if the bytes cannot be produced.
        let piece = match piece(segment.tag) {
            Ok(piece) => piece,
            Err(error) => {
                *open = Some(segment);
                return Err(StoreError::io(&path, "write")(error));
            }
        };
        self.disk()
            .extend_file(&path, segment.length as u64, &piece.bytes)?;
        segment.add_piece(&piece);
        *open = Some(segment);
        Ok(())
    }

    /// Begins a file; closes one that a failure left first.
    fn begin_segment(
        &self,
        file: &AppendFile,
        flight: &str,
        descriptor: Vec<u8>,
        first: impl FnOnce() -> std::io::Result<AppendPiece>,
    ) -> StoreResult<OpenSegment> {
        let (disk, path) = (self.disk(), self.root().join(file.kind.open_name));
        if disk.exists(&path) {
            self.close_segment(file, &mut None)?;
        }
        let first = first().map_err(StoreError::io(&path, "write"))?;
        disk.save_file(&path, &first.bytes)?;
        disk.sync_directory(self.root())?;
        let mut segment = OpenSegment {
            flight: flight.to_owned(),
            descriptor,
            length: 0,
            hasher: Sha256::new(),
            tag: first.tag,
        };
        segment.add_piece(&first);
        Ok(segment)
    }

    /// Closes the open file, or one left by a failure, so that the flight's sums cover it.
    fn close_append_file(&self, file: &AppendFile) -> StoreResult<()> {
        let mut open = file.open.lock().unwrap_or_else(PoisonError::into_inner);
        let left = self.disk().exists(&self.root().join(file.kind.open_name));
        if open.is_some() || left {
            self.close_segment(file, &mut open)
        } else {
            Ok(())
        }
    }

    /// Closes the open file; even after an error the next piece begins a new file.
    fn close_segment(&self, file: &AppendFile, open: &mut Option<OpenSegment>) -> StoreResult<()> {
        let segment = open.take();
        let mut index = self.lock_index();
        let flight = match segment {
            // Every byte was written durably: the file need not be read.
            Some(OpenSegment {
                flight,
                length,
                hasher,
                ..
            }) => {
                let sha256 = hex::encode(hasher.finalize());
                segment::commit_segment(
                    self.store_root(),
                    file.kind,
                    &flight,
                    length as u64,
                    sha256,
                )?;
                Some(flight)
            }
            None => segment::close_leftover(self.store_root(), file.kind)?,
        };
        index.unsealed.extend(flight);
        self.seal_unsealed_flights(&mut index);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Arc;

    use serde_json::json;

    use crate::aircraft::read_aircraft;
    use crate::manifest::{SeriesCause, SeriesState};
    use crate::{
        FlightRef, RealDisk, Recovery, SeriesPlan, StoreConfig, bundle, catalogue, layout, verify,
    };

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
        let config = StoreConfig {
            reserve_mb: 0,
            ..StoreConfig::new(root)
        };
        Store::open(Arc::new(RealDisk), config).unwrap()
    }

    fn with_flight(root: &Path) -> Store {
        let (store, _) = open(root);
        let plan = SeriesPlan {
            cause: SeriesCause::Scheduled,
            shots: 1,
        };
        let (series, _) = store.begin_series(plan, &stamp(10)).unwrap();
        store
            .close_series(series, SeriesState::Interrupted, &stamp(20), vec![])
            .unwrap();
        store
    }

    fn line(n: u64) -> AircraftLine {
        AircraftLine {
            at: Some(stamp(n)),
            line: format!("IWG1,{n}"),
        }
    }

    fn flight(store: &Store) -> FlightRef {
        catalogue::list_flights(store.disk(), store.root())
            .unwrap()
            .remove(0)
    }

    #[test]
    fn lines_wait_for_a_flight_and_are_covered_once_closed() {
        let dir = tempfile::tempdir().unwrap();
        assert!(
            !open(dir.path())
                .0
                .add_aircraft_lines(&json!("x"), &[line(1)])
                .unwrap(),
            "no flight yet"
        );
        let store = with_flight(dir.path());
        for n in 0..10 {
            assert!(
                store
                    .add_aircraft_lines(&json!({"udp": "a"}), &[line(2 * n), line(2 * n + 1)])
                    .unwrap()
            );
        }
        assert!(verify::verify_path(store.disk(), dir.path()).is_sound());
        store
            .add_aircraft_lines(&json!({"udp": "b"}), &[line(99)])
            .unwrap();
        store.close_aircraft_file().unwrap();
        let (all, notes) = read_aircraft(store.disk(), dir.path(), &flight(&store)).unwrap();
        assert_eq!(
            (all.len(), all[0].1.len(), all[1].1.len(), notes.len()),
            (2, 20, 1, 0)
        );
        assert_eq!(all[0].1[3].line, "IWG1,3");
        let sums = std::fs::read_to_string(flight(&store).folder.join("SHA256SUMS")).unwrap();
        assert!(
            sums.contains("  aircraft-000001.jsonl") && sums.contains("  aircraft-000002.jsonl"),
            "{sums}"
        );
        assert!(verify::verify_path(store.disk(), dir.path()).is_sound());
        let bundle = bundle::bundle_flight(store.disk(), dir.path(), &flight(&store)).unwrap();
        assert_eq!(
            bundle
                .items
                .iter()
                .filter(|item| item.name.contains("aircraft-"))
                .count(),
            2
        );
    }

    #[test]
    fn a_file_left_by_a_power_cut_is_closed_at_the_next_start_without_its_torn_line() {
        let dir = tempfile::tempdir().unwrap();
        let store = with_flight(dir.path());
        store
            .add_aircraft_lines(&json!("x"), &[line(1), line(2)])
            .unwrap();
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
        let (file, kept) = (
            folder.join("aircraft-000001.jsonl"),
            folder.join("aircraft-000002.jsonl"),
        );
        let whole = std::fs::read(&file).unwrap();
        let faults = || -> Vec<u8> {
            let report = verify::verify_path(&RealDisk, dir.path());
            report.faults.iter().map(|f| f.invariant).collect()
        };
        assert!(faults().is_empty());
        let other: Vec<u8> = whole
            .iter()
            .map(|b| if *b == b'1' { b'2' } else { *b })
            .collect();
        std::fs::write(&file, other).unwrap();
        assert_eq!(faults(), [20_u8]);
        std::fs::remove_file(&file).unwrap();
        assert_eq!(faults(), [20_u8]);
        std::fs::write(&file, &whole).unwrap();
        std::fs::write(&kept, &whole).unwrap();
        assert_eq!(faults(), [20_u8]);
    }
}
