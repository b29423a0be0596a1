//! Lines of a flight's chain, made durable.

use std::path::Path;

use super::root::Root;
use crate::store::disk::StoreError;
use crate::store::format::chain::{BEGINNING, Event, Link, digest, last_line, whole};
use crate::store::format::{jsonl, layout};
use crate::store::read::catalogue;

/// Appends a line durably; a torn last line is set aside first.
pub(crate) fn append(root: Root<'_>, flight: &Path, event: Event) -> Result<(), StoreError> {
    append_with(root, flight, |_| event)
}

/// The same with a line that depends on the digest of the one before.
pub(crate) fn append_with(
    root: Root<'_>,
    flight: &Path,
    event: impl FnOnce(&str) -> Event,
) -> Result<(), StoreError> {
    let path = flight.join(layout::CHAIN_FILE);
    let there = root.disk.load_if_there(&path)?;
    let bytes = there.as_deref().unwrap_or_default();
    let good = whole(bytes);
    let name = flight.file_name().unwrap_or_default().to_string_lossy();
    if root.set_tail_aside(&format!("{name}-chain-{}.torn", good.len()), bytes, good.len())? {
        root.disk.put_in_place(&path, good).map_err(StoreError::io(&path, "mend"))?;
    }
    let before = last_line(good).map_or_else(|| BEGINNING.to_owned(), digest);
    let event = event(&before);
    let line = jsonl::line(&Link { before, event }).map_err(StoreError::io(&path, "write"))?;
    root.disk.extend(&path, good.len(), &line)?;
    if there.is_none() { root.disk.sync(flight) } else { Ok(()) }
}

/// Notes what gets its place next. A line that is there already, of a call that failed or was broken off, is written
/// anew: after a failed fsync a file may show what is not on the disk.
pub(crate) fn note(root: Root<'_>, flight: &Path, event: Event) -> Result<(), StoreError> {
    let (bytes, chain) = catalogue::chain(root.disk, flight)?;
    if chain.events.iter().any(|(_, known)| *known == event) {
        return root.disk.replace(&flight.join(layout::CHAIN_FILE), &bytes);
    }
    append(root, flight, event)
}
