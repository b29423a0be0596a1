//! A store without evidence (format 1) becomes one with it. Nothing of it is changed but `store.toml`.

use std::path::Path;
use std::sync::Arc;

use super::chain::{self, Event};
use super::disk::{self, Disk};
use super::error::StoreError;
use super::installations::{self, File};
use super::results::sha256;
use super::{FlightRef, Store, StoreConfig, catalogue, layout, opening, segment, sums, verify};

/// Gives a sound store an id, chains, sums and the installation that its results came from. The mark
/// comes last: broken off at any step, the store is still of the old format and can be upgraded again.
pub fn upgrade(disk: Arc<dyn Disk>, root: &Path, installation: Option<&[File]>) -> Result<(), StoreError> {
    // Opening takes the lock and recovers what a crash left.
    let (store, _) = Store::open(disk, StoreConfig::at(root))?;
    let disk = store.disk();
    if catalogue::store_id(disk, root).is_some() {
        return Ok(());
    }
    let begun = |fault: &verify::Fault| fault.invariant == 1 && fault.path.ends_with(layout::CHAIN_FILE);
    if let Some(fault) = verify::verify(disk, root).faults.iter().find(|fault| !begun(fault)) {
        return Err(StoreError::Damaged {
            path: fault.path.clone(),
            what: fault.what.clone(),
            mend: "mend it, or move it out of the store; damage is not sealed as if it were sound",
        });
    }
    let kept = installation.map(|files| installations::keep(disk, root, files)).transpose()?;
    let id = installations::random_id()?;
    for flight in catalogue::flights(disk, root)? {
        let bytes = history(disk, &flight, &id, kept.as_deref())?;
        let path = flight.folder.join(layout::CHAIN_FILE);
        let sums = flight.folder.join(layout::SUMS_FILE);
        if disk.exists(&sums) {
            disk.remove_file(&sums).map_err(StoreError::io(&sums, "remove"))?;
        }
        disk::replace(disk, &path, &bytes).map_err(StoreError::io(&path, "write"))?;
        sums::seal(disk, &flight.folder)?;
    }
    opening::write_mark(disk, root, &id)
}

/// The chain of what there is.
fn history(
    disk: &dyn Disk,
    flight: &FlightRef,
    id: &str,
    installation: Option<&str>,
) -> Result<Vec<u8>, StoreError> {
    let digest = |path: &Path| disk.read(path).map(|b| sha256(&b)).map_err(StoreError::io(path, "read"));
    let mut events = vec![Event::Flight {
        store: id.to_owned(),
        flight: flight.id.clone(),
        sha256: digest(&flight.folder.join(layout::FLIGHT_FILE))?,
    }];
    events.extend(installation.map(|sha256| Event::Installation { sha256: sha256.to_owned() }));
    for kind in segment::KINDS {
        for file in segment::files(disk, flight, kind)? {
            let path = flight.folder.join(&file);
            let bytes = disk.read(&path).map_err(StoreError::io(&path, "read"))?;
            events.push((kind.event)(file, bytes.len() as u64, sha256(&bytes)));
        }
    }
    for series in catalogue::series(disk, flight)? {
        let sha256_of_manifest = digest(&series.folder.join(layout::SERIES_FILE))?;
        events.push(Event::Series { series: series.id.clone(), sha256: sha256_of_manifest });
        let path = series.folder.join(layout::RESULTS_FILE);
        if !disk.exists(&path) {
            continue;
        }
        super::results::mend(disk, store_of(flight), &series.folder)?;
        let bytes = disk.read(&path).map_err(StoreError::io(&path, "read"))?;
        let (length, sha256) = (bytes.len() as u64, sha256(&bytes));
        events.push(Event::Results { series: series.id, bytes: length, sha256 });
    }
    let path = flight.folder.join(layout::CHAIN_FILE);
    chain::lines(events).map_err(StoreError::io(&path, "write"))
}

/// The store that a flight lies in.
fn store_of(flight: &FlightRef) -> &Path {
    flight.folder.parent().and_then(Path::parent).unwrap_or(Path::new("."))
}
