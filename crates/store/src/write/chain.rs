//! Durable lines of a flight's chain.

use std::path::Path;

use super::root::StoreRoot;
use crate::disk::{Disk, StoreError, StoreResult};
use crate::format::chain::{
    ChainEvent, ChainLine, ZERO_DIGEST, last_line, line_digest, trim_torn_tail,
};
use crate::format::{jsonl, layout};
use crate::read::catalogue;

/// Length of the end of a chain that is read to append a line, bytes; a line has some 300.
const END_BYTES: u64 = 32 << 10;

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
    let there = read_end(root.disk, &path)?;
    let is_new = there.is_none();
    let (from, bytes) = there.unwrap_or_default();
    let good = trim_torn_tail(&bytes);
    let length = from + good.len() as u64;
    let name = flight.file_name().unwrap_or_default().to_string_lossy();
    if root.set_tail_aside(&format!("{name}-chain-{length}.torn"), &bytes, good.len())? {
        let before = root.disk.read_range(&path, 0, from as usize);
        before
            .and_then(|before| root.disk.replace_file_io(&path, &[&before, good].concat()))
            .map_err(StoreError::io(&path, "repair"))?;
    }
    let before = last_line(good).map_or_else(|| ZERO_DIGEST.to_owned(), line_digest);
    let event = event(&before);
    let line =
        jsonl::encode_line(&ChainLine { before, event }).map_err(StoreError::io(&path, "write"))?;
    root.disk.extend_file(&path, length, &line)?;
    if is_new {
        root.disk.sync_directory(flight)
    } else {
        Ok(())
    }
}

/// Reads the end of a chain from the beginning of a line, and the place of that line; `None` without a chain. An end without
/// an intact line is read with all lines before it.
fn read_end(disk: &dyn Disk, path: &Path) -> StoreResult<Option<(u64, Vec<u8>)>> {
    let Some(length) = disk.file_length(path)? else {
        return Ok(None);
    };
    let mut from = length.saturating_sub(END_BYTES);
    loop {
        let read = disk.read_range(path, from, (length - from) as usize);
        let mut bytes = read.map_err(StoreError::io(path, "read"))?;
        if from == 0 {
            return Ok(Some((0, bytes)));
        }
        let begin = memchr::memchr(b'\n', &bytes).map_or(bytes.len(), |at| at + 1);
        bytes.drain(..begin);
        if !trim_torn_tail(&bytes).is_empty() {
            return Ok(Some((from + begin as u64, bytes)));
        }
        from = 0;
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
