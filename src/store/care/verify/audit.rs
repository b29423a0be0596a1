//! Whether a flight is what its chain says, and its SHA256SUMS too (invariants 14 to 17 and 20 to 22 of docs/store.md).

use std::collections::BTreeMap;
use std::path::Path;

use sha2::{Digest, Sha256};

use super::report::Report;
use crate::store::disk::Disk;
use crate::store::format::chain::{Chain, State};
use crate::store::format::kinds::{KINDS, Kind};
use crate::store::format::manifest::SeriesManifest;
use crate::store::format::{jsonl, layout, sha256, sums};
use crate::store::read::catalogue::{self, FlightRef};
use crate::store::read::installations;
use crate::store::write::results::{ResultKey, pending};

/// Digest of `series.json` and what it says, by series.
pub(super) type Manifests = BTreeMap<String, (String, SeriesManifest)>;

/// A flight under audit.
pub(super) struct Audit<'a> {
    pub disk: &'a dyn Disk,
    /// The store, where the flight lies in one.
    pub root: Option<&'a Path>,
    pub flight: &'a FlightRef,
    /// Its series that could be read.
    pub manifests: &'a Manifests,
}

impl Audit<'_> {
    pub fn run(&self, found: &mut Report) {
        let path = self.flight.folder.join(layout::CHAIN_FILE);
        let bytes = match self.disk.read(&path) {
            Ok(bytes) => bytes,
            Err(error) => return found.fault(14, &path, format!("cannot be read: {error}")),
        };
        let chain = Chain::parse(&bytes);
        chain.faults.iter().for_each(|what| found.fault(14, &path, what));
        if chain.good_length < bytes.len() {
            let what = "its last line is torn; set aside with the next one";
            found.notes.push(format!("{}: {what}", path.display()));
        }
        let state = chain.state(usize::MAX);
        self.identity(&state, &path, found);
        self.series(&state, found);
        self.results(&state, found);
        KINDS.iter().for_each(|kind| self.closed(&state, kind, found));
        self.installations(&state, found);
        self.sums(&bytes, &chain, found);
    }

    fn identity(&self, state: &State, path: &Path, found: &mut Report) {
        let Some((store, flight, digest)) = &state.flight else { return };
        let id = self.root.and_then(|root| catalogue::store_id(self.disk, root));
        if *flight != self.flight.id || id.is_some_and(|id| id != *store) {
            found.fault(14, path, format!("is the chain of flight {flight} of store {store}"));
        }
        let file = self.flight.folder.join(layout::FLIGHT_FILE);
        if self.disk.read(&file).is_ok_and(|bytes| sha256(&bytes) != *digest) {
            found.fault(15, &file, "does not have the SHA-256 of the chain");
        }
    }

    fn series(&self, state: &State, found: &mut Report) {
        for (id, digest) in &state.series {
            let folder = self.flight.folder.join(id);
            match self.manifests.get(id) {
                Some((sha256, _)) if sha256 == digest => {}
                Some(_) => {
                    let what = "does not have the SHA-256 of the chain: it was changed or replaced";
                    found.fault(15, &folder.join(layout::SERIES_FILE), what);
                }
                // A manifest that cannot be read is reported as such.
                None if self.disk.exists(&folder) => {}
                None if self.is_under_way(id, digest) => {}
                None => found.fault(15, &folder, "this series was closed by the chain, and it is missing"),
            }
        }
        for id in self.manifests.keys().filter(|id| !state.series.contains_key(*id)) {
            let what = "this series is not in the chain: it was added, or the chain was cut";
            found.fault(15, &self.flight.folder.join(id), what);
        }
    }

    /// Closed, and not at its place yet: the next start finishes it.
    fn is_under_way(&self, series: &str, digest: &str) -> bool {
        let manifest = self.root.map(|root| layout::incoming(root, series).join(layout::SERIES_FILE));
        manifest.and_then(|path| self.disk.read(&path).ok()).is_some_and(|bytes| sha256(&bytes) == digest)
    }

    fn results(&self, state: &State, found: &mut Report) {
        for id in self.manifests.keys() {
            let path = self.flight.folder.join(id).join(layout::RESULTS_FILE);
            let entries = state.results.get(id).map(Vec::as_slice).unwrap_or_default();
            let bytes = match self.disk.read(&path) {
                Ok(bytes) => bytes,
                Err(_) if entries.is_empty() => continue,
                Err(_) if !self.disk.exists(&path) => {
                    let what = format!("{} results are in the chain, and the file is missing", entries.len());
                    found.fault(15, &path, what);
                    continue;
                }
                // Reported as invariant 9.
                Err(_) => continue,
            };
            match grown(&bytes, entries) {
                Err(unlike) => found.fault(15, &path, unlike.to_string()),
                Ok(known) => self.unknown_tail(id, &path, &bytes, known, found),
            }
        }
    }

    /// Bytes after what the chain knows are sound only where they were announced.
    fn unknown_tail(&self, series: &str, path: &Path, bytes: &[u8], known: usize, found: &mut Report) {
        let tail = bytes.len() - known;
        if tail == 0 {
            return;
        }
        let pending = self.root.and_then(|root| pending(self.disk, root));
        let announced = pending.is_some_and(|p| {
            let here = p.flight == self.flight.id && p.results.series == series;
            let torn = jsonl::parse::<ResultKey>(bytes.get(known..).unwrap_or_default()).good.is_empty();
            here && (p.results.sha256 == sha256(bytes) || (torn && p.results.bytes >= bytes.len() as u64))
        });
        if announced {
            let what = "a result is being written, or was when the program ended; the next start settles it";
            found.notes.push(format!("{}: {what}", path.display()));
        } else {
            let what = format!("its last {tail} bytes are not in the chain: they were added by hand");
            found.fault(15, path, what);
        }
    }

    /// What the chain has is there, and nothing else.
    fn closed(&self, state: &State, kind: &Kind, found: &mut Report) {
        let mut fault = |file: &str, what: String| {
            found.fault(kind.invariant, &self.flight.folder.join(file), what);
        };
        let is_ours = |file: &String| (kind.number)(file).is_some();
        for (file, (_, digest)) in state.files.iter().filter(|(file, _)| is_ours(file)) {
            match self.disk.read(&self.flight.folder.join(file)) {
                Ok(bytes) if sha256(&bytes) == *digest => {}
                Ok(_) => fault(file, "does not have the SHA-256 of the chain: it was changed".to_owned()),
                Err(_) if self.is_being_written(digest, kind) => {}
                Err(error) => fault(file, format!("is in the chain, and cannot be read: {error}")),
            }
        }
        let here = catalogue::files(self.disk, self.flight, kind).unwrap_or_default();
        for file in here.into_iter().filter(|file| !state.files.contains_key(file)) {
            fault(&file, "is not in the chain: it was added, or the chain was cut".to_owned());
        }
    }

    /// The one in the root, which the next start moves to its flight.
    fn is_being_written(&self, digest: &str, kind: &Kind) -> bool {
        let bytes = self.root.and_then(|root| self.disk.read(&root.join(kind.open)).ok());
        let ours = |bytes: &[u8]| (kind.whole)(bytes).is_some_and(|(_, flight)| flight == self.flight.id);
        bytes.is_some_and(|bytes| sha256(&bytes) == digest && ours(&bytes))
    }

    fn installations(&self, state: &State, found: &mut Report) {
        let Some(root) = self.root else { return };
        for digest in &state.installations {
            if let Some((path, what)) = installations::fault(self.disk, root, digest) {
                found.fault(17, &path, what);
            }
        }
    }

    fn sums(&self, bytes: &[u8], chain: &Chain, found: &mut Report) {
        let path = self.flight.folder.join(layout::SUMS_FILE);
        let text = match self.disk.read(&path) {
            Ok(text) => text,
            Err(error) => return found.fault(16, &path, format!("cannot be read: {error}")),
        };
        let sums = sums::parse(&text).unwrap_or_default();
        let Some(end) = sums::covered(&sums, bytes, chain) else {
            return found.fault(16, &path, "is not of this chain: one of the two was changed or cut");
        };
        let mut wanted = sums::Sums::new();
        for (_, event) in chain.events.iter().take_while(|(at, _)| *at <= end) {
            let manifest = |id: &str| self.manifests.get(id).map(|(_, m)| m.clone()).ok_or(());
            // A missing series is reported above.
            if sums::add(&mut wanted, event, manifest).is_err() {
                return;
            }
        }
        wanted.insert(layout::CHAIN_FILE.to_owned(), sha256(bytes.get(..end).unwrap_or_default()));
        if text != sums::text(&wanted).into_bytes() {
            found.fault(16, &path, "does not list the files as chain and manifests do");
        } else if end < chain.good_length {
            let what = "behind the chain; brought up to it at the next start";
            found.notes.push(format!("{}: {what}", path.display()));
        }
    }
}

