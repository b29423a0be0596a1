//! Bundle of a flight: the files that make it a store of its own, for archives, downloads and copies.
//!
//! Append-only files are taken up to the length in the flight's SHA256SUMS, so that a bundle is one state with one digest
//! and can be read in pieces while the recorder continues.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::catalogue::{self, FlightRef, SeriesRef};
use super::installations;
use crate::disk::{Disk, StoreError, StoreResult};
use crate::format::append_file_kinds::APPEND_FILE_KINDS;
use crate::format::manifest::Counter;
use crate::format::{jsonl, layout, sha256_hex, sums};

/// File of a bundle.
#[derive(Clone, Debug, PartialEq)]
pub struct BundleFile {
    /// Path from the store's root, with `/`.
    pub name: String,
    /// Length, bytes.
    pub length: u64,
    /// SHA-256 of the file, hex.
    pub sha256: String,
    pub content: BundleContent,
}

/// Source of a file's bytes.
#[derive(Clone, Debug, PartialEq)]
pub enum BundleContent {
    /// First `length` bytes of this file.
    File(PathBuf),
    /// Bytes in memory.
    Bytes(Vec<u8>),
}

/// Files of a flight in the order in which they are written, and their digest.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightBundle {
    /// Files with unique names.
    pub items: Vec<BundleFile>,
    /// SHA-256 over names, lengths and digests, hex.
    pub digest: String,
}

/// Builds the bundle of a flight.
///
/// # Errors
/// Returns an error if a file is missing, a link, or shorter than recorded.
pub fn bundle_flight(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> StoreResult<FlightBundle> {
    let mut gather = BundleBuilder {
        disk,
        root,
        items: Vec::new(),
        counter: Counter::FIRST,
    };
    gather.add_small_file(Path::new(layout::STORE_FILE))?;
    match catalogue::store_id(disk, root) {
        Some(_) => gather.add_chained_flight(flight)?,
        None => gather.add_unchained_flight(flight)?,
    }
    gather.counter.advance_past(&flight.id);
    let path = Path::new(layout::COUNTER_FILE);
    let counter = jsonl::encode_line(&gather.counter).map_err(StoreError::io(path, "write"))?;
    gather.add_file_from_bytes(path, counter);
    let line = |item: &BundleFile| format!("{} {} {}\n", item.sha256, item.length, item.name);
    let digest = sha256_hex(gather.items.iter().map(line).collect::<String>().as_bytes());
    Ok(FlightBundle {
        items: gather.items,
        digest,
    })
}

struct BundleBuilder<'a> {
    disk: &'a dyn Disk,
    root: &'a Path,
    items: Vec<BundleFile>,
    /// Next ids after those in the bundle, as if the store had nothing else.
    counter: Counter,
}

