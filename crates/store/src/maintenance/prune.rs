//! Deletion of flights that are proven to be elsewhere: the only code that removes recorded data.
//!
//! After a line in `pruned.jsonl`, one rename moves the flight to `pruned/`; only then its files are removed. If this is
//! interrupted at any step, the flight is either complete in its place or gone.

use std::path::Path;

use super::verify;
use crate::disk::{Disk, StoreError, StoreResult};
use crate::format::manifest::PrunedFlight;
use crate::format::{jsonl, layout, sha256_hex, sums};
use crate::read::catalogue;
use crate::read::catalogue::FlightRef;
use crate::read::installations;
use crate::write::store::Store;

/// Result of comparing a flight with a copy.
#[derive(Clone, Debug, PartialEq)]
pub enum CopyProof {
    /// Every byte of the flight is in the copy.
    Verified {
        /// SHA-256 of the flight's `SHA256SUMS`.
        sums_sha256: String,
        /// Size of the flight.
        bytes: u64,
    },
    /// Reason for keeping the flight, one sentence.
    Unverified(String),
}

/// Verifies that every byte of a flight is in a copy, reading the copy back.
pub fn verify_copy(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
    copy: &Path,
) -> StoreResult<CopyProof> {
    let stays = |why: &str| Ok(CopyProof::Unverified(why.to_owned()));
    let Some(id) = catalogue::store_id(disk, root) else {
        return stays("the store has format 1, without chains and sums");
    };
    if is_same_path(root, copy) {
        return stays("the copy is the store itself");
    }
    match catalogue::store_id(disk, copy) {
        None => return stays("there is no copy, or it is no store"),
        Some(other) if other != id => return stays("the copy belongs to another store"),
        Some(_) => {}
    }
    let there = FlightRef {
        id: flight.id.clone(),
        folder: layout::flight_folder(copy, &flight.id),
    };
    let sums_of = |flight: &FlightRef| {
        disk.read(&flight.folder.join(layout::SUMS_FILE))
            .unwrap_or_default()
    };
    let (here_sums, there_sums) = (sums_of(flight), sums_of(&there));
    let (bytes, chain) = catalogue::read_chain(disk, &flight.folder)?;
    let listed = sums::parse_sums(&here_sums).unwrap_or_default();
    if sums::covered_chain_length(&listed, &bytes, &chain) != Some(bytes.len()) {
        return stays("its SHA256SUMS do not cover its chain yet");
    }
    if there_sums != here_sums || catalogue::read_chain(disk, &there.folder)?.0 != bytes {
        return stays("the copy is missing, older, or has another state of the flight");
    }
    let report = verify::verify_path(disk, &there.folder);
    if let Some(fault) = report.faults.first() {
        return Ok(CopyProof::Unverified(format!(
            "the copy is not sound: {}: {}",
            fault.path.display(),
            fault.what
        )));
    }
    for digest in &chain.state_at(usize::MAX).installations {
        if let Some((path, problem)) = installations::find_fault(disk, copy, digest) {
            return Ok(CopyProof::Unverified(format!(
                "the copy is not sound: {}: {problem}",
                path.display()
            )));
        }
    }
    Ok(CopyProof::Verified {
        sums_sha256: sha256_hex(&here_sums),
        bytes: disk
            .walk(&flight.folder, 2)
            .iter()
            .map(|(_, entry)| entry.length)
            .sum(),
    })
}

fn is_same_path(one: &Path, other: &Path) -> bool {
    let real = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    real(one) == real(other)
}

impl Store {
    /// Deletes a flight if a copy has every byte; otherwise returns the reason for keeping it.
    pub fn prune_flight(&self, flight: &FlightRef, copy: &Path) -> StoreResult<CopyProof> {
        let mut index = self.lock_index();
        let (disk, root) = (self.disk(), self.root());
        let proof = verify_copy(disk, root, flight, copy)?;
        let CopyProof::Verified { sums_sha256, bytes } = &proof else {
            return Ok(proof);
        };
        let line = PrunedFlight {
            flight: catalogue::read_flight_manifest(disk, flight)?,
            sums_sha256: sums_sha256.clone(),
            copy: copy.to_owned(),
            bytes: *bytes,
        };
        let log = root.join(layout::PRUNED_FILE);
        let line = jsonl::encode_line(&line).map_err(StoreError::io(&log, "write"))?;
        disk.append(&log, &line)
            .map_err(StoreError::io(&log, "write"))?;
        self.store_root().ensure_dir(layout::PRUNED)?;
        disk.sync_directory(root)?;
        disk.move_durably(&flight.folder, &root.join(layout::PRUNED).join(&flight.id))?;
        index.unsealed.remove(&flight.id);
        if index.flight.as_ref() == Some(&flight.id) {
            index.flight = None;
        }
        drop(index);
        self.remove_pruned()?;
        Ok(proof)
    }

    /// Removes the remains of an interrupted pruning.
    pub fn remove_pruned(&self) -> StoreResult<()> {
        let (disk, root) = (self.disk(), self.root());
        let pruned = root.join(layout::PRUNED);
        if !disk.exists(&pruned) {
            return Ok(());
        }
        for entry in disk.list_entries(&pruned)? {
            disk.remove_tree(&pruned.join(&entry.name))?;
        }
        disk.sync_directory(&pruned)
    }
}
