//! Digest list of a flight, `SHA256SUMS`: all its files, in the format of `sha256sum -c`. It is derived from chain and
//! manifests, and written when a series or its results are complete.

use std::collections::BTreeMap;

use sha2::{Digest, Sha256};

use super::chain::{Chain, ChainEvent};
use super::layout;
use super::manifest::SeriesManifest;

/// SHA-256, hex, by file name relative to the folder.
pub(crate) type FileDigests = BTreeMap<String, String>;

/// Formats the digests as lines, sorted by name.
pub(crate) fn format_sums(sums: &FileDigests) -> String {
    sums.iter()
        .map(|(name, digest)| format!("{digest}  {name}\n"))
        .collect()
}

/// Parses the lines; `None` if one is not as [`format_sums`] writes it.
pub(crate) fn parse_sums(bytes: &[u8]) -> Option<FileDigests> {
    let line = |line: &str| {
        line.split_once("  ")
            .map(|(digest, name)| (name.to_owned(), digest.to_owned()))
    };
    std::str::from_utf8(bytes).ok()?.lines().map(line).collect()
}

/// Adds the files of an event; `manifest` returns the manifest of a series.
pub(crate) fn add_event<E>(
    sums: &mut FileDigests,
    event: &ChainEvent,
    manifest: impl FnOnce(&str) -> Result<SeriesManifest, E>,
) -> Result<(), E> {
    match event {
        ChainEvent::Flight { sha256, .. } => {
            drop(sums.insert(layout::FLIGHT_FILE.to_owned(), sha256.clone()))
        }
        ChainEvent::Series { series, sha256 } => {
            sums.insert(format!("{series}/{}", layout::SERIES_FILE), sha256.clone());
            let frames = manifest(series)?
                .shots
                .into_iter()
                .filter_map(|shot| shot.frame);
            sums.extend(frames.map(|frame| (format!("{series}/{}", frame.file), frame.sha256)));
        }
        ChainEvent::Results(results) => {
            sums.insert(
                format!("{}/{}", results.series, layout::RESULTS_FILE),
                results.sha256.clone(),
            );
        }
        ChainEvent::Aircraft(closed) | ChainEvent::Live(closed) | ChainEvent::Marks(closed) => {
            sums.insert(closed.file.clone(), closed.sha256.clone());
        }
        ChainEvent::Installation { .. } | ChainEvent::Signature { .. } => {}
    }
    Ok(())
}

/// Returns the length of the chain when its sums were written, bytes; `None` if it never had that digest.
pub(crate) fn covered_chain_length(
    sums: &FileDigests,
    chain: &[u8],
    parsed: &Chain,
) -> Option<usize> {
    let expected = sums.get(layout::CHAIN_FILE)?;
    let (mut hasher, mut done) = (Sha256::new(), 0);
    for (end, _) in &parsed.events {
        hasher.update(chain.get(done..*end)?);
        done = *end;
        if hex::encode(hasher.clone().finalize()) == *expected {
            return Some(done);
        }
    }
    None
}
