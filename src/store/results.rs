//! Results: one line for each frame and inputs, written once.

use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

use super::chain::{self, Event};
use super::disk::{self, Disk};
use super::error::StoreError;
use super::manifest::ResultLine;
use super::{SeriesRef, catalogue, jsonl, layout};

/// SHA-256, hex.
pub fn sha256(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

/// What a result is computed from, the frame apart: digests of the installation, program version, parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Inputs {
    /// As it goes into the result's line.
    pub provenance: Map<String, Value>,
    canonical: String,
}

impl Inputs {
    /// The order of the keys does not matter.
    pub fn new(provenance: Map<String, Value>) -> Self {
        let mut canonical = String::new();
        write_canonical(&Value::Object(provenance.clone()), &mut canonical);
        Self { provenance, canonical }
    }

    /// The key under which a frame's result is written once.
    pub fn key(&self, frame_sha256: &str) -> String {
        sha256(format!("{frame_sha256}\n{}", self.canonical).as_bytes())
    }
}

/// JSON with sorted keys and no spaces.
fn write_canonical(value: &Value, out: &mut String) {
    match value {
        Value::Object(map) => {
            let mut keys: Vec<&String> = map.keys().collect();
            keys.sort();
            out.push('{');
            for key in keys {
                out.push_str(&Value::String(key.clone()).to_string());
                out.push(':');
                write_canonical(map.get(key).unwrap_or(&Value::Null), out);
                out.push(',');
            }
            out.push('}');
        }
        Value::Array(items) => {
            out.push('[');
            for item in items {
                write_canonical(item, out);
                out.push(',');
            }
            out.push(']');
        }
        plain => out.push_str(&plain.to_string()),
    }
}

/// The identity of a result, without its numbers.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub(crate) struct ResultKey {
    pub frame: String,
    pub inputs: String,
}

/// The keys of a series' results; empty where there are none.
pub(crate) fn keys(disk: &dyn Disk, series: &Path) -> Result<Vec<ResultKey>, StoreError> {
    let bytes = written(disk, &series.join(layout::RESULTS_FILE))?;
    Ok(jsonl::parse(&bytes).good.into_iter().map(|(_, key)| key).collect())
}

/// `pending.json`: what `results.jsonl` of a series is about to become.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Pending {
    pub flight: String,
    pub series: String,
    pub bytes: u64,
    pub sha256: String,
}

/// What is pending; `None` where nothing is, or the file is torn and nothing was begun yet.
pub(crate) fn pending(disk: &dyn Disk, root: &Path) -> Option<Pending> {
    disk.read(&root.join(layout::PENDING_FILE)).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok())
}

/// After a crash between a result and its line in the chain: a result that is whole gets its line, half
/// of one is set aside. Before the next one is announced, or nothing would speak for the bytes.
pub(crate) fn settle(disk: &dyn Disk, root: &Path) -> Result<(), StoreError> {
    let Some(pending) = pending(disk, root) else { return Ok(()) };
    if layout::flight_number(&pending.flight).and(layout::series_number(&pending.series)).is_none() {
        return Ok(());
    }
    let flight = root.join(layout::FLIGHTS).join(&pending.flight);
    let folder = flight.join(&pending.series);
    let Ok(written) = disk.read(&folder.join(layout::RESULTS_FILE)) else { return Ok(()) };
    let wanted = Some((pending.bytes, pending.sha256.clone()));
    if chain::last_results(&chain::read(disk, &flight)?, &pending.series) == wanted {
        return Ok(());
    }
    if written.len() as u64 != pending.bytes || sha256(&written) != pending.sha256 {
        return mend(disk, root, &folder);
    }
    // The file may be new, and its name not on the medium yet.
    disk.sync_dir(&folder).map_err(StoreError::io(&folder, "sync"))?;
    let Pending { series, bytes, sha256, .. } = pending;
    chain::append(disk, root, &flight, Event::Results { series, bytes, sha256 })
}

