//! Files of a flight that grow at their end and are then closed: the aircraft's data, live results.
//!
//! The file being written lies in the root, since recovering `incoming/` must not touch it. Its first line says whose
//! it is. It is closed by its line in the chain, then one rename to the flight.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use sha2::{Digest, Sha256};

use super::chain::{self, Chain, Event};
use super::disk::{self, Disk};
use super::error::StoreError;
use super::recover::Recovery;
use super::results::{set_aside, sha256};
use super::{FlightRef, Store, catalogue, layout, series};

/// A kind of such files.
#[derive(Debug)]
pub(crate) struct Kind {
    /// Name in the root.
    pub open: &'static str,
    /// In sentences.
    pub what: &'static str,
    /// Beginning of names below `partial/`.
    pub stem: &'static str,
    /// Names in a flight, by their number from 1.
    pub name: fn(u64) -> String,
    /// The number in such a name.
    pub number: fn(&str) -> Option<u64>,
    /// How many bytes are whole, and their flight; `None` where not even the first line is.
    pub whole: fn(&[u8]) -> Option<(usize, String)>,
    /// Its line in the chain.
    pub event: fn(String, u64, String) -> Event,
    /// Its invariant in docs/store.md.
    pub invariant: u8,
    /// Beyond this a file is closed and another one begun, bytes.
    pub longest: usize,
}

/// All kinds.
pub(crate) const KINDS: [&Kind; 2] = [&super::aircraft::KIND, &super::live::KIND];

/// A file that this process began. Whatever of its writing fails, it is given up, and closed before the next begins.
struct Segment {
    flight: String,
    /// What all of it is of.
    of: Vec<u8>,
    length: usize,
    hasher: Sha256,
    /// What the next piece follows from.
    tag: [u8; 32],
}

/// The file of a kind that is being written, if there is one.
pub(crate) struct Growing {
    kind: &'static Kind,
    open: Mutex<Option<Segment>>,
}

/// Bytes to append.
pub(crate) struct Piece {
    pub bytes: Vec<u8>,
    /// What the next piece follows from.
    pub tag: [u8; 32],
}

/// The closed files of a flight, in order.
pub(crate) fn files(disk: &dyn Disk, flight: &FlightRef, kind: &Kind) -> Result<Vec<String>, StoreError> {
    let list = disk.list(&flight.folder).map_err(StoreError::io(&flight.folder, "list"))?;
    let ours = list.into_iter().filter(|e| !e.is_dir && !e.is_link).map(|e| e.name);
    let mut numbered: Vec<(u64, String)> =
        ours.filter_map(|name| Some(((kind.number)(&name)?, name))).collect();
    numbered.sort();
    Ok(numbered.into_iter().map(|(_, name)| name).collect())
}

/// The closed files of a flight in order, then the one being written, which may be another flight's.
pub(crate) fn paths(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
    kind: &Kind,
) -> Result<Vec<PathBuf>, StoreError> {
    let mut all: Vec<PathBuf> =
        files(disk, flight, kind)?.into_iter().map(|file| flight.folder.join(file)).collect();
    let open = root.join(kind.open);
    all.extend(disk.exists(&open).then_some(open));
    Ok(all)
}

/// Whether a file that the chain has is the one in the root, which the next start moves to its flight.
pub(crate) fn is_under_way(
    disk: &dyn Disk,
    root: Option<&Path>,
    flight: &str,
    digest: &str,
    kind: &Kind,
) -> bool {
    let bytes = root.and_then(|root| disk.read(&root.join(kind.open)).ok());
    bytes.is_some_and(|b| sha256(&b) == digest && (kind.whole)(&b).is_some_and(|(_, id)| id == flight))
}

/// What the last recorder left: closed into its flight, or set aside where that is not possible.
pub(crate) fn settle(disk: &dyn Disk, root: &Path, recovery: &mut Recovery) {
    for kind in KINDS.into_iter().filter(|kind| disk.exists(&root.join(kind.open))) {
        match close_found(disk, root, kind) {
            Ok(Some(flight)) => recovery.remarks.push(format!("{flight}: its {} were closed", kind.what)),
            Ok(None) => recovery.set_aside.push(kind.open.to_owned()),
            Err(error) => recovery.remarks.push(format!("the {} stay where they are: {error}", kind.what)),
        }
    }
}

/// Closes a file in the root that this process does not know to be whole. `None` where nothing of it is, or its flight
/// is gone: it is set aside.
fn close_found(disk: &dyn Disk, root: &Path, kind: &Kind) -> Result<Option<String>, StoreError> {
    let path = root.join(kind.open);
    let bytes = disk.read(&path).map_err(StoreError::io(&path, "read"))?;
    let whole = (kind.whole)(&bytes).filter(|(_, flight)| layout::flight_number(flight).is_some());
    let found = whole.map(|(good, id)| {
        let folder = root.join(layout::FLIGHTS).join(&id);
        (good, FlightRef { id, folder })
    });
    let Some((good, flight)) = found.filter(|(_, flight)| disk.exists(&flight.folder)) else {
        set_aside(disk, root, &format!("{}-{}.torn", kind.stem, &sha256(&bytes)[..8]), &bytes)?;
        disk.remove_file(&path).map_err(StoreError::io(&path, "remove"))?;
        disk.sync_dir(root).map_err(StoreError::io(root, "sync"))?;
        return Ok(None);
    };
    if let Some(tail) = bytes.get(good..).filter(|tail| !tail.is_empty()) {
        set_aside(disk, root, &format!("{}-{}-{good}.torn", flight.id, kind.stem), tail)?;
    }
    let whole = bytes.get(..good).unwrap_or_default();
    // Written anew also where nothing is torn: after a failed fsync a file may show what is not on the disk.
    disk::replace(disk, &path, whole).map_err(StoreError::io(&path, "write"))?;
    conclude(disk, root, kind, &flight, whole.len() as u64, sha256(whole))?;
    Ok(Some(flight.id))
}

