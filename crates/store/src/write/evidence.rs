//! Update of a flight's `SHA256SUMS` from its chain.

use std::path::Path;

use crate::disk::{Disk, StoreError, StoreResult};
use crate::format::sums;
use crate::format::sums::FileDigests;
use crate::format::{layout, sha256_hex};
use crate::read::catalogue;
use crate::read::catalogue::SeriesRef;

/// Updates a flight's sums to its chain. Sums and chain that contradict each other stay unchanged: that is evidence, and
/// `verify` reports it.
pub(crate) fn update_sums(disk: &dyn Disk, flight: &Path) -> StoreResult<()> {
    let path = flight.join(layout::SUMS_FILE);
    let (bytes, chain) = catalogue::read_chain(disk, flight)?;
    let whole = bytes.get(..chain.good_length).unwrap_or_default();
    let damaged = || StoreError::Damaged {
        path: path.clone(),
        problem: format!("does not belong to this {}", layout::CHAIN_FILE),
        remedy: "run `wingd verify` for details; restore the flight from a copy",
    };
    let (mut sums, from) = match disk.load_if_exists(&path)? {
        Some(text) => {
            let old = sums::parse_sums(&text).ok_or_else(damaged)?;
            let from = sums::covered_chain_length(&old, whole, &chain).ok_or_else(damaged)?;
            (old, from)
        }
        None => (FileDigests::new(), 0),
    };
    if from == chain.good_length && from > 0 {
        return Ok(());
    }
    let manifest = |id: &str| {
        let series = SeriesRef {
            flight: String::new(),
            id: id.to_owned(),
            folder: flight.join(id),
        };
        catalogue::read_series_manifest(disk, &series)
    };
    for (_, event) in chain.events.iter().filter(|(end, _)| *end > from) {
        sums::add_event(&mut sums, event, manifest)?;
    }
    sums.insert(layout::CHAIN_FILE.to_owned(), sha256_hex(whole));
    disk.replace_file(&path, sums::format_sums(&sums).as_bytes())
}
