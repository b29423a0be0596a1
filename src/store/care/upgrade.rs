//! A store without evidence (format 1) becomes one with it. Nothing of it is changed but `store.toml`.

use std::path::Path;
use std::sync::Arc;

use super::verify;
use crate::store::config::StoreConfig;
use crate::store::disk::{Disk, StoreError};
use crate::store::format::chain::{self, Appended, ClosedFile, Event};
use crate::store::format::kinds::KINDS;
use crate::store::format::{layout, sha256};
use crate::store::read::catalogue::{self, FlightRef};
use crate::store::read::installations::File;
use crate::store::write::root::Root;
use crate::store::write::store::Store;
use crate::store::write::{evidence, installations, opening, results};

/// Gives a sound store an id, chains, sums and the installation that its results came from. The mark
/// comes last: broken off at any step, the store is still of the old format and can be upgraded again.
pub fn upgrade(disk: Arc<dyn Disk>, root: &Path, installation: Option<&[File]>) -> Result<(), StoreError> {
    // Opening takes the lock and recovers what a crash left.
    let (store, _) = Store::open(disk, StoreConfig::at(root))?;
    let at = store.at();
    if at.has_evidence() {
        return Ok(());
    }
    let begun = |fault: &verify::Fault| fault.invariant == 1 && fault.path.ends_with(layout::CHAIN_FILE);
    if let Some(fault) = verify::verify(at.disk, root).faults.iter().find(|fault| !begun(fault)) {
        return Err(StoreError::Damaged {
            path: fault.path.clone(),
            what: fault.what.clone(),
            mend: "mend it, or move it out of the store; damage is not sealed as if it were sound",
        });
    }
    let kept = installation.map(|files| installations::keep(at, files)).transpose()?;
    let id = opening::random_id()?;
    for flight in catalogue::flights(at.disk, root)? {
        let bytes = history(at, &flight, &id, kept.as_deref())?;
        let sums = flight.folder.join(layout::SUMS_FILE);
        if at.disk.exists(&sums) {
            at.disk.remove(&sums)?;
        }
        at.disk.replace(&flight.folder.join(layout::CHAIN_FILE), &bytes)?;
        evidence::seal(at.disk, &flight.folder)?;
    }
    opening::write_mark(at, &id)
}

/// The chain of what there is.
fn history(
    root: Root<'_>,
    flight: &FlightRef,
    id: &str,
    installation: Option<&str>,
) -> Result<Vec<u8>, StoreError> {
    let disk = root.disk;
    let digest = |path: &Path| disk.load(path).map(|bytes| (bytes.len() as u64, sha256(&bytes)));
    let (_, sha256) = digest(&flight.folder.join(layout::FLIGHT_FILE))?;
    let mut events = vec![Event::Flight { store: id.to_owned(), flight: flight.id.clone(), sha256 }];
    events.extend(installation.map(|sha256| Event::Installation { sha256: sha256.to_owned() }));
    for kind in KINDS {
        for file in catalogue::files(disk, flight, kind)? {
            let (bytes, sha256) = digest(&flight.folder.join(&file))?;
            events.push((kind.event)(ClosedFile { file, bytes, sha256 }));
        }
    }
    for series in catalogue::series(disk, flight)? {
        let (_, sha256) = digest(&series.folder.join(layout::SERIES_FILE))?;
        events.push(Event::Series { series: series.id.clone(), sha256 });
        let path = series.folder.join(layout::RESULTS_FILE);
        if disk.exists(&path) {
            results::mend(root, &series.folder)?;
            let (bytes, sha256) = digest(&path)?;
            events.push(Event::Results(Appended { series: series.id, bytes, sha256 }));
        }
    }
    chain::lines(events).map_err(StoreError::io(&flight.folder.join(layout::CHAIN_FILE), "write"))
}