/// How results are not what the chain says.
#[derive(Debug, thiserror::Error)]
enum Unlike {
    #[error("has {length} bytes, the chain had {known}: results are missing")]
    Short { length: usize, known: usize },
    #[error("its first {end} bytes do not have the SHA-256 of the chain: it was changed")]
    Changed { end: usize },
    #[error("between bytes {from} and {end} lies more than the result in the chain")]
    More { from: usize, end: usize },
}

/// Checks that a file grew as the chain says, a line at a time; returns the length that the chain
/// knows. (The first entry may hold several lines: those from before an upgrade.)
fn grown(bytes: &[u8], entries: &[(u64, String)]) -> Result<usize, Unlike> {
    let (mut hasher, mut done) = (Sha256::new(), 0);
    for (index, (length, digest)) in entries.iter().enumerate() {
        let end = usize::try_from(*length).unwrap_or(usize::MAX);
        let Some(part) = bytes.get(done..end) else {
            return Err(Unlike::Short { length: bytes.len(), known: end });
        };
        hasher.update(part);
        if hex::encode(hasher.clone().finalize()) != *digest {
            return Err(Unlike::Changed { end });
        }
        if index > 0 && part.iter().filter(|byte| **byte == b'\n').count() != 1 {
            return Err(Unlike::More { from: done, end });
        }
        done = end;
    }
    Ok(done)
}
