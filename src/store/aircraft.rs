//! Lines of the aircraft's data: recorded as they came, in files of a flight that grow at their end and are then closed.
//!
//! The file being written lies in the root, since recovering `incoming/` must not touch it. Its first line says whose it
//! is; each further one is a line of the feed. It is closed by its line in the chain, then one rename to the flight.

use std::path::Path;
use std::sync::PoisonError;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::chain::{self, Chain, Event};
use super::disk::{self, Disk};
use super::error::StoreError;
use super::recover::Recovery;
use super::results::{set_aside, sha256};
use super::{FlightRef, Store, catalogue, jsonl, layout, series};
use crate::clock::Stamp;

/// Beyond this a file is closed and another one begun, bytes.
const LONGEST: usize = 1 << 20;

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

/// The file being written.
pub struct Segment {
    head: Head,
    length: usize,
}

/// The closed files of a flight, in order.
pub fn files(disk: &dyn Disk, flight: &FlightRef) -> Result<Vec<String>, StoreError> {
    let list = disk.list(&flight.folder).map_err(StoreError::io(&flight.folder, "list"))?;
    let ours = list.into_iter().filter(|e| !e.is_dir && !e.is_link).map(|e| e.name);
    Ok(ours.filter(|name| layout::aircraft_number(name).is_some()).collect())
}

/// Each file's first line and its others.
pub type Recorded = Vec<(Head, Vec<AircraftLine>)>;

