//! Lines of the aircraft's data: recorded as they came, in files of a flight ([`super::segment`]). The first line says
//! whose they are, each further one is a line of the feed.

use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::chain::Event;
use super::disk::Disk;
use super::error::StoreError;
use super::results::sha256;
use super::segment::{self, Kind, Piece};
use super::{FlightRef, Store, jsonl, layout};
use crate::clock::Stamp;

pub(crate) const KIND: Kind = Kind {
    open: layout::AIRCRAFT_FILE,
    what: "aircraft data",
    stem: "aircraft",
    name: layout::aircraft_name,
    number: layout::aircraft_number,
    whole,
    event: |file, bytes, sha256| Event::Aircraft { file, bytes, sha256 },
    invariant: 20,
    longest: 1 << 20,
};

/// The first line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// The flight that the lines belong to.
    pub flight: String,
    /// Where they come from and how they are to be read, in the feed's words.
    pub source: Value,
}

/// A line of the feed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AircraftLine {
    /// When it came; `null` for lines of a file that came after the flight.
    pub at: Option<Stamp>,
    /// As it came, without its end; bytes that are no text are replaced.
    pub line: String,
}

/// The closed files of a flight, in order.
pub fn files(disk: &dyn Disk, flight: &FlightRef) -> Result<Vec<String>, StoreError> {
    segment::files(disk, flight, &KIND)
}

/// Each file's first line and its others.
pub type Recorded = Vec<(Head, Vec<AircraftLine>)>;

