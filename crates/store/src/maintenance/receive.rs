//! Transfer of flights into another directory, for `wingd copy`.
//!
//! Received files are checked and made durable below `fetching/`. When all files of a flight have arrived they are moved to
//! their place, and `store.toml` is written last: an incomplete directory is not a store, and the next call continues from
//! there.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::verify::{self, VerifyReport};
use crate::disk::{Disk, Lock, StoreError, StoreResult};
use crate::format::manifest::Counter;
use crate::format::{layout, sha256_hex};
use crate::read::bundle::{BundleFile, FlightBundle};
use crate::read::catalogue;
use crate::write::opening;
use crate::write::root::StoreRoot;

/// File of a flight, as its sender lists it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ListedFile {
    /// Path from the store's root, with `/`.
    pub name: String,
    /// Length, bytes.
    pub length: u64,
    /// SHA-256 of the file, hex.
    pub sha256: String,
    /// Offset of the file in the flight's archive, bytes.
    #[serde(default)]
    pub offset: u64,
}

impl From<&BundleFile> for ListedFile {
    fn from(item: &BundleFile) -> Self {
        Self {
            name: item.name.clone(),
            length: item.length,
            sha256: item.sha256.clone(),
            offset: 0,
        }
    }
}

/// List of a flight's files in one state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Listing {
    pub flight: String,
    /// Digest of the list; the archive's ETag.
    pub digest: String,
    /// Files in the archive's order.
    pub items: Vec<ListedFile>,
}

impl Listing {
    /// Creates the listing of a local bundle.
    pub fn from_bundle(flight: &str, bundle: &FlightBundle) -> Self {
        let items = bundle.items.iter().map(ListedFile::from).collect();
        Self {
            flight: flight.to_owned(),
            digest: bundle.digest.clone(),
            items,
        }
    }

    /// Returns the total length of all files, bytes.
    pub fn total_bytes(&self) -> u64 {
        self.items.iter().map(|item| item.length).sum()
    }

    /// Returns an error sentence if a name leads out of the directory or cannot belong to the flight, or if lengths and
    /// offsets are not those of an archive.
    pub fn problem(&self) -> Option<String> {
        let here = |item: &&ListedFile| !is_bundle_name(&item.name, &self.flight);
        if let Some(item) = self.items.iter().find(here) {
            return Some(format!(
                "{:?} is not a file of flight {}",
                item.name, self.flight
            ));
        }
        let mut at = 0;
        for item in &self.items {
            let end = item
                .offset
                .checked_add(item.length)
                .filter(|_| item.offset >= at);
            let Some(end) = end else {
                return Some(format!(
                    "the offset or length of {} is impossible",
                    item.name
                ));
            };
            at = end;
        }
        None
    }
}

/// Returns whether a flight's bundle can contain a file of this name.
fn is_bundle_name(name: &str, flight: &str) -> bool {
    let plain = |part: &str| {
        !part.is_empty() && part != "." && part != ".." && !part.contains(['\\', '\0'])
    };
    let parts: Vec<&str> = name.split('/').collect();
    if layout::flight_number(flight).is_none() || !parts.iter().all(|part| plain(part)) {
        return false;
    }
    match parts.as_slice() {
        [file] => [layout::STORE_FILE, layout::COUNTER_FILE].contains(file),
        [layout::INSTALLATIONS, digest, _] => {
            digest.len() == 64 && digest.bytes().all(|b| b.is_ascii_hexdigit())
        }
        [layout::FLIGHTS, id, file] => *id == flight && layout::is_flight_file(file),
        [layout::FLIGHTS, id, series, file] => {
            let known = [layout::SERIES_FILE, layout::RESULTS_FILE].contains(file);
            *id == flight
                && layout::series_number(series).is_some()
                && (known || layout::is_frame_name(file))
        }
        _ => false,
    }
}

