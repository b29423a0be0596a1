//! Upgrade of a store without evidence (format 1). Only `store.toml` is changed, and evidence added.

use std::path::Path;
use std::sync::Arc;

use super::verify;
use crate::config::StoreConfig;
use crate::disk::{Disk, StoreError, StoreResult};
use crate::format::append_file_kinds::APPEND_FILE_KINDS;
use crate::format::chain::{self, ChainEvent, ClosedFile};
use crate::format::{layout, sha256_hex};
use crate::read::catalogue::{self, FlightRef};
use crate::read::installations::InstallationFile;
use crate::write::root::StoreRoot;
use crate::write::store::Store;
use crate::write::{evidence, installations, opening, results};

/// Adds id, chains, sums and the installation of the results to a sound store. The format file is written last: after an
/// interruption at any step the store still has the old format and can be upgraded again.
pub fn upgrade_store(
    disk: Arc<dyn Disk>,
    root: &Path,
    installation: Option<&[InstallationFile]>,
) -> StoreResult<()> {
    // Opening takes the lock and recovers the remains of a crash.
    let (store, _) = Store::open(disk, StoreConfig::new(root))?;
    let at = store.store_root();
    if at.has_evidence() {
        return Ok(());
    }
    let is_interrupted_upgrade = |fault: &verify::InvariantFault| {
        fault.invariant == 1 && fault.path.ends_with(layout::CHAIN_FILE)
    };
    if let Some(fault) = verify::verify_path(at.disk, root)
        .faults
        .iter()
        .find(|fault| !is_interrupted_upgrade(fault))
    {
        return Err(StoreError::Damaged {
            path: fault.path.clone(),
            problem: fault.what.clone(),
            remedy: "repair it, or move it out of the store; a damaged store is not upgraded",
        });
    }
    refuse_foreign_chains(at)?;
    let installation = installation
        .map(|files| installations::keep_installation(at, files))
        .transpose()?;
    let id = opening::random_id()?;
    for flight in catalogue::list_flights(at.disk, root)? {
        let bytes = build_chain(at, &flight, &id, installation.as_deref())?;
        let sums = flight.folder.join(layout::SUMS_FILE);
        if at.disk.exists(&sums) {
            at.disk.remove(&sums)?;
        }
        at.disk
            .replace_file(&flight.folder.join(layout::CHAIN_FILE), &bytes)?;
        evidence::update_sums(at.disk, &flight.folder)?;
    }
    opening::write_format_file(at, &id)
}

/// Refuses flights whose chain has more than an interrupted upgrade writes: it is evidence that a new one would destroy.
fn refuse_foreign_chains(root: StoreRoot<'_>) -> StoreResult<()> {
    for flight in catalogue::list_flights(root.disk, root.path)? {
        let (bytes, chain) = catalogue::read_chain(root.disk, &flight.folder)?;
        let Some(id) = chain.store_id() else { continue };
        let installation = chain.state_at(usize::MAX).installations.pop_first();
        if build_chain(root, &flight, &id, installation.as_deref())? != bytes {
            return Err(StoreError::Damaged {
                path: flight.folder.join(layout::CHAIN_FILE),
                problem: "is the chain of a store of format 2, which an upgrade would replace"
                    .to_owned(),
                remedy: "remove store.toml and start the recorder: it rebuilds it from the chains",
            });
        }
    }
    Ok(())
}

/// Builds the chain of the existing files.
fn build_chain(
    root: StoreRoot<'_>,
    flight: &FlightRef,
    id: &str,
    installation: Option<&str>,
) -> StoreResult<Vec<u8>> {
    let disk = root.disk;
    let digest = |path: &Path| {
        disk.load_file(path)
            .map(|bytes| (bytes.len() as u64, sha256_hex(&bytes)))
    };
    let (_, sha256) = digest(&flight.folder.join(layout::FLIGHT_FILE))?;
    let mut events = vec![ChainEvent::Flight {
        store: id.to_owned(),
        flight: flight.id.clone(),
        sha256,
    }];
    events.extend(installation.map(|sha256| ChainEvent::Installation {
        sha256: sha256.to_owned(),
    }));
    for kind in APPEND_FILE_KINDS {
        for file in catalogue::closed_files(disk, flight, kind)? {
            let (bytes, sha256) = digest(&flight.folder.join(&file))?;
            events.push((kind.event)(ClosedFile {
                file,
                bytes,
                sha256,
            }));
        }
    }
    for series in catalogue::list_series(disk, flight)? {
        let (_, sha256) = digest(&series.folder.join(layout::SERIES_FILE))?;
        events.push(ChainEvent::Series {
            series: series.id.clone(),
            sha256,
        });
        let path = series.folder.join(layout::RESULTS_FILE);
        if disk.exists(&path) {
            let results = results::repair_results(root, &series.folder)?;
            events.push(ChainEvent::Results(results.entry(&series.id)));
        }
    }
    chain::encode_chain(events).map_err(StoreError::io(
        &flight.folder.join(layout::CHAIN_FILE),
        "write",
    ))
}