impl BundleBuilder<'_> {
    /// Adds a flight as listed in its sums, which cover the chain up to `end`.
    fn add_chained_flight(&mut self, flight: &FlightRef) -> StoreResult<()> {
        let place = Path::new(layout::FLIGHTS).join(&flight.id);
        let sums_name = place.join(layout::SUMS_FILE);
        let sums_bytes = self.read_file(&sums_name)?;
        let (bytes, chain) = catalogue::read_chain(self.disk, &flight.folder)?;
        let sums = sums::parse_sums(&sums_bytes).unwrap_or_default();
        let end = sums::covered_chain_length(&sums, &bytes, &chain).ok_or_else(|| {
            self.damaged_file_error(&sums_name, "does not belong to this flight's chain")
        })?;
        let state = chain.state_at(end);
        for digest in &state.installations {
            self.add_installation(digest)?;
        }
        self.add_small_file(&place.join(layout::FLIGHT_FILE))?;
        for id in state.series.keys() {
            let results = state.results.get(id).and_then(|entries| entries.last());
            self.add_series(
                flight,
                id,
                results.map(|(length, sha256)| (*length, sha256.clone())),
            )?;
        }
        for (file, (length, digest)) in &state.files {
            self.add_closed_file(&place.join(file), *length, digest)?;
        }
        let chain = bytes.get(..end).unwrap_or_default().to_vec();
        self.add_file_from_bytes(&place.join(layout::CHAIN_FILE), chain);
        self.add_file_from_bytes(&sums_name, sums_bytes);
        Ok(())
    }

    /// Adds a flight of format 1 as it is on disk; results without a torn tail.
    fn add_unchained_flight(&mut self, flight: &FlightRef) -> StoreResult<()> {
        let place = Path::new(layout::FLIGHTS).join(&flight.id);
        self.add_small_file(&place.join(layout::FLIGHT_FILE))?;
        for kind in APPEND_FILE_KINDS {
            for file in catalogue::closed_files(self.disk, flight, kind)? {
                let bytes = self.disk.load_file(&flight.folder.join(&file))?;
                self.add_closed_file(&place.join(file), bytes.len() as u64, &sha256_hex(&bytes))?;
            }
        }
        for series in catalogue::list_series(self.disk, flight)? {
            let results = self
                .disk
                .load_if_exists(&series.folder.join(layout::RESULTS_FILE))?
                .map(|bytes| {
                    let good = jsonl::parse_lines::<serde_json::Value>(&bytes).good_length;
                    (
                        good as u64,
                        sha256_hex(bytes.get(..good).unwrap_or_default()),
                    )
                });
            self.add_series(flight, &series.id, results)?;
        }
        Ok(())
    }

    /// Adds manifest, frames, and the given length of the results of a series.
    fn add_series(
        &mut self,
        flight: &FlightRef,
        id: &str,
        results: Option<(u64, String)>,
    ) -> StoreResult<()> {
        self.counter.advance_past(id);
        let place = Path::new(layout::FLIGHTS).join(&flight.id).join(id);
        self.add_small_file(&place.join(layout::SERIES_FILE))?;
        let series = SeriesRef {
            flight: flight.id.clone(),
            id: id.to_owned(),
            folder: self.root.join(&place),
        };
        let list = self.disk.list_entries(&series.folder)?;
        let lengths: BTreeMap<&str, u64> = list
            .iter()
            .filter(|e| !e.is_dir)
            .map(|e| (e.name.as_str(), e.length))
            .collect();
        let shots = catalogue::read_series_manifest(self.disk, &series)?.shots;
        let frames = shots.into_iter().filter_map(|shot| shot.frame);
        let frames = frames.filter(|frame| layout::is_frame_name(&frame.file));
        let files = frames.map(|frame| (frame.file, frame.bytes, frame.sha256));
        let results =
            results.map(|(length, sha256)| (layout::RESULTS_FILE.to_owned(), length, sha256));
        for (file, length, sha256) in files.chain(results) {
            let name = place.join(&file);
            let grows = file == layout::RESULTS_FILE;
            match lengths.get(file.as_str()) {
                Some(there) if *there == length || (grows && *there > length) => {
                    self.push_file(
                        &name,
                        length,
                        sha256,
                        BundleContent::File(self.root.join(&name)),
                    );
                }
                Some(_) => {
                    return Err(self.damaged_file_error(&name, "does not have the recorded length"));
                }
                None => return Err(self.damaged_file_error(&name, "is missing or a link")),
            }
        }
        Ok(())
    }

    /// Adds a closed file with the length in the chain.
    fn add_closed_file(&mut self, name: &Path, length: u64, digest: &str) -> StoreResult<()> {
        let path = self.root.join(name);
        if self.disk.file_length(&path)? != Some(length) {
            return Err(self.damaged_file_error(
                name,
                "is missing, is a link, or does not have the recorded length",
            ));
        }
        self.push_file(name, length, digest.to_owned(), BundleContent::File(path));
        Ok(())
    }

    fn add_installation(&mut self, digest: &str) -> StoreResult<()> {
        if let Some((path, problem)) = installations::find_fault(self.disk, self.root, digest) {
            return Err(StoreError::Damaged {
                path,
                problem,
                remedy: BUNDLE_REMEDY,
            });
        }
        let folder = installations::installation_folder(self.root, digest);
        for entry in self.disk.list_entries(&folder)? {
            self.add_small_file(
                &Path::new(layout::INSTALLATIONS)
                    .join(digest)
                    .join(entry.name),
            )?;
        }
        Ok(())
    }

    /// Adds a small file, reading it immediately.
    fn add_small_file(&mut self, name: &Path) -> StoreResult<()> {
        let bytes = self.read_file(name)?;
        self.add_file_from_bytes(name, bytes);
        Ok(())
    }

    /// Reads a small file of the store that must exist and not be a link.
    fn read_file(&self, name: &Path) -> StoreResult<Vec<u8>> {
        let path = self.root.join(name);
        match self.disk.file_length(&path)? {
            Some(_) => self.disk.load_file(&path),
            None => Err(self.damaged_file_error(name, "is missing or a link")),
        }
    }

    fn add_file_from_bytes(&mut self, name: &Path, bytes: Vec<u8>) {
        self.push_file(
            name,
            bytes.len() as u64,
            sha256_hex(&bytes),
            BundleContent::Bytes(bytes),
        );
    }

    fn push_file(&mut self, name: &Path, length: u64, sha256: String, content: BundleContent) {
        let name = name.to_string_lossy().into_owned();
        self.items.push(BundleFile {
            name,
            length,
            sha256,
            content,
        });
    }

    fn damaged_file_error(&self, name: &Path, problem: &str) -> StoreError {
        StoreError::Damaged {
            path: self.root.join(name),
            problem: problem.to_owned(),
            remedy: BUNDLE_REMEDY,
        }
    }
}

const BUNDLE_REMEDY: &str =
    "run `wingd verify` for other damage; intact files can be copied individually";
