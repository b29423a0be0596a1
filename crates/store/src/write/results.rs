//! Results of a series: one line for each frame and inputs, written once.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::chain;
use super::root::StoreRoot;
use crate::disk::{Disk, StoreError, StoreResult};
use crate::format::chain::{AppendedResults, ChainEvent, last_results_entry};
use crate::format::manifest::ResultLine;
use crate::format::{jsonl, layout, sha256_hex};
use crate::read::catalogue;
use crate::read::catalogue::SeriesRef;

/// Identity of a result, without its numbers.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub(crate) struct ResultKey {
    pub frame: String,
    pub inputs: String,
}

/// Reads the keys of a series' results; empty if there are none.
pub(super) fn result_keys(disk: &dyn Disk, series: &Path) -> StoreResult<Vec<ResultKey>> {
    let bytes = disk
        .load_if_exists(&series.join(layout::RESULTS_FILE))?
        .unwrap_or_default();
    Ok(jsonl::parse_lines(&bytes)
        .good
        .into_iter()
        .map(|(_, key)| key)
        .collect())
}

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
    let Ok(written) = root.disk.read(&folder.join(layout::RESULTS_FILE)) else {
        return Ok(());
    };
    let (chain, _) = catalogue::read_chain(root.disk, &flight)?;
    if last_results_entry(&chain, &results.series).as_ref() == Some(&results) {
        return Ok(());
    }
    if written.len() as u64 != results.bytes || sha256_hex(&written) != results.sha256 {
        return repair_results(root, &folder);
    }
    // The file may be new, and its name not on the medium yet.
    root.disk.sync_directory(&folder)?;
    chain::append_event(root, &flight, ChainEvent::Results(results))
}

/// Appends a result durably; returns `false` if it exists already. A torn last line is set aside, the next state is
/// announced in `pending.json`, then the line goes to the results and its digest to the chain.
pub(super) fn append_result(
    root: StoreRoot<'_>,
    place: &SeriesRef,
    line: &ResultLine,
) -> StoreResult<bool> {
    let chained = root.has_evidence();
    let path = place.folder.join(layout::RESULTS_FILE);
    if chained {
        settle_pending(root)?;
    }
    if root.disk.exists(&path) {
        repair_results(root, &place.folder)?;
    }
    let before = root.disk.load_if_exists(&path)?.unwrap_or_default();
    let keys = jsonl::parse_lines::<ResultKey>(&before).good;
    if keys
        .iter()
        .any(|(_, key)| key.frame == line.frame && key.inputs == line.inputs)
    {
        return Ok(false);
    }
    let line = jsonl::encode_line(line).map_err(StoreError::io(&path, "write"))?;
    let pending = if chained {
        Some(write_pending(root, place, &[&before[..], &line].concat())?)
    } else {
        None
    };
    root.disk.extend_file(&path, before.len(), &line)?;
    if before.is_empty() {
        root.disk.sync_directory(&place.folder)?;
    }
    if let Some(PendingResult { flight, results }) = pending {
        chain::append_event(
            root,
            &root.flight_folder(&flight),
            ChainEvent::Results(results),
        )?;
    }
    Ok(true)
}

/// Announces the next state of the results in `pending.json`.
fn write_pending(
    root: StoreRoot<'_>,
    place: &SeriesRef,
    whole: &[u8],
) -> StoreResult<PendingResult> {
    let (bytes, sha256) = (whole.len() as u64, sha256_hex(whole));
    let pending = PendingResult {
        flight: place.flight.clone(),
        results: AppendedResults {
            series: place.id.clone(),
            bytes,
            sha256,
        },
    };
    let path = root.join(layout::PENDING_FILE);
    let text = jsonl::encode_line(&pending).map_err(StoreError::io(&path, "write"))?;
    root.disk.save_file(&path, &text)?;
    Ok(pending)
}

/// Moves a torn tail of a series' results to `partial/` and truncates the results to complete lines.
pub(crate) fn repair_results(root: StoreRoot<'_>, series: &Path) -> StoreResult<()> {
    let path = series.join(layout::RESULTS_FILE);
    let bytes = root.disk.load_file(&path)?;
    let good = jsonl::parse_lines::<ResultKey>(&bytes).good_length;
    let name = series.file_name().unwrap_or_default().to_string_lossy();
    if root.set_tail_aside(&format!("{name}-results-{good}.torn"), &bytes, good)? {
        root.disk
            .truncate(&path, good as u64)
            .map_err(StoreError::io(&path, "repair"))?;
    }
    Ok(())
}
