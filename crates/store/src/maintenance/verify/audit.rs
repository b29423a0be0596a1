//! Comparison of a flight with its chain and its SHA256SUMS (invariants 14 to 17 and 20 to 22 of docs/store.md).

use std::collections::BTreeMap;
use std::path::Path;

use sha2::{Digest, Sha256};

use super::report::VerifyReport;
use crate::disk::Disk;
use crate::format::append_file_kinds::{APPEND_FILE_KINDS, AppendFileKind};
use crate::format::chain::{Chain, ChainState};
use crate::format::manifest::SeriesManifest;
use crate::format::{jsonl, layout, sha256_hex, sums};
use crate::read::catalogue;
use crate::read::catalogue::FlightRef;
use crate::read::installations;
use crate::write::results::{ResultKey, read_pending};

/// SHA-256 and content of `series.json`, by series.
pub(super) type Manifests = BTreeMap<String, (String, SeriesManifest)>;

/// Audit of a flight.
pub(super) struct FlightAudit<'a> {
    pub disk: &'a dyn Disk,
    /// Root of the store; `None` for a flight outside a store.
    pub root: Option<&'a Path>,
    pub flight: &'a FlightRef,
    /// Readable manifests of the flight's series.
    pub manifests: &'a Manifests,
}

impl FlightAudit<'_> {
    /// Checks the flight's chain and notes each violation.
    pub fn run(&self, found: &mut VerifyReport) {
        let path = self.flight.folder.join(layout::CHAIN_FILE);
        let bytes = match self.disk.read(&path) {
            Ok(bytes) => bytes,
            Err(error) => return found.add_fault(14, &path, format!("cannot be read: {error}")),
        };
        let chain = Chain::parse(&bytes);
        chain
            .faults
            .iter()
            .for_each(|problem| found.add_fault(14, &path, problem));
        if chain.good_length < bytes.len() {
            let problem = "its last line is torn; it is set aside when the next one is written";
            found.notes.push(format!("{}: {problem}", path.display()));
        }
        let state = chain.state_at(usize::MAX);
        self.check_chain_identity(&state, &path, found);
        self.check_series_digests(&state, found);
        self.check_result_digests(&state, found);
        APPEND_FILE_KINDS
            .iter()
            .for_each(|kind| self.check_closed_files(&state, kind, found));
        self.check_kept_installations(&state, found);
        self.check_sums_file(&bytes, &chain, found);
    }

    fn check_chain_identity(&self, state: &ChainState, path: &Path, found: &mut VerifyReport) {
        let Some((store, flight, digest)) = &state.flight else {
            return;
        };
        let id = self
            .root
            .and_then(|root| catalogue::store_id(self.disk, root));
        if *flight != self.flight.id || id.is_some_and(|id| id != *store) {
            found.add_fault(
                14,
                path,
                format!("is the chain of flight {flight} of store {store}"),
            );
        }
        let file = self.flight.folder.join(layout::FLIGHT_FILE);
        if self
            .disk
            .read(&file)
            .is_ok_and(|bytes| sha256_hex(&bytes) != *digest)
        {
            found.add_fault(15, &file, "does not have the SHA-256 of the chain");
        }
    }

    fn check_series_digests(&self, state: &ChainState, found: &mut VerifyReport) {
        for (id, digest) in &state.series {
            let folder = self.flight.folder.join(id);
            match self.manifests.get(id) {
                Some((sha256, _)) if sha256 == digest => {}
                Some(_) => {
                    let problem =
                        "does not have the SHA-256 of the chain: it was changed or replaced";
                    found.add_fault(15, &folder.join(layout::SERIES_FILE), problem);
                }
                // An unreadable manifest is reported elsewhere.
                None if self.disk.exists(&folder) => {}
                None if self.is_commit_pending(id, digest) => {}
                None => found.add_fault(
                    15,
                    &folder,
                    "the chain has this series as closed, but it is missing",
                ),
            }
        }
        for id in self
            .manifests
            .keys()
            .filter(|id| !state.series.contains_key(*id))
        {
            let problem =
                "this series is not in the chain: it was added, or the chain was truncated";
            found.add_fault(15, &self.flight.folder.join(id), problem);
        }
    }

    /// Returns whether the series was closed but not moved yet; the next start finishes that.
    fn is_commit_pending(&self, series: &str, digest: &str) -> bool {
        let manifest = self
            .root
            .map(|root| layout::incoming_folder(root, series).join(layout::SERIES_FILE));
        manifest
            .and_then(|path| self.disk.read(&path).ok())
            .is_some_and(|bytes| sha256_hex(&bytes) == digest)
    }

    fn check_result_digests(&self, state: &ChainState, found: &mut VerifyReport) {
        for id in self.manifests.keys() {
            let path = self.flight.folder.join(id).join(layout::RESULTS_FILE);
            let entries = state.results.get(id).map(Vec::as_slice).unwrap_or_default();
            let bytes = match self.disk.read(&path) {
                Ok(bytes) => bytes,
                Err(_) if entries.is_empty() => continue,
                Err(_) if !self.disk.exists(&path) => {
                    let problem = format!(
                        "{} results are in the chain, but the file is missing",
                        entries.len()
                    );
                    found.add_fault(15, &path, problem);
                    continue;
                }
                // Invariant 9 reports it.
                Err(_) => continue,
            };
            match check_growth(&bytes, entries) {
                Err(unlike) => found.add_fault(15, &path, unlike.to_string()),
                Ok(known) => self.check_unchained_tail(id, &path, &bytes, known, found),
            }
        }
    }

    /// Reports bytes after the chain's length, unless they were announced in `pending.json`.
    fn check_unchained_tail(
        &self,
        series: &str,
        path: &Path,
        bytes: &[u8],
        known: usize,
        found: &mut VerifyReport,
    ) {
        let tail = bytes.len() - known;
        if tail == 0 {
            return;
        }
        let pending = self.root.and_then(|root| read_pending(self.disk, root));
        let announced = pending.is_some_and(|p| {
            let here = p.flight == self.flight.id && p.results.series == series;
            let torn = jsonl::parse_lines::<ResultKey>(bytes.get(known..).unwrap_or_default())
                .good
                .is_empty();
            here && (p.results.sha256 == sha256_hex(bytes)
                || (torn && p.results.bytes >= bytes.len() as u64))
        });
        if announced {
            let problem = "a result was being written when the program ended, or still is; the next start completes it";
            found.notes.push(format!("{}: {problem}", path.display()));
        } else {
            let problem =
                format!("its last {tail} bytes are not in the chain: they were added manually");
            found.add_fault(15, path, problem);
        }
    }

    /// Checks the closed files of a kind against the chain, both ways.
    fn check_closed_files(
        &self,
        state: &ChainState,
        kind: &AppendFileKind,
        found: &mut VerifyReport,
    ) {
        let mut fault = |file: &str, problem: String| {
            found.add_fault(kind.invariant, &self.flight.folder.join(file), problem);
        };
        let is_ours = |file: &String| (kind.closed_number)(file).is_some();
        for (file, (_, digest)) in state.files.iter().filter(|(file, _)| is_ours(file)) {
            match self.disk.read(&self.flight.folder.join(file)) {
                Ok(bytes) if sha256_hex(&bytes) == *digest => {}
                Ok(_) => fault(
                    file,
                    "does not have the SHA-256 of the chain: it was changed".to_owned(),
                ),
                Err(_) if self.is_close_pending(digest, kind) => {}
                Err(error) => fault(
                    file,
                    format!("is in the chain, but cannot be read: {error}"),
                ),
            }
        }
        let here = catalogue::closed_files(self.disk, self.flight, kind).unwrap_or_default();
        for file in here
            .into_iter()
            .filter(|file| !state.files.contains_key(file))
        {
            fault(
                &file,
                "is not in the chain: it was added, or the chain was truncated".to_owned(),
            );
        }
    }

    /// Returns whether the file is still in the root; the next start moves it to its flight.
    fn is_close_pending(&self, digest: &str, kind: &AppendFileKind) -> bool {
        let bytes = self
            .root
            .and_then(|root| self.disk.read(&root.join(kind.open_name)).ok());
        let ours = |bytes: &[u8]| {
            (kind.intact_prefix)(bytes).is_some_and(|(_, flight)| flight == self.flight.id)
        };
        bytes.is_some_and(|bytes| sha256_hex(&bytes) == digest && ours(&bytes))
    }

    fn check_kept_installations(&self, state: &ChainState, found: &mut VerifyReport) {
        let Some(root) = self.root else { return };
        for digest in &state.installations {
            if let Some((path, problem)) = installations::find_fault(self.disk, root, digest) {
                found.add_fault(17, &path, problem);
            }
        }
    }

    fn check_sums_file(&self, bytes: &[u8], chain: &Chain, found: &mut VerifyReport) {
        let path = self.flight.folder.join(layout::SUMS_FILE);
        let text = match self.disk.read(&path) {
            Ok(text) => text,
            Err(error) => return found.add_fault(16, &path, format!("cannot be read: {error}")),
        };
        let sums = sums::parse_sums(&text).unwrap_or_default();
        let Some(end) = sums::covered_chain_length(&sums, bytes, chain) else {
            return found.add_fault(
                16,
                &path,
                "does not belong to this chain: one of the two was changed or truncated",
            );
        };
        let mut expected = sums::FileDigests::new();
        for (_, event) in chain.events.iter().take_while(|(at, _)| *at <= end) {
            let manifest = |id: &str| self.manifests.get(id).map(|(_, m)| m.clone()).ok_or(());
            // A missing series is reported above.
            if sums::add_event(&mut expected, event, manifest).is_err() {
                return;
            }
        }
        expected.insert(
            layout::CHAIN_FILE.to_owned(),
            sha256_hex(bytes.get(..end).unwrap_or_default()),
        );
        if text != sums::format_sums(&expected).into_bytes() {
            found.add_fault(16, &path, "does not match the files in chain and manifests");
        } else if end < chain.good_length {
            let problem = "behind the chain; updated at the next start";
            found.notes.push(format!("{}: {problem}", path.display()));
        }
    }
}

