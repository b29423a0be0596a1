//! `SHA256SUMS` of a flight, brought up to its chain.

use std::path::Path;

use crate::store::disk::{Disk, StoreError};
use crate::store::format::sums::{self, Sums};
use crate::store::format::{layout, sha256};
use crate::store::read::catalogue::{self, SeriesRef};

/// Brings a flight's sums up to its chain. Sums and chain that disagree stay as they are: that is
/// evidence, and `verify` names it.
pub(crate) fn seal(disk: &dyn Disk, flight: &Path) -> Result<(), StoreError> {
    let path = flight.join(layout::SUMS_FILE);
    let (bytes, chain) = catalogue::chain(disk, flight)?;
    let whole = bytes.get(..chain.good_length).unwrap_or_default();
    let damaged = || StoreError::Damaged {
        path: path.clone(),
        what: format!("is not of this {}", layout::CHAIN_FILE),
        mend: "`wingd verify` says more; take the flight from a copy",
    };
    let (mut sums, from) = match disk.load_if_there(&path)? {
        Some(text) => {
            let old = sums::parse(&text).ok_or_else(damaged)?;
            let from = sums::covered(&old, whole, &chain).ok_or_else(damaged)?;
            (old, from)
        }
        None => (Sums::new(), 0),
    };
    if from == chain.good_length && from > 0 {
        return Ok(());
    }
    let manifest = |id: &str| {
        let series = SeriesRef { flight: String::new(), id: id.to_owned(), folder: flight.join(id) };
        catalogue::manifest(disk, &series)
    };
    for (_, event) in chain.events.iter().filter(|(end, _)| *end > from) {
        sums::add(&mut sums, event, manifest)?;
    }
    sums.insert(layout::CHAIN_FILE.to_owned(), sha256(whole));
    disk.replace(&path, sums::text(&sums).as_bytes())
}
