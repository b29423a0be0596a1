//! Durable lines of a flight's chain.

use std::path::Path;

use super::root::StoreRoot;
use crate::disk::{StoreError, StoreResult};
use crate::format::chain::{
    ChainEvent, ChainLine, ZERO_DIGEST, last_line, line_digest, trim_torn_tail,
};
use crate::format::{jsonl, layout};
use crate::read::catalogue;

/// Appends a line durably; a torn last line is set aside first.
pub(crate) fn append_event(
    root: StoreRoot<'_>,
    flight: &Path,
    event: ChainEvent,
) -> StoreResult<()> {
    append_event_with(root, flight, |_| event)
}

/// Appends a line that depends on the digest of the line before.
pub(crate) fn append_event_with(
    root: StoreRoot<'_>,
    flight: &Path,
    event: impl FnOnce(&str) -> ChainEvent,
) -> StoreResult<()> {
    let path = flight.join(layout::CHAIN_FILE);
    let there = root.disk.load_if_exists(&path)?;
    let bytes = there.as_deref().unwrap_or_default();
    let good = trim_torn_tail(bytes);
    let name = flight.file_name().unwrap_or_default().to_string_lossy();
    if root.set_tail_aside(
        &format!("{name}-chain-{}.torn", good.len()),
        bytes,
        good.len(),
    )? {
        root.disk
            .replace_file_io(&path, good)
            .map_err(StoreError::io(&path, "repair"))?;
    }
    let before = last_line(good).map_or_else(|| ZERO_DIGEST.to_owned(), line_digest);
    let event = event(&before);
    let line =
        jsonl::encode_line(&ChainLine { before, event }).map_err(StoreError::io(&path, "write"))?;
    root.disk.extend_file(&path, good.len(), &line)?;
    if there.is_none() {
        root.disk.sync_directory(flight)
    } else {
        Ok(())
    }
}

/// Ensures that the chain has an event, before its file is moved. A line left by a failed or interrupted call is written
/// again: after a failed fsync a file may show bytes that are not on the disk.
pub(crate) fn ensure_event(
    root: StoreRoot<'_>,
    flight: &Path,
    event: ChainEvent,
) -> StoreResult<()> {
    let (bytes, chain) = catalogue::read_chain(root.disk, flight)?;
    if chain.events.iter().any(|(_, known)| *known == event) {
        return root
            .disk
            .replace_file(&flight.join(layout::CHAIN_FILE), &bytes);
    }
    append_event(root, flight, event)
}
