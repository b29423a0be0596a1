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
        if let Err(error) = catalogue::check_format(self.disk, root) {
            self.report
                .add_fault(1, &root.join(layout::STORE_FILE), error.to_string());
        }
        let flights = root.join(layout::FLIGHTS);
        for entry in self.list_or_report(&flights, 3) {
            let folder = flights.join(&entry.name);
            if entry.is_link {
                self.report_link(&folder);
            } else if entry.is_dir && layout::flight_number(&entry.name).is_some() {
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

    /// Notes the remains of an interrupted `fetch`, `copy` or `prune`.
    fn note_unfinished(&mut self, root: &Path) {
        let remains = [
            (
                layout::FETCHING,
                "a copy or fetch into this directory was interrupted: repeat it",
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

    /// Reports foreign files in the root of a store with evidence, and links anywhere.
    fn check_root_entries(&mut self, root: &Path) {
        let evidence = catalogue::store_id(self.disk, root).is_some();
        for entry in self.list_or_report(root, 3) {
            let path = root.join(&entry.name);
            if entry.is_link {
                self.report_link(&path);
            } else if evidence && !layout::is_root_name(&entry.name) {
                self.report
                    .add_fault(3, &path, "does not belong in a store");
            }
        }
        for name in [layout::INCOMING, layout::INSTALLATIONS] {
            self.check_links_below(&root.join(name));
        }
    }

    fn check_links_below(&mut self, folder: &Path) {
        for entry in self.disk.list(folder).unwrap_or_default() {
            let path = folder.join(&entry.name);
            match (entry.is_link, entry.is_dir) {
                (true, _) => self.report_link(&path),
                (false, true) => self.check_links_below(&path),
                _ => {}
            }
        }
    }

    fn report_link(&mut self, path: &Path) {
        self.report.add_fault(
            18,
            path,
            "is a link: its target can change or disappear independently of the store",
        );
    }

    /// Notes flights that were begun but are not here: moved away, or lost.
    fn note_absent_flights(&mut self, root: &Path) {
        let Some(counter) = self
            .disk
            .load_json::<Counter>(&root.join(layout::COUNTER_FILE))
        else {
            return;
        };
        let pruned = self
            .disk
            .read(&root.join(layout::PRUNED_FILE))
            .unwrap_or_default();
        let mut pruned_here = BTreeSet::new();
        for (_, line) in jsonl::parse_lines::<PrunedFlight>(&pruned).good {
            let (id, copy) = (line.flight.flight, line.copy);
            if !self.disk.exists(&root.join(layout::FLIGHTS).join(&id))
                && pruned_here.insert(id.clone())
            {
                self.report.notes.push(format!(
                    "{id} was pruned; its verified copy: {}",
                    copy.display()
                ));
            }
        }
        let here = catalogue::list_flights(self.disk, root).unwrap_or_default();
        let here: BTreeSet<u64> = here
            .iter()
            .filter_map(|f| layout::flight_number(&f.id))
            .collect();
        let absent = counter
            .next_flight
            .saturating_sub(1 + (here.len() + pruned_here.len()) as u64);
        if absent > 0 {
            let problem = "flights are missing: they were moved away or lost";
            self.report.notes.push(format!("{absent} {problem}"));
        }
    }

    fn list_or_report(&mut self, directory: &Path, invariant: u8) -> Vec<DirectoryEntry> {
        match self.disk.list(directory) {
            Ok(entries) => entries,
            Err(error) => {
                self.report
                    .add_fault(invariant, directory, format!("cannot be listed: {error}"));
                Vec::new()
            }
        }
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
        let series = self
            .seen
            .keys()
            .filter_map(|id| layout::series_number(id))
            .max();
        let folder = |path: &PathBuf| path.parent().map(folder_name).unwrap_or_default();
        let flight = self
            .seen
            .values()
            .filter_map(|path| layout::flight_number(&folder(path)))
            .max();
        if series.is_some_and(|last| counter.next_series <= last) {
            self.report
                .add_fault(2, &path, "next_series is not above the existing series");
        }
        if flight.is_some_and(|last| counter.next_flight <= last) {
            self.report
                .add_fault(2, &path, "next_flight is not above the existing flights");
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
            if entry.is_link {
                self.report_link(&folder);
            } else if entry.is_dir && layout::series_number(&entry.name).is_some() {
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
            let problem = "is in a store of format 1: an upgrade was interrupted (repeat it), or store.toml was changed";
            self.report
                .add_fault(1, &flight.folder.join(layout::CHAIN_FILE), problem);
        } else {
            let problem = "has no chain: changed results and missing series cannot be detected";
            self.report.notes.push(format!(
                "{}: {problem} (`wingd verify --upgrade`)",
                flight.id
            ));
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
