//! Verification of the numbered invariants of docs/store.md, on a store or on a copy of a part of it.

mod audit;
mod report;
mod series;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

pub use report::{InvariantFault, VerifyReport};

use audit::{FlightAudit, Manifests};
use serde::de::DeserializeOwned;

use crate::disk::{DirectoryEntry, Disk};
use crate::format::manifest::{
    Counter, FlightManifest, JournalLine, PrunedFlight, RefusedSeries, Shot,
};
use crate::format::{jsonl, layout, sha256_hex};
use crate::read::catalogue;
use crate::read::catalogue::{FlightRef, SeriesRef};
use crate::read::result_sets;
use crate::write::signing;
use crate::write::signing::PublicKey;
use wingd_base::clock::Stamp;

/// Runs [`verify_path`] and checks that everything was signed with a key (invariant 19).
pub fn verify_with_key(disk: &dyn Disk, path: &Path, key: &PublicKey) -> VerifyReport {
    let mut report = verify_path(disk, path);
    let flights = match catalogue::list_flights(disk, path) {
        Ok(flights) if disk.exists(&path.join(layout::FLIGHTS)) => flights,
        _ => vec![FlightRef {
            id: folder_name(path),
            folder: path.to_owned(),
        }],
    };
    let absent = AbsentFlights::find(disk, path);
    if let Some(first) = absent.first {
        let problem = format!(
            "{} flights are missing that {} does not name, the first is {first}: restore them from a copy; verify a copy of \
             single flights by their folders",
            absent.count,
            layout::PRUNED_FILE
        );
        report.add_fault(19, &path.join(layout::FLIGHTS), problem);
    }
    for flight in flights {
        let file = flight.folder.join(layout::CHAIN_FILE);
        let links = jsonl::parse_lines(&disk.read(&file).unwrap_or_default()).good;
        let signed = signing::check_signatures(links, key);
        for problem in signed.invalid {
            report.add_fault(19, &file, problem);
        }
        if signed.valid == 0 {
            report.add_fault(19, &file, "has no signature by this key");
        } else if signed.unsigned > 0 {
            let problem = format!(
                "{} lines after the last signature: not signed yet (start the recorder once), or added manually",
                signed.unsigned
            );
            report.add_fault(19, &file, problem);
        }
    }
    report
}

/// Verifies a store, or a copied flight or series, distinguished by the files in it.
pub fn verify_path(disk: &dyn Disk, path: &Path) -> VerifyReport {
    let mut checker = StoreChecker {
        disk,
        report: VerifyReport::default(),
        seen: BTreeMap::new(),
        manifests: Manifests::new(),
        last: None,
    };
    for (link, _) in disk
        .walk(path, usize::MAX)
        .iter()
        .filter(|(_, e)| e.is_link)
    {
        let problem = "is a link: its target can change or disappear independently of the store";
        checker.report.add_fault(18, link, problem);
    }
    if disk.exists(&path.join(layout::STORE_FILE)) || disk.exists(&path.join(layout::FLIGHTS)) {
        checker.check_store(path);
    } else if disk.exists(&path.join(layout::FLIGHT_FILE)) {
        let id = folder_name(path);
        checker.check_flight(
            None,
            &FlightRef {
                id,
                folder: path.to_owned(),
            },
        );
    } else if disk.exists(&path.join(layout::SERIES_FILE)) {
        let series = SeriesRef {
            flight: String::new(),
            id: folder_name(path),
            folder: path.to_owned(),
        };
        checker.check_series(&series);
    } else {
        let problem = format!(
            "is not a store, flight or series: it has no {}, {} or {}",
            layout::STORE_FILE,
            layout::FLIGHT_FILE,
            layout::SERIES_FILE
        );
        checker.report.add_fault(1, path, problem);
    }
    checker.report
}

/// Flights of a store that were begun and are not in it.
#[derive(Default)]
struct AbsentFlights {
    /// Deleted flights, with their verified copies.
    pruned: BTreeMap<String, PathBuf>,
    /// Number of the others.
    count: u64,
    /// First of them.
    first: Option<String>,
}

impl AbsentFlights {
    fn find(disk: &dyn Disk, root: &Path) -> Self {
        let Ok(flights) = catalogue::list_flights(disk, root) else {
            return Self::default();
        };
        let mut known: BTreeSet<String> = flights.into_iter().map(|flight| flight.id).collect();
        let log = disk.read(&root.join(layout::PRUNED_FILE));
        let mut pruned = BTreeMap::new();
        for (_, line) in jsonl::parse_lines::<PrunedFlight>(&log.unwrap_or_default()).good {
            if known.insert(line.flight.flight.clone()) {
                pruned.insert(line.flight.flight, line.copy);
            }
        }
        let saved = disk.load_json::<Counter>(&root.join(layout::COUNTER_FILE));
        let mut counter = saved.unwrap_or(Counter::FIRST);
        known.iter().for_each(|id| counter.advance_past(id));
        let count = (counter.next_flight - 1).saturating_sub(known.len() as u64);
        let mut ids = (1..counter.next_flight).map(layout::flight_id);
        let first = ids.find(|id| !known.contains(id)).filter(|_| count > 0);
        Self {
            pruned,
            count,
            first,
        }
    }
}

