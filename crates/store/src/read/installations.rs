//! Stored installations, `installations/<digest>/`: inputs of results, kept so that the results can be computed again.
//!
//! The digest is the SHA-256 of the folder's own SHA256SUMS, and can be computed from a result's provenance.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::catalogue::{self, FlightRef};
use crate::disk::{Disk, StoreResult};
use crate::format::chain::ChainEvent;
use crate::format::{layout, sha256_hex, sums};

/// File of an installation: name in the folder, content.
pub type InstallationFile = (String, Vec<u8>);

/// Returns the path `installations/<digest>`.
pub fn installation_folder(root: &Path, digest: &str) -> PathBuf {
    root.join(layout::INSTALLATIONS).join(digest)
}

/// Computes the digest of the installation that a result was computed from; `None` if the provenance names none.
pub fn digest_from_provenance(provenance: &Map<String, Value>) -> Option<String> {
    let entry = |(key, value): (&String, &Value)| {
        let name = key
            .strip_suffix(".sha256")
            .filter(|name| *name != "frame")?;
        Some((name.to_owned(), value.as_str()?.to_owned()))
    };
    let files: BTreeMap<String, String> = provenance.iter().filter_map(entry).collect();
    (!files.is_empty()).then(|| sha256_hex(sums::format_sums(&files).as_bytes()))
}

/// Returns the digests of the installations in a flight's chain, the latest last; empty without evidence.
pub fn flight_installations(disk: &dyn Disk, flight: &FlightRef) -> StoreResult<Vec<String>> {
    let (_, chain) = catalogue::read_chain(disk, &flight.folder)?;
    let installation = |(_, event)| match event {
        ChainEvent::Installation { sha256 } => Some(sha256),
        _ => None,
    };
    Ok(chain.events.into_iter().filter_map(installation).collect())
}

/// Returns the path and description of an error in a stored installation; `None` if it is intact.
pub(crate) fn find_fault(disk: &dyn Disk, root: &Path, digest: &str) -> Option<(PathBuf, String)> {
    let place = installation_folder(root, digest);
    if !disk.exists(&place) {
        return Some((
            place,
            "results were computed from this installation, but it is missing".to_owned(),
        ));
    }
    let differs = |path: &Path, expected: &str, source: &str| match disk.read(path) {
        Ok(bytes) if sha256_hex(&bytes) == expected => None,
        Ok(_) => Some((
            path.to_owned(),
            format!("does not have the SHA-256 {source}"),
        )),
        Err(error) => Some((path.to_owned(), format!("cannot be read: {error}"))),
    };
    let path = place.join(layout::SUMS_FILE);
    if let Some(fault) = differs(&path, digest, "in its folder's name") {
        return Some(fault);
    }
    let files = sums::parse_sums(&disk.read(&path).unwrap_or_default()).unwrap_or_default();
    let fault = |(name, expected): (&String, &String)| {
        differs(&place.join(name), expected, "in its SHA256SUMS")
    };
    if let Some(fault) = files.iter().find_map(fault) {
        return Some(fault);
    }
    let entries = disk.list(&place).unwrap_or_default();
    let foreign = entries
        .into_iter()
        .find(|e| e.name != layout::SUMS_FILE && !files.contains_key(&e.name));
    foreign.map(|entry| {
        (
            place.join(entry.name),
            "is not named in its SHA256SUMS".to_owned(),
        )
    })
}