/// Heads and lines of a flight, the file being written among them; and what could not be read.
pub fn read(disk: &dyn Disk, root: &Path, flight: &FlightRef) -> Result<(Recorded, Vec<String>), StoreError> {
    let (mut all, mut notes) = (Vec::new(), Vec::new());
    for path in segment::paths(disk, root, flight, &KIND)? {
        let bytes = disk.read(&path).map_err(StoreError::io(&path, "read"))?;
        match parse(&bytes) {
            Some((head, lines)) if head.flight == flight.id => all.push((head, lines)),
            Some(_) => {}
            None => notes.push(format!("{}: its first line is damaged; run `wingd verify`", path.display())),
        }
    }
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

fn parse(bytes: &[u8]) -> Option<(Head, Vec<AircraftLine>)> {
    let first = bytes.split_inclusive(|byte| *byte == b'\n').next()?;
    let head = serde_json::from_slice(first).ok()?;
    let lines = jsonl::parse::<AircraftLine>(bytes.get(first.len()..)?).good;
    Some((head, lines.into_iter().map(|(_, line)| line).collect()))
}

fn whole(bytes: &[u8]) -> Option<(usize, String)> {
    let good = jsonl::parse::<Value>(bytes).good_length;
    let (head, _) = parse(bytes.get(..good)?)?;
    Some((good, head.flight))
}

impl Store {
    /// Records lines durably with the newest flight; `false` where there is no flight yet. Below the reserve it refuses:
    /// frames and results go first.
    pub fn add_aircraft(&self, source: &Value, lines: &[AircraftLine]) -> Result<bool, StoreError> {
        let Some(flight) = self.current_flight() else { return Ok(false) };
        self.add_aircraft_to(&flight, source, lines)
    }

    /// The same with a flight that is named.
    pub fn add_aircraft_to(
        &self,
        flight: &str,
        source: &Value,
        lines: &[AircraftLine],
    ) -> Result<bool, StoreError> {
        self.refuse_below_reserve()?;
        let path = self.root.join(layout::AIRCRAFT_FILE);
        let piece = |bytes| Piece { bytes, tag: [0; 32] };
        let head = Head { flight: flight.to_owned(), source: source.clone() };
        let first = jsonl::line(&head).map_err(StoreError::io(&path, "write"))?;
        let begin = || Ok(piece(first.clone()));
        let written = |_| Ok(piece(lines.iter().map(jsonl::line).collect::<Result<Vec<_>, _>>()?.concat()));
        self.aircraft.append(self, flight, first.clone(), begin, written)?;
        Ok(true)
    }

    /// Closes what is open, so that the flight's sums cover it.
    pub fn close_aircraft(&self) -> Result<(), StoreError> {
        self.aircraft.close(self)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use std::sync::Arc;

    use serde_json::json;

    use super::super::manifest::{Cause, State};
    use super::super::{Plan, RealDisk, Recovery, StoreConfig, catalogue, verify};
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
        let config = StoreConfig { reserve_mb: 0, ..StoreConfig::at(root) };
        Store::open(Arc::new(RealDisk), config).unwrap()
    }

    fn with_flight(root: &Path) -> Store {
        let (store, _) = open(root);
        let plan = Plan { cause: Cause::Scheduled, shots: 1 };
        let (series, _) = store.begin_series(plan, &stamp(10)).unwrap();
        store.close_series(series, State::Interrupted, &stamp(20), vec![]).unwrap();
        store
    }

    fn line(n: u64) -> AircraftLine {
        AircraftLine { at: Some(stamp(n)), line: format!("IWG1,{n}") }
    }

    fn flight(store: &Store) -> FlightRef {
        catalogue::flights(store.disk(), store.root()).unwrap().remove(0)
    }

    #[test]
    fn lines_wait_for_a_flight_and_are_covered_once_closed() {
        let dir = tempfile::tempdir().unwrap();
        assert!(!open(dir.path()).0.add_aircraft(&json!("x"), &[line(1)]).unwrap(), "no flight yet");
        let store = with_flight(dir.path());
        for n in 0..10 {
            assert!(store.add_aircraft(&json!({"udp": "a"}), &[line(2 * n), line(2 * n + 1)]).unwrap());
        }
        assert!(verify::verify(store.disk(), dir.path()).is_sound());
        store.add_aircraft(&json!({"udp": "b"}), &[line(99)]).unwrap();
        store.close_aircraft().unwrap();
        let (all, notes) = read(store.disk(), dir.path(), &flight(&store)).unwrap();
        assert_eq!((all.len(), all[0].1.len(), all[1].1.len(), notes.len()), (2, 20, 1, 0));
        assert_eq!(all[0].1[3].line, "IWG1,3");
        let sums = std::fs::read_to_string(flight(&store).folder.join("SHA256SUMS")).unwrap();
        assert!(
            sums.contains("  aircraft-000001.jsonl") && sums.contains("  aircraft-000002.jsonl"),
            "{sums}"
        );
        assert!(verify::verify(store.disk(), dir.path()).is_sound());
        let bundle = super::super::bundle::flight(store.disk(), dir.path(), &flight(&store)).unwrap();
        assert_eq!(bundle.items.iter().filter(|item| item.name.contains("aircraft-")).count(), 2);
    }

    #[test]
    fn what_a_power_cut_left_is_closed_at_the_next_start_without_its_torn_line() {
        let dir = tempfile::tempdir().unwrap();
        let store = with_flight(dir.path());
        store.add_aircraft(&json!("x"), &[line(1), line(2)]).unwrap();
        drop(store);
        let path = dir.path().join(layout::AIRCRAFT_FILE);
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.extend(b"{\"at\":null,\"li");
        std::fs::write(&path, bytes).unwrap();
        let (store, _) = open(dir.path());
        let (all, _) = read(store.disk(), dir.path(), &flight(&store)).unwrap();
        assert_eq!((all.len(), all[0].1.len(), path.exists()), (1, 2, false));
        let report = verify::verify(store.disk(), dir.path());
        assert!(report.is_sound(), "{report:?}");
    }

    #[test]
    fn changed_missing_and_added_files_are_faults() {
        let dir = tempfile::tempdir().unwrap();
        let store = with_flight(dir.path());
        store.add_aircraft(&json!("x"), &[line(1)]).unwrap();
        store.close_aircraft().unwrap();
        let folder = flight(&store).folder;
        let (file, kept) = (folder.join("aircraft-000001.jsonl"), folder.join("aircraft-000002.jsonl"));
        let whole = std::fs::read(&file).unwrap();
        let faults = || -> Vec<u8> {
            let report = verify::verify(&RealDisk, dir.path());
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