fn folder_name(path: &Path) -> String {
    let full = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    full.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

struct StoreChecker<'a> {
    disk: &'a dyn Disk,
    report: VerifyReport,
    /// Paths of the series seen, by id.
    seen: BTreeMap<String, PathBuf>,
    /// Manifests of the current flight, for its audit.
    manifests: Manifests,
    /// Last time stamp of the previous series.
    last: Option<Stamp>,
}

impl StoreChecker<'_> {
    fn check_store(&mut self, root: &Path) {
        if let Err(error) = catalogue::check_format_file(self.disk, root) {
            self.report
                .add_fault(1, &root.join(layout::STORE_FILE), error.to_string());
        }
        let flights = root.join(layout::FLIGHTS);
        for entry in self.list_or_report(&flights, 3) {
            let folder = flights.join(&entry.name);
            if entry.is_dir && layout::flight_number(&entry.name).is_some() {
                self.check_flight(
                    Some(root),
                    &FlightRef {
                        id: entry.name,
                        folder,
                    },
                );
            } else {
                self.report.add_fault(
                    3,
                    &folder,
                    "is not a flight; only folders f0001, f0002, … are allowed here",
                );
            }
        }
        self.report
            .notes
            .extend(result_sets::mixed_inputs_warnings(self.disk, root));
        self.note_unfinished(root);
        self.check_root_entries(root);
        self.check_incoming(root);
        self.check_id_counter(root);
        self.note_absent_flights(root);
        self.note_refused_series(root);
        if let Ok(entries) = self.disk.list(&root.join(layout::PARTIAL)) {
            let names = entries.iter().map(|entry| entry.name.as_str());
            self.report
                .notes
                .extend(names.map(|name| format!("partial/{name}: incomplete data, kept")));
        }
    }

    /// Notes the remains of an interrupted `copy` or `prune`.
    fn note_unfinished(&mut self, root: &Path) {
        let remains = [
            (
                layout::FETCHING,
                "a copy into this directory was interrupted: repeat it",
            ),
            (
                layout::PRUNED,
                "files that were being deleted: `wingd prune` removes the rest",
            ),
        ];
        for (name, problem) in remains {
            if self
                .disk
                .list(&root.join(name))
                .is_ok_and(|list| !list.is_empty())
            {
                self.report.notes.push(format!("{name}/: {problem}"));
            }
        }
    }

    /// Reports foreign files in the root of a store with evidence.
    fn check_root_entries(&mut self, root: &Path) {
        let evidence = catalogue::store_id(self.disk, root).is_some();
        for entry in self.list_or_report(root, 3) {
            let path = root.join(&entry.name);
            if evidence && !layout::is_root_name(&entry.name) {
                self.report
                    .add_fault(3, &path, "does not belong in a store");
            }
        }
    }

    /// Notes flights that were begun but are not here: moved away, or lost.
    fn note_absent_flights(&mut self, root: &Path) {
        let absent = AbsentFlights::find(self.disk, root);
        let notes = absent.pruned.iter().map(|(id, copy)| {
            let copy = copy.display();
            format!("{id} was pruned; its verified copy: {copy}")
        });
        self.report.notes.extend(notes);
        if absent.first.is_some() {
            let problem = "flights are missing: they were moved away or lost";
            self.report
                .notes
                .push(format!("{} {problem}", absent.count));
        }
    }

    fn list_or_report(&mut self, directory: &Path, invariant: u8) -> Vec<DirectoryEntry> {
        let listed = self.disk.list(directory).map_err(|error| {
            let problem = format!("cannot be listed: {error}");
            self.report.add_fault(invariant, directory, problem);
        });
        listed.unwrap_or_default()
    }

    fn check_id_counter(&mut self, root: &Path) {
        let path = root.join(layout::COUNTER_FILE);
        let read = self.disk.read(&path).map_err(|e| e.to_string());
        let counter = read
            .and_then(|bytes| serde_json::from_slice::<Counter>(&bytes).map_err(|e| e.to_string()));
        let counter = match counter {
            Ok(counter) => counter,
            Err(error) => {
                return self
                    .report
                    .add_fault(2, &path, format!("cannot be read: {error}"));
            }
        };
        let mut least = Counter::FIRST;
        for (id, folder) in &self.seen {
            least.advance_past(id);
            least.advance_past(&folder.parent().map(folder_name).unwrap_or_default());
        }
        for (key, next, least) in [
            ("series", counter.next_series, least.next_series),
            ("flight", counter.next_flight, least.next_flight),
        ] {
            if next < least {
                let problem = format!("next_{key} is not above the existing ones");
                self.report.add_fault(2, &path, problem);
            }
        }
    }

    fn check_flight(&mut self, root: Option<&Path>, flight: &FlightRef) {
        self.report.flights += 1;
        self.manifests.clear();
        let path = flight.folder.join(layout::FLIGHT_FILE);
        if let Some(manifest) = self
            .parse_or_report::<FlightManifest>(&path, 3)
            .filter(|m| m.flight != flight.id)
        {
            let problem = format!(
                "names flight {}, its folder is {}",
                manifest.flight, flight.id
            );
            self.report.add_fault(3, &path, problem);
        }
        for entry in self.list_or_report(&flight.folder, 3) {
            let folder = flight.folder.join(&entry.name);
            if entry.is_dir && layout::series_number(&entry.name).is_some() {
                self.check_series(&SeriesRef {
                    flight: flight.id.clone(),
                    id: entry.name,
                    folder,
                });
            } else if !layout::is_flight_file(&entry.name) {
                self.report.add_fault(
                    3,
                    &folder,
                    "is not a series; it does not belong in a flight's folder",
                );
            }
        }
        self.audit_flight(root, flight);
    }

    /// Audits the chain of a flight. Flights of format 1 have none; in a flight outside a store the files decide.
    fn audit_flight(&mut self, root: Option<&Path>, flight: &FlightRef) {
        let evidence = match root {
            Some(root) => catalogue::store_id(self.disk, root).is_some(),
            None => {
                let evidence = [layout::CHAIN_FILE, layout::SUMS_FILE];
                evidence
                    .iter()
                    .any(|name| self.disk.exists(&flight.folder.join(name)))
            }
        };
        if evidence {
            let audit = FlightAudit {
                disk: self.disk,
                root,
                flight,
                manifests: &self.manifests,
            };
            audit.run(&mut self.report);
        } else if root.is_some() && self.disk.exists(&flight.folder.join(layout::CHAIN_FILE)) {
            let problem = "is in a store of format 1: store.toml was changed";
            self.report
                .add_fault(1, &flight.folder.join(layout::CHAIN_FILE), problem);
        } else {
            let problem = "has no chain: changed results and missing series cannot be detected";
            self.report.notes.push(format!("{}: {problem}", flight.id));
        }
    }

    /// Notes series in `incoming/`: being recorded, or to be recovered at the daemon's next start.
    fn check_incoming(&mut self, root: &Path) {
        let incoming = root.join(layout::INCOMING);
        for entry in self.disk.list(&incoming).unwrap_or_default() {
            let folder = incoming.join(&entry.name);
            if layout::series_number(&entry.name).is_some()
                && let Some(other) = self.seen.insert(entry.name.clone(), folder.clone())
            {
                self.report.add_fault(
                    4,
                    &folder,
                    format!("has the same id as {}", other.display()),
                );
            }
            let problem = "being recorded, or recovered at the daemon's next start";
            self.report
                .notes
                .push(format!("incoming/{}: {problem}", entry.name));
            self.check_acknowledged_frames(&folder);
        }
    }

    /// Checks that every frame in a journal except the last, which may be incomplete, is intact.
    fn check_acknowledged_frames(&mut self, folder: &Path) {
        let Ok(bytes) = self.disk.read(&folder.join(layout::JOURNAL_FILE)) else {
            return;
        };
        let lines = jsonl::parse_lines::<JournalLine>(&bytes).good;
        let shots: Vec<Shot> = lines
            .into_iter()
            .filter_map(|(_, line)| match line {
                JournalLine::Shot(shot) => Some(*shot),
                _ => None,
            })
            .collect();
        let Some((_, acknowledged)) = shots.split_last() else {
            return;
        };
        for entry in acknowledged.iter().filter_map(|shot| shot.frame.as_ref()) {
            let path = folder.join(&entry.file);
            if !self
                .disk
                .read(&path)
                .is_ok_and(|bytes| sha256_hex(&bytes) == entry.sha256)
            {
                self.report
                    .add_fault(13, &path, "is in the journal, but not intact");
            }
        }
    }

    fn note_refused_series(&mut self, root: &Path) {
        let path = root.join(layout::REFUSED_FILE);
        let Ok(bytes) = self.disk.read(&path) else {
            return;
        };
        let lines = jsonl::parse_lines::<RefusedSeries>(&bytes);
        self.report
            .notes
            .extend(lines.good.iter().map(|(_, refusal)| {
                format!(
                    "a series was refused at {}: {}",
                    refusal.stamp.utc, refusal.reason
                )
            }));
    }

    /// Reads a file; reports a fault if that fails.
    fn read_or_report(&mut self, path: &Path, invariant: u8) -> Option<Vec<u8>> {
        let fault = |error| {
            self.report
                .add_fault(invariant, path, format!("cannot be read: {error}"))
        };
        self.disk.read(path).map_err(fault).ok()
    }

    /// Parses a JSON file; reports a fault if that fails.
    fn parse_or_report<T: DeserializeOwned>(&mut self, path: &Path, invariant: u8) -> Option<T> {
        let bytes = self.read_or_report(path, invariant)?;
        let fault = |error| {
            self.report
                .add_fault(invariant, path, format!("is damaged: {error}"))
        };
        serde_json::from_slice(&bytes).map_err(fault).ok()
    }
}
