//! Results of a series: one line for each frame and inputs, written once.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::chain;
use super::root::StoreRoot;
use crate::disk::{Disk, StoreError, StoreResult};
use crate::format::chain::{AppendedResults, ChainEvent, last_results_entry};
use crate::format::manifest::ResultLine;
use crate::format::{jsonl, layout};
use crate::read::catalogue::{self, SeriesRef};

/// Identity of a result, without its numbers.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub(crate) struct ResultKey {
    pub frame: String,
    pub inputs: String,
}

/// Intact results of a series: with it, the work of adding one does not depend on their number.
#[derive(Default)]
pub(crate) struct SeriesResults {
    /// Length of the intact lines, bytes.
    length: u64,
    /// Digest of those bytes.
    hasher: Sha256,
    /// Digests of frames and inputs.
    keys: HashSet<[u8; 32]>,
}

impl SeriesResults {
    /// Reads the results of a series line by line.
    pub fn read(disk: &dyn Disk, series: &Path) -> StoreResult<Self> {
        let mut results = Self::default();
        let mut read = Sha256::new();
        catalogue::for_each_line(disk, &series.join(layout::RESULTS_FILE), |place, line| {
            read.update(line);
            read.update(b"\n");
            if let Ok(key) = serde_json::from_slice::<ResultKey>(line) {
                results.keys.insert(key_digest(&key.frame, &key.inputs));
                (results.length, results.hasher) = (place.end + 1, read.clone());
            }
        })?;
        Ok(results)
    }

    /// Returns length and digest, as in the chain.
    pub fn entry(&self, series: &str) -> AppendedResults {
        AppendedResults {
            series: series.to_owned(),
            bytes: self.length,
            sha256: hex::encode(self.hasher.clone().finalize()),
        }
    }
}

fn key_digest(frame: &str, inputs: &str) -> [u8; 32] {
    Sha256::digest(format!("{frame}\n{inputs}")).into()
}

/// Results of the series that this process has added to last, with its folder.
#[derive(Default)]
pub(crate) struct OpenResults(Option<(PathBuf, SeriesResults)>);

/// Announcement in `pending.json`: the next state of a series' `results.jsonl`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct PendingResult {
    pub flight: String,
    #[serde(flatten)]
    pub results: AppendedResults,
}

/// Reads the announced result; `None` if there is none, or the file is torn and nothing was written yet.
pub(crate) fn read_pending(disk: &dyn Disk, root: &Path) -> Option<PendingResult> {
    disk.load_json(&root.join(layout::PENDING_FILE))
}

/// Completes a result after a crash before its line in the chain: a complete result gets the line, an incomplete one is set
/// aside. This must precede the next announcement, otherwise nothing would account for the bytes.
pub(super) fn settle_pending(root: StoreRoot<'_>) -> StoreResult<()> {
    let Some(PendingResult { flight, results }) = read_pending(root.disk, root.path) else {
        return Ok(());
    };
    if layout::flight_number(&flight)
        .and(layout::series_number(&results.series))
        .is_none()
    {
        return Ok(());
    }
    let flight = root.flight_folder(&flight);
    let folder = flight.join(&results.series);
    let chain = root.disk.load_if_exists(&flight.join(layout::CHAIN_FILE))?;
    let last = last_results_entry(&chain.unwrap_or_default(), &results.series);
    if !root.disk.exists(&folder.join(layout::RESULTS_FILE)) || last.as_ref() == Some(&results) {
        return Ok(());
    }
    let written = repair_results(root, &folder)?;
    if written.entry(&results.series) != results {
        return Ok(());
    }
    // The file may be new, and its name not on the medium yet.
    root.disk.sync_directory(&folder)?;
    chain::append_event(root, &flight, ChainEvent::Results(results))
}

impl OpenResults {
    /// Appends a result durably; returns `false` if it exists already. A torn last line is set aside, the next state is
    /// announced in `pending.json`, then the line goes to the results and its digest to the chain.
    pub fn append(
        &mut self,
        root: StoreRoot<'_>,
        place: &SeriesRef,
        line: &ResultLine,
    ) -> StoreResult<bool> {
        let length = root
            .disk
            .file_length(&place.folder.join(layout::RESULTS_FILE))?;
        let is_current = |(folder, known): &(PathBuf, SeriesResults)| {
            *folder == place.folder && known.length == length.unwrap_or(0)
        };
        // After an error the files are read again.
        let mut known = match self.0.take().filter(is_current) {
            Some((_, known)) => known,
            None => {
                if root.has_evidence() {
                    settle_pending(root)?;
                }
                repair_results(root, &place.folder)?
            }
        };
        let key = key_digest(&line.frame, &line.inputs);
        let is_new = !known.keys.contains(&key);
        if is_new {
            known.extend(root, place, line)?;
            known.keys.insert(key);
        }
        self.0 = Some((place.folder.clone(), known));
        Ok(is_new)
    }
}

impl SeriesResults {
    /// Appends a line to the results and its digest to the chain.
    fn extend(
        &mut self,
        root: StoreRoot<'_>,
        place: &SeriesRef,
        line: &ResultLine,
    ) -> StoreResult<()> {
        let path = place.folder.join(layout::RESULTS_FILE);
        let line = jsonl::encode_line(line).map_err(StoreError::io(&path, "write"))?;
        let before = self.length;
        self.hasher.update(&line);
        self.length += line.len() as u64;
        let results = self.entry(&place.id);
        let chained = root.has_evidence();
        if chained {
            write_pending(root, &place.flight, &results)?;
        }
        root.disk.extend_file(&path, before, &line)?;
        if before == 0 {
            root.disk.sync_directory(&place.folder)?;
        }
        if chained {
            let flight = root.flight_folder(&place.flight);
            chain::append_event(root, &flight, ChainEvent::Results(results))?;
        }
        Ok(())
    }
}

/// Announces the next state of the results in `pending.json`.
fn write_pending(root: StoreRoot<'_>, flight: &str, results: &AppendedResults) -> StoreResult<()> {
    let pending = PendingResult {
        flight: flight.to_owned(),
        results: results.clone(),
    };
    let path = root.join(layout::PENDING_FILE);
    let text = jsonl::encode_line(&pending).map_err(StoreError::io(&path, "write"))?;
    root.disk.save_file(&path, &text)
}

/// Moves a torn tail of a series' results to `partial/` and truncates the results to complete lines; returns these.
pub(crate) fn repair_results(root: StoreRoot<'_>, series: &Path) -> StoreResult<SeriesResults> {
    let path = series.join(layout::RESULTS_FILE);
    let results = SeriesResults::read(root.disk, series)?;
    let good = results.length;
    let torn = root
        .disk
        .file_length(&path)?
        .unwrap_or(0)
        .saturating_sub(good);
    if torn > 0 {
        let torn = usize::try_from(torn).unwrap_or(usize::MAX);
        let tail = root.disk.read_range(&path, good, torn);
        let tail = tail.map_err(StoreError::io(&path, "read"))?;
        let name = series.file_name().unwrap_or_default().to_string_lossy();
        root.set_aside(&format!("{name}-results-{good}.torn"), &tail)?;
        root.disk
            .truncate(&path, good)
            .map_err(StoreError::io(&path, "repair"))?;
    }
    Ok(results)
}