/// Heads and lines of a flight, the file being written among them; and what could not be read.
pub fn read(disk: &dyn Disk, root: &Path, flight: &FlightRef) -> Result<(Recorded, Vec<String>), StoreError> {
    let (mut all, mut notes) = (Vec::new(), Vec::new());
    let closed = files(disk, flight)?.into_iter().map(|file| flight.folder.join(file));
    let open = root.join(layout::AIRCRAFT_FILE);
    for path in closed.chain(disk.exists(&open).then_some(open)) {
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

/// Whether a file that the chain has is the one in the root, which the next start moves to its flight.
pub(crate) fn is_under_way(disk: &dyn Disk, root: Option<&Path>, flight: &str, digest: &str) -> bool {
    let bytes = root.and_then(|root| disk.read(&root.join(layout::AIRCRAFT_FILE)).ok());
    bytes.is_some_and(|b| sha256(&b) == digest && parse(&b).is_some_and(|(head, _)| head.flight == flight))
}

/// What the last recorder left: closed into its flight, or set aside where that is not possible.
pub(crate) fn settle(disk: &dyn Disk, root: &Path, recovery: &mut Recovery) {
    let path = root.join(layout::AIRCRAFT_FILE);
    if !disk.exists(&path) {
        return;
    }
    match close(disk, root) {
        Ok(Some(flight)) => recovery.remarks.push(format!("{flight}: its aircraft data were closed")),
        Ok(None) => recovery.set_aside.push(layout::AIRCRAFT_FILE.to_owned()),
        Err(error) => recovery.remarks.push(format!("the aircraft's data stay where they are: {error}")),
    }
}

/// Closes the file in the root. `None` where nothing of it is whole, or its flight is gone: it is set aside.
fn close(disk: &dyn Disk, root: &Path) -> Result<Option<String>, StoreError> {
    let path = root.join(layout::AIRCRAFT_FILE);
    let bytes = disk.read(&path).map_err(StoreError::io(&path, "read"))?;
    let good = jsonl::parse::<Value>(&bytes).good_length;
    let whole = bytes.get(..good).unwrap_or_default();
    let head = parse(whole).map(|(head, _)| head).filter(|h| layout::flight_number(&h.flight).is_some());
    let flight =
        head.map(|head| FlightRef { folder: root.join(layout::FLIGHTS).join(&head.flight), id: head.flight });
    let Some(flight) = flight.filter(|flight| disk.exists(&flight.folder)) else {
        set_aside(disk, root, &format!("aircraft-{}.torn", &sha256(&bytes)[..8]), &bytes)?;
        disk.remove_file(&path).map_err(StoreError::io(&path, "remove"))?;
        disk.sync_dir(root).map_err(StoreError::io(root, "sync"))?;
        return Ok(None);
    };
    if let Some(tail) = bytes.get(good..).filter(|tail| !tail.is_empty()) {
        set_aside(disk, root, &format!("{}-aircraft-{good}.torn", flight.id), tail)?;
    }
    // Written anew also where nothing is torn: after a failed fsync a file may show what is not on the disk.
    disk::replace(disk, &path, whole).map_err(StoreError::io(&path, "write"))?;
    let file = note(disk, root, &flight, whole)?;
    series::move_durably(disk, &path, &flight.folder.join(file))?;
    Ok(Some(flight.id))
}

/// Notes the file in the flight's chain, once, and gives its name there.
fn note(disk: &dyn Disk, root: &Path, flight: &FlightRef, whole: &[u8]) -> Result<String, StoreError> {
    let (bytes, sha256) = (whole.len() as u64, sha256(whole));
    let last = files(disk, flight)?.last().and_then(|name| layout::aircraft_number(name)).unwrap_or(0);
    let file = layout::aircraft_name(last + 1);
    if catalogue::store_id(disk, root).is_none() {
        return Ok(file);
    }
    let event = Event::Aircraft { file: file.clone(), bytes, sha256 };
    let known = chain::read(disk, &flight.folder)?;
    if Chain::parse(&known).events.iter().any(|(_, there)| *there == event) {
        let path = flight.folder.join(layout::CHAIN_FILE);
        disk::replace(disk, &path, &known).map_err(StoreError::io(&path, "write"))?;
        return Ok(file);
    }
    chain::append(disk, root, &flight.folder, event)?;
    Ok(file)
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
        let (path, free_mb) = (self.root.join(layout::AIRCRAFT_FILE), self.free_mb()?);
        if free_mb < self.reserve_mb() {
            let (path, reserve_mb) = (self.root.clone(), self.reserve_mb());
            return Err(StoreError::BelowReserve { path, free_mb, reserve_mb });
        }
        let mut open = self.aircraft.lock().unwrap_or_else(PoisonError::into_inner);
        let head = Head { flight: flight.to_owned(), source: source.clone() };
        if open.as_ref().is_some_and(|segment| segment.head != head || segment.length > LONGEST) {
            self.close_segment(&mut open)?;
        }
        let write = StoreError::io(&path, "write");
        let mut bytes = Vec::new();
        for line in lines {
            match jsonl::line(line) {
                Ok(line) => bytes.extend(line),
                Err(error) => return Err(write(error)),
            }
        }
        let segment = match &mut *open {
            Some(segment) => segment,
            none => none.insert(self.begin_segment(head)?),
        };
        disk::append(self.disk(), &path, segment.length, &bytes).map_err(write)?;
        segment.length += bytes.len();
        Ok(true)
    }

    /// One that a failed closing left is closed first.
    fn begin_segment(&self, head: Head) -> Result<Segment, StoreError> {
        let path = self.root.join(layout::AIRCRAFT_FILE);
        if self.disk.exists(&path) {
            self.close_segment(&mut None)?;
        }
        let first = jsonl::line(&head).map_err(StoreError::io(&path, "write"))?;
        self.disk.write(&path, &first).map_err(StoreError::io(&path, "write"))?;
        self.disk.sync_dir(&self.root).map_err(StoreError::io(&self.root, "sync"))?;
        Ok(Segment { head, length: first.len() })
    }

    /// Closes what is open, so that the flight's sums cover it.
    pub fn close_aircraft(&self) -> Result<(), StoreError> {
        let mut open = self.aircraft.lock().unwrap_or_else(PoisonError::into_inner);
        if open.is_some() { self.close_segment(&mut open) } else { Ok(()) }
    }

    fn close_segment(&self, open: &mut Option<Segment>) -> Result<(), StoreError> {
        // Whatever comes of it the next lines begin a file of their own.
        *open = None;
        let mut index = self.index();
        if let Some(flight) = close(self.disk(), &self.root)? {
            index.unsealed.insert(flight);
        }
        self.seal_all(&mut index);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use std::sync::Arc;

    use serde_json::json;

    use super::super::manifest::{Cause, State};
    use super::super::{Plan, RealDisk, StoreConfig, verify};
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