/// Appends a result durably (`false` where there is one already): a torn last line is set aside, what
/// will be there is written to `pending.json`, the line to the results, its digest to the chain.
pub(crate) fn append(
    disk: &dyn Disk,
    root: &Path,
    place: &SeriesRef,
    line: &ResultLine,
) -> Result<bool, StoreError> {
    let series = place.folder.as_path();
    let chained = catalogue::store_id(disk, root).is_some();
    let path = series.join(layout::RESULTS_FILE);
    if chained {
        settle(disk, root)?;
    }
    if disk.exists(&path) {
        mend(disk, root, series)?;
    }
    let before = written(disk, &path)?;
    let keys = jsonl::parse::<ResultKey>(&before).good;
    if keys.iter().any(|(_, key)| key.frame == line.frame && key.inputs == line.inputs) {
        return Ok(false);
    }
    let bytes = jsonl::line(line).map_err(StoreError::io(&path, "write"))?;
    let pending = if chained { Some(announce(disk, root, place, &before, &bytes)?) } else { None };
    disk::append(disk, &path, before.len(), &bytes).map_err(StoreError::io(&path, "write"))?;
    if before.is_empty() {
        disk.sync_dir(series).map_err(StoreError::io(series, "sync"))?;
    }
    if let Some(Pending { flight, series, bytes, sha256 }) = pending {
        let flight = root.join(layout::FLIGHTS).join(flight);
        chain::append(disk, root, &flight, Event::Results { series, bytes, sha256 })?;
    }
    Ok(true)
}

/// A file's bytes; none where there is no file.
fn written(disk: &dyn Disk, path: &Path) -> Result<Vec<u8>, StoreError> {
    match disk.read(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        read => read.map_err(StoreError::io(path, "read")),
    }
}

/// Writes `pending.json`.
fn announce(
    disk: &dyn Disk,
    root: &Path,
    place: &SeriesRef,
    before: &[u8],
    line: &[u8],
) -> Result<Pending, StoreError> {
    let whole = [before, line].concat();
    let pending = Pending {
        flight: place.flight.clone(),
        series: place.id.clone(),
        bytes: whole.len() as u64,
        sha256: sha256(&whole),
    };
    let path = root.join(layout::PENDING_FILE);
    let text = jsonl::line(&pending).map_err(StoreError::io(&path, "write"))?;
    disk.write(&path, &text).map_err(StoreError::io(&path, "write"))?;
    Ok(pending)
}

/// Moves a torn tail to `partial/` and cuts the file to its whole lines.
pub(crate) fn mend(disk: &dyn Disk, root: &Path, series: &Path) -> Result<(), StoreError> {
    let path = series.join(layout::RESULTS_FILE);
    let bytes = disk.read(&path).map_err(StoreError::io(&path, "read"))?;
    let good = jsonl::parse::<ResultKey>(&bytes).good_length;
    let Some(tail) = bytes.get(good..).filter(|tail| !tail.is_empty()) else { return Ok(()) };
    let name = series.file_name().unwrap_or_default().to_string_lossy();
    set_aside(disk, root, &format!("{name}-results-{good}.torn"), tail)?;
    disk.truncate(&path, good as u64).map_err(StoreError::io(&path, "mend"))
}

/// Keeps bytes that are not whole under `partial/`, in place of an older copy of the same name.
pub(crate) fn set_aside(disk: &dyn Disk, root: &Path, name: &str, bytes: &[u8]) -> Result<(), StoreError> {
    let partial = root.join(layout::PARTIAL);
    let path = partial.join(name);
    disk.write(&path, bytes).map_err(StoreError::io(&path, "write"))?;
    disk.sync_dir(&partial).map_err(StoreError::io(&partial, "sync"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn the_key_follows_every_input_and_not_their_order() {
        let map = |text: &str| serde_json::from_str::<Map<String, Value>>(text).unwrap();
        let a = Inputs::new(map(r#"{"version":"1","camera":{"x":1,"y":2}}"#));
        let b = Inputs::new(map(r#"{"camera":{"y":2,"x":1},"version":"1"}"#));
        let c = Inputs::new(map(r#"{"camera":{"y":2,"x":3},"version":"1"}"#));
        assert_eq!(a.key("f"), b.key("f"));
        assert_ne!(a.key("f"), c.key("f"));
        assert_ne!(a.key("f"), a.key("g"));
    }
}
