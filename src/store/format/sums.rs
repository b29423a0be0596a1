//! `SHA256SUMS` of a flight: every file of it, as `sha256sum -c` reads it. It is derived from the chain
//! and the manifests, and written when a series is closed and when its results are.

use std::collections::BTreeMap;

use sha2::{Digest, Sha256};

use super::chain::{Chain, Event};
use super::layout;
use super::manifest::SeriesManifest;

/// File (from the flight's folder) -> SHA-256, hex.
pub(crate) type Sums = BTreeMap<String, String>;

/// The lines, in the names' order.
pub(crate) fn text(sums: &Sums) -> String {
    sums.iter().map(|(name, digest)| format!("{digest}  {name}\n")).collect()
}

/// Reads the lines; `None` where one is not as [`text`] writes it.
pub(crate) fn parse(bytes: &[u8]) -> Option<Sums> {
    let line = |line: &str| line.split_once("  ").map(|(digest, name)| (name.to_owned(), digest.to_owned()));
    std::str::from_utf8(bytes).ok()?.lines().map(line).collect()
}

/// What an event adds; `manifest` gives a series' manifest.
pub(crate) fn add<E>(
    sums: &mut Sums,
    event: &Event,
    manifest: impl FnOnce(&str) -> Result<SeriesManifest, E>,
) -> Result<(), E> {
    match event {
        Event::Flight { sha256, .. } => drop(sums.insert(layout::FLIGHT_FILE.to_owned(), sha256.clone())),
        Event::Series { series, sha256 } => {
            sums.insert(format!("{series}/{}", layout::SERIES_FILE), sha256.clone());
            let frames = manifest(series)?.shots.into_iter().filter_map(|shot| shot.frame);
            sums.extend(frames.map(|frame| (format!("{series}/{}", frame.file), frame.sha256)));
        }
        Event::Results(results) => {
            sums.insert(format!("{}/{}", results.series, layout::RESULTS_FILE), results.sha256.clone());
        }
        Event::Aircraft(closed) | Event::Live(closed) | Event::Marks(closed) => {
            sums.insert(closed.file.clone(), closed.sha256.clone());
        }
        Event::Installation { .. } | Event::Signature { .. } => {}
    }
    Ok(())
}

/// Where the chain ended when its sums were written; `None` where it never had that digest.
pub(crate) fn covered(sums: &Sums, chain: &[u8], parsed: &Chain) -> Option<usize> {
    let wanted = sums.get(layout::CHAIN_FILE)?;
    let (mut hasher, mut done) = (Sha256::new(), 0);
    for (end, _) in &parsed.events {
        hasher.update(chain.get(done..*end)?);
        done = *end;
        if hex::encode(hasher.clone().finalize()) == *wanted {
            return Some(done);
        }
    }
    None
}