/// Receiving directory, locked against a recorder and another receiver.
pub struct Receiver<'a> {
    disk: &'a dyn Disk,
    root: PathBuf,
    _lock: Lock,
}

impl<'a> Receiver<'a> {
    /// Opens a directory that does not exist, is empty, a store, or an incomplete copy.
    pub fn open(disk: &'a dyn Disk, root: &Path) -> StoreResult<Self> {
        catalogue::refuse_links(disk, root)?;
        let begun = disk.exists(&root.join(layout::FETCHING));
        if !begun && !disk.exists(&root.join(layout::STORE_FILE)) {
            opening::make_root(disk, root)?;
            opening::refuse_foreign(disk, root)?;
        }
        let at = StoreRoot { disk, path: root };
        let lock = opening::lock_store(at)?;
        at.ensure_dir(layout::FETCHING)?;
        Ok(Self {
            disk,
            root: root.to_owned(),
            _lock: lock,
        })
    }

    fn store_root(&self) -> StoreRoot<'_> {
        StoreRoot {
            disk: self.disk,
            path: &self.root,
        }
    }

    /// Refuses a flight of another store, and removes the files that an attempt at another one left below `fetching/`.
    pub fn prepare_flight(&self, listing: &Listing) -> StoreResult<()> {
        let format_file = listing
            .items
            .iter()
            .find(|item| item.name == layout::STORE_FILE);
        let other = |path: &Path| {
            self.disk
                .read(path)
                .is_ok_and(|bytes| format_file.is_none_or(|file| sha256_hex(&bytes) != file.sha256))
        };
        let (here, staged) = (
            self.root.join(layout::STORE_FILE),
            self.staged_path(layout::STORE_FILE),
        );
        let half = !self.disk.exists(&here) && other(&staged);
        if other(&here) || half {
            let why = if half {
                "it has an incomplete copy of another store"
            } else {
                "it is a store other than the sender's"
            };
            return Err(StoreError::NotAStore {
                path: self.root.clone(),
                why: why.to_owned(),
            });
        }
        if other(&staged) {
            self.disk.remove_tree(&self.root.join(layout::FETCHING))?;
            self.store_root().ensure_dir(layout::FETCHING)?;
        }
        Ok(())
    }

    /// Returns the files that are not here yet. Frames are compared by length, because each was checked before it got its
    /// name; `thorough` reads all of them.
    pub fn missing_files<'l>(&self, listing: &'l Listing, thorough: bool) -> Vec<&'l ListedFile> {
        let there = |path: &Path, item: &ListedFile| {
            let frame = path
                .file_name()
                .is_some_and(|name| layout::is_frame_name(&name.to_string_lossy()));
            let length = self.disk.file_length(path).ok().flatten();
            let is_intact = || {
                let bytes = self.disk.read(path);
                bytes.is_ok_and(|bytes| sha256_hex(&bytes) == item.sha256)
            };
            length == Some(item.length) && (frame && !thorough || is_intact())
        };
        let here = |item: &&ListedFile| {
            item.name == layout::COUNTER_FILE
                || there(&self.root.join(&item.name), item)
                || there(&self.staged_path(&item.name), item)
        };
        listing.items.iter().filter(|item| !here(item)).collect()
    }

    fn staged_path(&self, name: &str) -> PathBuf {
        self.root.join(layout::FETCHING).join(name)
    }

    /// Returns an error if files of this length do not fit on the disk.
    pub fn require_space(&self, bytes: u64) -> StoreResult<()> {
        let free = self
            .disk
            .free_bytes(&self.root)
            .map_err(StoreError::io(&self.root, "measure"))?;
        if bytes <= free {
            return Ok(());
        }
        let (path, problem) = (
            self.root.clone(),
            format!("has {} MB free, {} MB are needed", free >> 20, bytes >> 20),
        );
        Err(StoreError::Damaged {
            path,
            problem,
            remedy: "make room, or check that the server is a wingd",
        })
    }

    /// Begins to receive a file.
    pub fn begin_file<'r>(&'r self, item: &'r ListedFile) -> StoreResult<ReceivedFile<'r>> {
        let path = self.staged_path(&item.name);
        self.make_parent_dirs_durably(&path)?;
        let part = path.with_file_name(format!(
            "{}{}",
            item.name.rsplit('/').next().unwrap_or_default(),
            layout::PART_ENDING
        ));
        Ok(ReceivedFile {
            receiver: self,
            item,
            part,
            path,
            length: 0,
            hasher: Sha256::new(),
        })
    }

    /// Stores the bytes of a file; returns an error if they do not match the listing.
    pub fn accept_file(&self, item: &ListedFile, bytes: &[u8]) -> StoreResult<()> {
        let mut file = self.begin_file(item)?;
        file.add(bytes)?;
        file.finish()
    }

    fn make_parent_dirs_durably(&self, path: &Path) -> StoreResult<()> {
        // What is here and no folder cannot be created: a link is not followed.
        let Some(folder) = path.parent().filter(|f| !self.disk.is_directory(f)) else {
            return Ok(());
        };
        self.make_parent_dirs_durably(folder)?;
        self.disk.make_dir(folder)?;
        self.disk
            .sync_directory(folder.parent().unwrap_or(Path::new(".")))
    }

    /// Moves a complete flight to its place.
    pub fn commit_flight(&self, listing: &Listing) -> StoreResult<()> {
        self.refuse_changed(listing)?;
        let format_file = self.root.join(layout::STORE_FILE);
        let staged_format_file = self.staged_path(layout::STORE_FILE);
        if self.disk.exists(&format_file) {
            self.disk.move_durably(&format_file, &staged_format_file)?;
        }
        self.store_root().ensure_folders()?;
        let mut touched = BTreeSet::new();
        for item in listing
            .items
            .iter()
            .filter(|i| i.name != layout::STORE_FILE)
        {
            let (from, to) = (self.staged_path(&item.name), self.root.join(&item.name));
            if self.disk.exists(&from) {
                self.make_parent_dirs_durably(&to)?;
                self.disk
                    .rename(&from, &to)
                    .map_err(StoreError::io(&to, "move to"))?;
                touched.extend(to.parent().map(Path::to_owned));
            }
        }
        touched
            .iter()
            .try_for_each(|folder| self.disk.sync_directory(folder))?;
        self.advance_counter(listing)?;
        self.disk.move_durably(&staged_format_file, &format_file)
    }

    /// Advances the counter past this flight and the flights that were already here.
    fn advance_counter(&self, listing: &Listing) -> StoreResult<()> {
        let here = self
            .disk
            .load_json::<Counter>(&self.root.join(layout::COUNTER_FILE));
        let mut counter = here.unwrap_or(Counter::FIRST);
        counter.advance_past(&listing.flight);
        listing
            .items
            .iter()
            .filter_map(|item| item.name.split('/').nth(2))
            .for_each(|id| counter.advance_past(id));
        opening::save_counter(self.store_root(), &counter)
    }

    /// Refuses to overwrite results that were added here.
    fn refuse_changed(&self, listing: &Listing) -> StoreResult<()> {
        let grows = |name: &str| [layout::RESULTS_FILE, layout::CHAIN_FILE].contains(&name);
        for item in listing
            .items
            .iter()
            .filter(|item| item.name.rsplit('/').next().is_some_and(grows))
        {
            let path = self.root.join(&item.name);
            let Some(here) = self.disk.load_if_exists(&path)? else {
                continue;
            };
            let arrived = self
                .disk
                .read(&self.staged_path(&item.name))
                .unwrap_or_else(|_| here.clone());
            if !arrived.starts_with(&here) {
                let problem =
                    "was changed here, for example by `wingd solve`, and is not overwritten"
                        .to_owned();
                return Err(StoreError::Damaged {
                    path,
                    problem,
                    remedy: "copy into another directory",
                });
            }
        }
        Ok(())
    }

    /// Verifies the complete directory and removes `fetching/`.
    pub fn finish(self) -> StoreResult<VerifyReport> {
        if self.disk.exists(&self.root.join(layout::STORE_FILE)) {
            self.disk.remove_tree(&self.root.join(layout::FETCHING))?;
            self.disk.sync_directory(&self.root)?;
        }
        Ok(verify::verify_path(self.disk, &self.root))
    }
}

