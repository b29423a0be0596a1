//! `SHA256SUMS` of a flight: every file of it, as `sha256sum -c` reads it. It is derived from the chain
//! and the manifests, and written when a series is closed and when its results are.

use std::collections::BTreeMap;
use std::path::Path;

use super::chain::{self, Chain, Event};
use super::disk::{self, Disk};
use super::error::StoreError;
use super::layout;
use super::manifest::SeriesManifest;
use super::results::sha256;

/// File (from the flight's folder) -> SHA-256, hex.
pub(crate) type Sums = BTreeMap<String, String>;

/// The lines, in the names' order.
pub(crate) fn text(sums: &Sums) -> String {
    sums.iter().map(|(name, digest)| format!("{digest}  {name}\n")).collect()
}

/// Reads the lines; `None` where one is not as [`text`] writes it.
pub(crate) fn parse(text: &str) -> Option<Sums> {
    let line = |line: &str| line.split_once("  ").map(|(digest, name)| (name.to_owned(), digest.to_owned()));
    text.lines().map(line).collect()
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
        Event::Results { series, sha256, .. } => {
            sums.insert(format!("{series}/{}", layout::RESULTS_FILE), sha256.clone());
        }
        Event::Aircraft { file, sha256, .. } | Event::Live { file, sha256, .. } => {
            sums.insert(file.clone(), sha256.clone());
        }
        Event::Installation { .. } | Event::Signature { .. } => {}
    }
    Ok(())
}

/// Where the chain ended when its sums were written; `None` where it never had that digest.
pub(crate) fn covered(sums: &Sums, chain: &[u8], parsed: &Chain) -> Option<usize> {
    use sha2::{Digest, Sha256};
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

/// Brings a flight's sums up to its chain. Sums and chain that disagree stay as they are: that is
/// evidence, and `verify` names it.
pub(crate) fn seal(disk: &dyn Disk, flight: &Path) -> Result<(), StoreError> {
    let path = flight.join(layout::SUMS_FILE);
    let bytes = chain::read(disk, flight)?;
    let parsed = Chain::parse(&bytes);
    let whole = bytes.get(..parsed.good_length).unwrap_or_default();
    let damaged = || StoreError::Damaged {
        path: path.clone(),
        what: format!("is not of this {}", layout::CHAIN_FILE),
        mend: "`wingd verify` says more; take the flight from a copy",
    };
    let (mut sums, from) = if disk.exists(&path) {
        let text = disk.read(&path).map_err(StoreError::io(&path, "read"))?;
        let old = std::str::from_utf8(&text).ok().and_then(parse).ok_or_else(damaged)?;
        let from = covered(&old, whole, &parsed).ok_or_else(damaged)?;
        (old, from)
    } else {
        (Sums::new(), 0)
    };
    if from == parsed.good_length && from > 0 {
        return Ok(());
    }
    for (_, event) in parsed.events.iter().filter(|(end, _)| *end > from) {
        add(&mut sums, event, |series| read_manifest(disk, flight, series))?;
    }
    sums.insert(layout::CHAIN_FILE.to_owned(), sha256(whole));
    disk::replace(disk, &path, text(&sums).as_bytes()).map_err(StoreError::io(&path, "write"))
}

fn read_manifest(disk: &dyn Disk, flight: &Path, series: &str) -> Result<SeriesManifest, StoreError> {
    let folder = flight.join(series);
    super::catalogue::manifest(
        disk,
        &super::SeriesRef { flight: String::new(), id: series.to_owned(), folder },
    )
}
