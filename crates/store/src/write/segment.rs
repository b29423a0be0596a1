//! Open append-only files of a flight: aircraft data, live results, manual marks.
//!
//! The open file is in the root, because the recovery of `incoming/` must not touch it. Its first line names the flight. It
//! is closed by its line in the chain, then moved to the flight by one rename.

use std::path::PathBuf;
use std::sync::Mutex;

use sha2::{Digest, Sha256};

use super::chain;
use super::recover::Recovery;
use super::root::StoreRoot;
use crate::disk::StoreResult;
use crate::format::append_file_kinds::AppendFileKind;
use crate::format::chain::ClosedFile;
use crate::format::{layout, sha256_hex};
use crate::read::catalogue;
use crate::read::catalogue::FlightRef;

/// File that this process has begun. After any write error it is abandoned, and closed before the next one begins.
pub(super) struct OpenSegment {
    pub flight: String,
    /// Common properties of all pieces; a change begins a new file.
    pub descriptor: Vec<u8>,
    pub length: usize,
    pub hasher: Sha256,
    /// Tag of the last piece.
    pub tag: [u8; 32],
}

/// Open file of a kind, if there is one.
pub(super) struct AppendFile {
    pub kind: &'static AppendFileKind,
    pub open: Mutex<Option<OpenSegment>>,
}

/// Bytes to append.
pub(super) struct AppendPiece {
    pub bytes: Vec<u8>,
    /// Tag that the next piece receives.
    pub tag: [u8; 32],
}

impl AppendFile {
    /// Creates a writer without an open file.
    pub fn new(kind: &'static AppendFileKind) -> Self {
        Self {
            kind,
            open: Mutex::default(),
        }
    }
}

impl OpenSegment {
    /// Adds a written piece to length and digest.
    pub fn add_piece(&mut self, piece: &AppendPiece) {
        self.length += piece.bytes.len();
        self.hasher.update(&piece.bytes);
        self.tag = piece.tag;
    }
}

/// Returns the length of the files of a kind on the disk, bytes.
pub(super) fn recorded_bytes(root: StoreRoot<'_>, kind: &AppendFileKind) -> StoreResult<u64> {
    let mut files = vec![root.join(kind.open_name)];
    for flight in catalogue::list_flights(root.disk, root.path)? {
        let closed = catalogue::closed_files(root.disk, &flight, kind)?;
        files.extend(closed.iter().map(|file| flight.folder.join(file)));
    }
    let length = |file: &PathBuf| Ok(root.disk.file_length(file)?.unwrap_or(0));
    files.iter().map(length).sum()
}

/// Closes the files left by the last recorder into their flights, or sets them aside if that is not possible.
pub(super) fn settle_append_files(
    root: StoreRoot<'_>,
    kinds: &[&AppendFileKind],
    recovery: &mut Recovery,
) {
    for kind in kinds
        .iter()
        .filter(|kind| root.disk.exists(&root.join(kind.open_name)))
    {
        match close_leftover(root, kind) {
            Ok(Some(flight)) => recovery
                .remarks
                .push(format!("{flight}: its {} were closed", kind.label)),
            Ok(None) => recovery.set_aside.push(kind.open_name.to_owned()),
            Err(error) => recovery
                .remarks
                .push(format!("the {} could not be closed: {error}", kind.label)),
        }
    }
}

/// Closes a file in the root that may be incomplete. Sets it aside and returns `None` if nothing in it is intact or its
/// flight is gone.
pub(super) fn close_leftover(
    root: StoreRoot<'_>,
    kind: &AppendFileKind,
) -> StoreResult<Option<String>> {
    let path = root.join(kind.open_name);
    let bytes = root.disk.load_file(&path)?;
    let whole =
        (kind.intact_prefix)(&bytes).filter(|(_, flight)| layout::flight_number(flight).is_some());
    let found = whole.filter(|(_, flight)| root.disk.exists(&root.flight_folder(flight)));
    let Some((good, flight)) = found else {
        root.set_aside(
            &format!("{}-{}.torn", kind.stem, &sha256_hex(&bytes)[..8]),
            &bytes,
        )?;
        root.disk.remove(&path)?;
        root.disk.sync_directory(root.path)?;
        return Ok(None);
    };
    root.set_tail_aside(&format!("{flight}-{}-{good}.torn", kind.stem), &bytes, good)?;
    let whole = bytes.get(..good).unwrap_or_default();
    // Written again even if nothing is torn: after a failed fsync a file may show bytes that are not on the disk.
    root.disk.replace_file(&path, whole)?;
    commit_segment(root, kind, &flight, whole.len() as u64, sha256_hex(whole))?;
    Ok(Some(flight))
}

/// Adds a complete file to the flight's chain, once, and moves it there.
pub(super) fn commit_segment(
    root: StoreRoot<'_>,
    kind: &AppendFileKind,
    flight: &str,
    bytes: u64,
    sha256: String,
) -> StoreResult<()> {
    let flight = FlightRef {
        id: flight.to_owned(),
        folder: root.flight_folder(flight),
    };
    let files = catalogue::closed_files(root.disk, &flight, kind)?;
    let last = files
        .last()
        .and_then(|name| (kind.closed_number)(name))
        .unwrap_or(0);
    let file = (kind.closed_name)(last + 1);
    if root.has_evidence() {
        chain::ensure_event(
            root,
            &flight.folder,
            (kind.event)(ClosedFile {
                file: file.clone(),
                bytes,
                sha256,
            }),
        )?;
    }
    root.disk
        .move_durably(&root.join(kind.open_name), &flight.folder.join(file))
}