/// File that is being received, piece by piece.
pub struct ReceivedFile<'r> {
    receiver: &'r Receiver<'r>,
    item: &'r ListedFile,
    part: PathBuf,
    path: PathBuf,
    length: u64,
    hasher: Sha256,
}

impl ReceivedFile<'_> {
    /// Returns the number of bytes that have not arrived.
    pub fn missing_bytes(&self) -> u64 {
        self.item.length.saturating_sub(self.length)
    }

    /// Adds the next bytes.
    pub fn add(&mut self, bytes: &[u8]) -> StoreResult<()> {
        let disk = self.receiver.disk;
        let written = if self.length == 0 {
            disk.write(&self.part, bytes)
        } else {
            disk.append(&self.part, bytes)
        };
        written.map_err(StoreError::io(&self.part, "write"))?;
        self.hasher.update(bytes);
        self.length += bytes.len() as u64;
        Ok(())
    }

    /// Gives the file its name; returns an error if the bytes do not match the listing.
    pub fn finish(self) -> StoreResult<()> {
        let Self {
            receiver,
            item,
            part,
            path,
            ..
        } = self;
        if self.length != item.length || hex::encode(self.hasher.finalize()) != item.sha256 {
            let problem = "was received with bytes that do not match its SHA-256".to_owned();
            let remedy = "try again; if it happens again, run `wingd verify` on the sender's store";
            return Err(StoreError::Damaged {
                path: receiver.root.join(&item.name),
                problem,
                remedy,
            });
        }
        if item.length == 0 {
            receiver.disk.save_file(&part, b"")?;
        }
        receiver
            .disk
            .rename(&part, &path)
            .map_err(StoreError::io(&path, "write"))?;
        receiver
            .disk
            .sync_directory(path.parent().unwrap_or(Path::new(".")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_lengths_are_refused() {
        let file = |name: &str, offset, length| ListedFile {
            name: name.into(),
            length,
            sha256: String::new(),
            offset,
        };
        let listing = |items| Listing {
            flight: "f0001".into(),
            digest: String::new(),
            items,
        };
        let problem = |second| listing(vec![file("store.toml", 512, 100), second]).problem();
        assert_eq!(problem(file("counter.json", 1536, 10)), None);
        assert!(problem(file("counter.json", u64::MAX - 5, 10)).is_some());
        assert!(problem(file("counter.json", 500, 10)).is_some(), "overlaps");
    }

    #[test]
    fn only_names_of_a_flights_bundle_are_taken() {
        let digest = "ab".repeat(32);
        for good in [
            "store.toml",
            "counter.json",
            "flights/f0001/SHA256SUMS",
            "flights/f0001/s000001/0001.jpg",
            "flights/f0001/s000001/results.jsonl",
            &format!("installations/{digest}/camera.toml"),
        ] {
            assert!(is_bundle_name(good, "f0001"), "{good}");
        }
        for bad in [
            "",
            "/etc/passwd",
            "../store.toml",
            "lock",
            "flights/f0002/flight.json",
            "flights/f0001/s000001/../../x",
            "flights/f0001/s000001/notes.txt",
            "flights/f0001/s1/0001.jpg",
            "installations/../camera.toml",
            &format!("installations/{digest}/.."),
            "flights/f0001/s000001/0001.jpg/",
        ] {
            assert!(!is_bundle_name(bad, "f0001"), "{bad}");
        }
    }
}