/// Difference between results and chain.
#[derive(Debug, thiserror::Error)]
enum ChainMismatch {
    #[error("has {length} bytes, but {known} in the chain: results are missing")]
    Short { length: usize, known: usize },
    #[error("its first {end} bytes do not have the SHA-256 of the chain: it was changed")]
    Changed { end: usize },
    #[error("bytes {from} to {end} contain more than the result in the chain")]
    More { from: usize, end: usize },
}

/// Checks that a file grew as the chain states, one line at a time; returns the length that the chain covers. (The first
/// entry may cover several lines, from before an upgrade.)
fn check_growth(bytes: &[u8], entries: &[(u64, String)]) -> Result<usize, ChainMismatch> {
    let (mut hasher, mut done) = (Sha256::new(), 0);
    for (index, (length, digest)) in entries.iter().enumerate() {
        let end = usize::try_from(*length).unwrap_or(usize::MAX);
        let Some(part) = bytes.get(done..end) else {
            return Err(ChainMismatch::Short {
                length: bytes.len(),
                known: end,
            });
        };
        hasher.update(part);
        if hex::encode(hasher.clone().finalize()) != *digest {
            return Err(ChainMismatch::Changed { end });
        }
        if index > 0 && part.iter().filter(|byte| **byte == b'\n').count() != 1 {
            return Err(ChainMismatch::More { from: done, end });
        }
        done = end;
    }
    Ok(done)
}
