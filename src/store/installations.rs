//! `installations/<digest>/`: what results were computed from, kept so that they can be computed again.
//!
//! The digest is that of the folder's own SHA256SUMS, and follows from a result's provenance too.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use serde_json::{Map, Value};

use super::chain::{self, Chain, Event};
use super::disk::{self, Disk};
use super::error::StoreError;
use super::results::sha256;
use super::{FlightRef, layout, series, sums};

/// A file of an installation: its name in the folder, its bytes.
pub type File = (String, Vec<u8>);

/// `installations/<digest>`.
pub fn folder(root: &Path, digest: &str) -> PathBuf {
    root.join(layout::INSTALLATIONS).join(digest)
}

/// The digest of the installation that a result names; `None` where it names none.
pub fn named(provenance: &Map<String, Value>) -> Option<String> {
    let entry = |(key, value): (&String, &Value)| {
        let name = key.strip_suffix(".sha256").filter(|name| *name != "frame")?;
        Some((name.to_owned(), value.as_str()?.to_owned()))
    };
    let files: BTreeMap<String, String> = provenance.iter().filter_map(entry).collect();
    (!files.is_empty()).then(|| sha256(sums::text(&files).as_bytes()))
}

/// Keeps an installation durably and returns its digest. One that is there already stays.
pub(crate) fn keep(disk: &dyn Disk, root: &Path, files: &[File]) -> Result<String, StoreError> {
    let digests: BTreeMap<_, _> = files.iter().map(|(name, bytes)| (name.clone(), sha256(bytes))).collect();
    let text = sums::text(&digests);
    let digest = sha256(text.as_bytes());
    let place = folder(root, &digest);
    if disk.exists(&place) {
        return Ok(digest);
    }
    let mut parts = files.iter().map(|(name, _)| name);
    if let Some(name) = parts.find(|name| !is_plain(name)) {
        let what = format!("the installation's file {name:?} lies outside of its folder and is not kept");
        let mend = "copy it into the folder and name it there";
        return Err(StoreError::Damaged { path: PathBuf::from(name), what, mend });
    }
    let made = root.join(layout::INCOMING).join(&digest);
    if !disk.exists(&made) {
        disk.create_dir(&made).map_err(StoreError::io(&made, "create"))?;
    }
    let sums = (layout::SUMS_FILE.to_owned(), text.into_bytes());
    for (name, bytes) in files.iter().chain([&sums]) {
        let path = made.join(name);
        disk.write(&path, bytes).map_err(StoreError::io(&path, "write"))?;
    }
    disk.sync_dir(&made).map_err(StoreError::io(&made, "sync"))?;
    super::opening::ensure_dir(disk, root, layout::INSTALLATIONS)?;
    series::move_durably(disk, &made, &place)?;
    Ok(digest)
}

/// A name without a folder, and not one of ours.
fn is_plain(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    let plain = matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None));
    plain && name != layout::SUMS_FILE
}

/// The installations that a flight's chain names, the last one last; none without evidence.
pub fn of_flight(disk: &dyn Disk, flight: &FlightRef) -> Result<Vec<String>, StoreError> {
    let chain = Chain::parse(&chain::read(disk, &flight.folder)?);
    let installation = |(_, event)| match event {
        Event::Installation { sha256 } => Some(sha256),
        _ => None,
    };
    Ok(chain.events.into_iter().filter_map(installation).collect())
}

/// What is wrong with a kept installation; `None` where it is whole.
pub(crate) fn fault(disk: &dyn Disk, root: &Path, digest: &str) -> Option<(PathBuf, String)> {
    let place = folder(root, digest);
    if !disk.exists(&place) {
        return Some((place, "results were computed from this installation, and it is missing".to_owned()));
    }
    let path = place.join(layout::SUMS_FILE);
    let text = match disk.read(&path) {
        Ok(text) if sha256(&text) == digest => text,
        Ok(_) => return Some((path, "does not have the SHA-256 that is its folder's name".to_owned())),
        Err(error) => return Some((path, format!("cannot be read: {error}"))),
    };
    let files = std::str::from_utf8(&text).ok().and_then(sums::parse).unwrap_or_default();
    for (name, wanted) in &files {
        let path = place.join(name);
        match disk.read(&path) {
            Ok(bytes) if sha256(&bytes) == *wanted => {}
            Ok(_) => return Some((path, "does not have the SHA-256 of its SHA256SUMS".to_owned())),
            Err(error) => return Some((path, format!("cannot be read: {error}"))),
        }
    }
    let entries = disk.list(&place).unwrap_or_default();
    let strange = entries.into_iter().find(|e| e.name != layout::SUMS_FILE && !files.contains_key(&e.name));
    strange.map(|entry| (place.join(entry.name), "is not named in its SHA256SUMS".to_owned()))
}

/// The store's random name, made once: 128 bits, hex.
pub(crate) fn random_id() -> Result<String, StoreError> {
    let mut bytes = [0; 16];
    let path = Path::new("/dev/urandom");
    disk::random(&mut bytes).map_err(StoreError::io(path, "read"))?;
    Ok(hex::encode(bytes))
}
