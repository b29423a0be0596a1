//! This file answers what several commands ask of a store on this machine.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::Failure;
use crate::store::{
    self, Disk, FlightRef, FrameRef, RealDisk, Recovery, Store, StoreConfig, StoreError, catalogue,
    installations, layout,
};

/// The flights of a store that a command is about: the one that is named, or all.
pub(super) fn flights(root: &Path, wanted: Option<&str>) -> Result<Vec<FlightRef>, Failure> {
    catalogue::check_format(&RealDisk, root)?;
    let all = catalogue::flights(&RealDisk, root)?;
    let Some(wanted) = wanted else { return Ok(all) };
    let known: Vec<&str> = all.iter().map(|flight| flight.id.as_str()).collect();
    let known = known.join(", ");
    let is_wanted = |flight: &&FlightRef| catalogue::is_called(&RealDisk, flight, wanted);
    let found: Vec<FlightRef> = all.iter().filter(is_wanted).cloned().collect();
    if found.is_empty() {
        let root = root.display();
        return Err(Failure::Failed(format!("{root}: there is no flight {wanted}, only: {known}")));
    }
    Ok(found)
}

/// A flight's frames in order: of the series that is named, or of all.
pub(super) fn frames(
    disk: &dyn Disk,
    flight: &FlightRef,
    wanted: Option<&str>,
) -> Result<Vec<FrameRef>, StoreError> {
    let mut frames = Vec::new();
    let is_wanted = |id: &str| wanted.is_none_or(|wanted| wanted == id);
    for series in catalogue::series(disk, flight)?.into_iter().filter(|series| is_wanted(&series.id)) {
        frames.extend(store::frames(&series, catalogue::manifest(disk, &series)?));
    }
    Ok(frames)
}

/// Opens a store for writing; to the last byte of the disk, for nothing is recorded meanwhile.
pub(super) fn open(root: &Path) -> Result<(Store, Recovery), StoreError> {
    Store::open(Arc::new(RealDisk), StoreConfig { reserve_mb: 0, ..StoreConfig::at(root) })
}

/// The last installation kept that a flight's results came from.
pub(super) fn kept(root: &Path, flight: &FlightRef) -> Result<Option<PathBuf>, StoreError> {
    let last = installations::of_flight(&RealDisk, flight)?.pop();
    Ok(last.map(|digest| installations::folder(root, &digest)))
}

/// The installation that a flight is solved with where none is named: the last one kept that its results came from, or the
/// only one kept.
pub(super) fn installation_of(root: &Path, flight: &FlightRef) -> Result<PathBuf, Failure> {
    let of_results = kept(root, flight)?;
    of_results.map_or_else(|| only_kept(root), |kept| Ok(Some(kept)))?.ok_or_else(|| {
        let (root, flight) = (root.display(), &flight.id);
        Failure::Failed(format!("{root}: no installation is kept for {flight}; name one with --installation"))
    })
}

/// A frame's name among those of its flight, in results and marks.
pub(super) fn name_of(frame: &FrameRef) -> String {
    format!("{}/{}", frame.series.id, frame.entry.file)
}

/// The one installation that a store keeps, where it keeps one alone: nothing of a flight that was imported has been solved.
fn only_kept(root: &Path) -> Result<Option<PathBuf>, StoreError> {
    let disk: &dyn Disk = &RealDisk;
    let all = disk.entries(&root.join(layout::INSTALLATIONS)).unwrap_or_default();
    match all.as_slice() {
        [one] if one.is_dir => Ok(Some(installations::folder(root, &one.name))),
        _ => Ok(None),
    }
}