/// Notes a whole file in the flight's chain, once, and moves it there.
fn conclude(
    disk: &dyn Disk,
    root: &Path,
    kind: &Kind,
    flight: &FlightRef,
    bytes: u64,
    sha256: String,
) -> Result<(), StoreError> {
    let last = files(disk, flight, kind)?.last().and_then(|name| (kind.number)(name)).unwrap_or(0);
    let file = (kind.name)(last + 1);
    if catalogue::store_id(disk, root).is_some() {
        let event = (kind.event)(file.clone(), bytes, sha256);
        let known = chain::read(disk, &flight.folder)?;
        if Chain::parse(&known).events.iter().any(|(_, there)| *there == event) {
            let path = flight.folder.join(layout::CHAIN_FILE);
            disk::replace(disk, &path, &known).map_err(StoreError::io(&path, "write"))?;
        } else {
            chain::append(disk, root, &flight.folder, event)?;
        }
    }
    series::move_durably(disk, &root.join(kind.open), &flight.folder.join(file))
}

impl Growing {
    pub(crate) fn new(kind: &'static Kind) -> Self {
        Self { kind, open: Mutex::default() }
    }

    /// Appends a piece durably. `of` is what all of a file is of: another one closes the file and begins one with
    /// `first`, as does one that is too long. `piece` gets what it follows from.
    pub(crate) fn append(
        &self,
        store: &Store,
        flight: &str,
        of: Vec<u8>,
        first: impl FnOnce() -> std::io::Result<Piece>,
        piece: impl FnOnce([u8; 32]) -> std::io::Result<Piece>,
    ) -> Result<(), StoreError> {
        let path = store.root().join(self.kind.open);
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if open.as_ref().is_some_and(|s| s.of != of || s.flight != flight || s.length > self.kind.longest) {
            self.close_open(store, &mut open)?;
        }
        let mut segment = match open.take() {
            Some(segment) => segment,
            None => self.begin(store, flight, of, first)?,
        };
        // Bytes that cannot be made are no fault of the file.
        let piece = match piece(segment.tag) {
            Ok(piece) => piece,
            Err(error) => {
                *open = Some(segment);
                return Err(StoreError::io(&path, "write")(error));
            }
        };
        let appended = disk::append(store.disk(), &path, segment.length, &piece.bytes);
        appended.map_err(StoreError::io(&path, "write"))?;
        segment.grow(&piece);
        *open = Some(segment);
        Ok(())
    }

    /// One that a failure left is closed first.
    fn begin(
        &self,
        store: &Store,
        flight: &str,
        of: Vec<u8>,
        first: impl FnOnce() -> std::io::Result<Piece>,
    ) -> Result<Segment, StoreError> {
        let (disk, path) = (store.disk(), store.root().join(self.kind.open));
        if disk.exists(&path) {
            self.close_open(store, &mut None)?;
        }
        let first = first().map_err(StoreError::io(&path, "write"))?;
        disk.write(&path, &first.bytes).map_err(StoreError::io(&path, "write"))?;
        disk.sync_dir(store.root()).map_err(StoreError::io(store.root(), "sync"))?;
        let mut segment =
            Segment { flight: flight.to_owned(), of, length: 0, hasher: Sha256::new(), tag: first.tag };
        segment.grow(&first);
        Ok(segment)
    }

    /// Closes what is open, so that the flight's sums cover it.
    pub(crate) fn close(&self, store: &Store) -> Result<(), StoreError> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let left = store.disk().exists(&store.root().join(self.kind.open));
        if open.is_some() || left { self.close_open(store, &mut open) } else { Ok(()) }
    }

    /// Whatever comes of it the next piece begins a file of its own.
    fn close_open(&self, store: &Store, open: &mut Option<Segment>) -> Result<(), StoreError> {
        let (disk, root) = (store.disk(), store.root());
        let segment = open.take();
        let mut index = store.index();
        let flight = match segment {
            // Every byte of it was answered for: it need not be read.
            Some(Segment { flight, length, hasher, .. }) => {
                let folder = root.join(layout::FLIGHTS).join(&flight);
                let flight = FlightRef { id: flight, folder };
                conclude(disk, root, self.kind, &flight, length as u64, hex::encode(hasher.finalize()))?;
                Some(flight.id)
            }
            None => close_found(disk, root, self.kind)?,
        };
        index.unsealed.extend(flight);
        store.seal_all(&mut index);
        Ok(())
    }
}

impl Segment {
    fn grow(&mut self, piece: &Piece) {
        self.length += piece.bytes.len();
        self.hasher.update(&piece.bytes);
        self.tag = piece.tag;
    }
}
