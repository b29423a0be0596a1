//! Flights of a local store, picked by name, with their frames and the installation that they are solved with.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use wingd_base::failure::{Failure, TaskResult};
use wingd_store as store;
use wingd_store::{
    Disk, FlightRef, FrameRef, RealDisk, Recovery, Store, StoreConfig, StoreResult, catalogue,
    installations, layout,
};

/// Selects the flights of a store: the one requested, or all.
pub fn select_flights(root: &Path, wanted: Option<&str>) -> TaskResult<Vec<FlightRef>> {
    catalogue::check_format(&RealDisk, root)?;
    let all = catalogue::list_flights(&RealDisk, root)?;
    let Some(wanted) = wanted else { return Ok(all) };
    let known: Vec<&str> = all.iter().map(|flight| flight.id.as_str()).collect();
    let known = known.join(", ");
    let is_wanted = |flight: &&FlightRef| catalogue::is_called(&RealDisk, flight, wanted);
    let found: Vec<FlightRef> = all.iter().filter(is_wanted).cloned().collect();
    if found.is_empty() {
        return Err(Failure::from_path_error(
            root,
            format!("there is no flight {wanted}; available: {known}"),
        ));
    }
    Ok(found)
}

/// Lists a flight's frames in order: those of the series requested, or all.
pub fn flight_frames(
    disk: &dyn Disk,
    flight: &FlightRef,
    wanted: Option<&str>,
) -> StoreResult<Vec<FrameRef>> {
    let mut frames = Vec::new();
    let is_wanted = |id: &str| wanted.is_none_or(|wanted| wanted == id);
    for series in catalogue::list_series(disk, flight)?
        .into_iter()
        .filter(|series| is_wanted(&series.id))
    {
        frames.extend(store::series_frames(
            &series,
            catalogue::read_series_manifest(disk, &series)?,
        ));
    }
    Ok(frames)
}

/// Opens a store for writing, without disk reserve, because nothing is being recorded.
pub fn open_store(root: &Path) -> StoreResult<(Store, Recovery)> {
    Store::open(
        Arc::new(RealDisk),
        StoreConfig {
            reserve_mb: 0,
            ..StoreConfig::new(root)
        },
    )
}

/// Returns the kept installation that a flight's last results came from.
pub fn kept_installation(root: &Path, flight: &FlightRef) -> StoreResult<Option<PathBuf>> {
    let last = installations::flight_installations(&RealDisk, flight)?.pop();
    Ok(last.map(|digest| installations::installation_folder(root, &digest)))
}

/// Returns the installation for solving a flight: the one named, else the kept one that its last results came from, else
/// the only one kept.
///
/// # Errors
/// Returns an error if none is named and the store keeps none or several.
pub fn flight_installation(
    named: Option<&Path>,
    root: &Path,
    flight: &FlightRef,
) -> TaskResult<PathBuf> {
    if let Some(named) = named {
        return Ok(named.to_owned());
    }
    let of_results = kept_installation(root, flight)?;
    of_results
        .map_or_else(|| only_kept_installation(root), |kept| Ok(Some(kept)))?
        .ok_or_else(|| {
            let (root, flight) = (root.display(), &flight.id);
            Failure::Failed(format!(
                "{root}: the store has no installation for {flight}; name one with --installation"
            ))
        })
}

/// Returns a frame's name within its flight, as used in results and marks.
pub fn frame_name(frame: &FrameRef) -> String {
    format!("{}/{}", frame.series.id, frame.entry.file)
}

/// Returns the installation of a store that keeps exactly one: an imported flight has no results to name it.
fn only_kept_installation(root: &Path) -> StoreResult<Option<PathBuf>> {
    let disk: &dyn Disk = &RealDisk;
    let all = disk
        .list_entries(&root.join(layout::INSTALLATIONS))
        .unwrap_or_default();
    match all.as_slice() {
        [one] if one.is_dir => Ok(Some(installations::installation_folder(root, &one.name))),
        _ => Ok(None),
    }
}
