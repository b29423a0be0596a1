//! Making a store, and finding out at opening what it holds.

use std::path::Path;

use super::disk::{self, Disk};
use super::error::StoreError;
use super::manifest::Counter;
use super::{FlightRef, Index, Recovery, catalogue, installations, jsonl, layout, live};
use crate::clock::Stamp;

/// Makes a store; its mark is written last, so that a crash leaves an empty directory that counts as none.
pub(super) fn create(disk: &dyn Disk, root: &Path) -> Result<(), StoreError> {
    make_root(disk, root)?;
    refuse_foreign(disk, root)?;
    for name in [layout::INCOMING, layout::FLIGHTS, layout::PARTIAL] {
        ensure_dir(disk, root, name)?;
    }
    save_counter(disk, root, 1, 1)?;
    write_mark(disk, root, &installations::random_id()?)
}

/// Writes `store.toml` with the place for pending results beside it.
pub(super) fn write_mark(disk: &dyn Disk, root: &Path, id: &str) -> Result<(), StoreError> {
    let pending = root.join(layout::PENDING_FILE);
    disk.write(&pending, b"").map_err(StoreError::io(&pending, "write"))?;
    let path = root.join(layout::STORE_FILE);
    let text = mark(id);
    disk::replace(disk, &path, text.as_bytes()).map_err(StoreError::io(&path, "write"))
}

/// The text of `store.toml`.
pub(super) fn mark(id: &str) -> String {
    format!(
        "# A store of wingd; docs/store.md says what is where.\nformat = {}\nid = \"{id}\"\ncreated_by = \"wingd {}\"\n",
        layout::FORMAT,
        env!("CARGO_PKG_VERSION")
    )
}

/// Whether opening would make a store here: nothing is there yet, or nothing but what may be.
pub fn is_vacant(disk: &dyn Disk, root: &Path) -> bool {
    !disk.exists(root) || (!disk.exists(&root.join(layout::STORE_FILE)) && refuse_foreign(disk, root).is_ok())
}

/// Why this user could not record at a path: what is there, or the nearest folder above it, refuses to be written.
pub fn unwritable(disk: &dyn Disk, root: &Path) -> Option<String> {
    let there = root.ancestors().map(|p| if p.as_os_str().is_empty() { Path::new(".") } else { p });
    let refused = there.into_iter().find(|p| p.exists()).and_then(refuses);
    refused.or_else(|| unwritable_inside(disk, root, FOLDERS_DEEP))
}

/// Store, flights, a flight: what lies in these is written again, a series' frames are not.
const FOLDERS_DEEP: usize = 3;

fn unwritable_inside(disk: &dyn Disk, folder: &Path, deep: usize) -> Option<String> {
    let entries = disk.list(folder).unwrap_or_default();
    let ours = entries.iter().filter(|entry| entry.name != "lost+found" && !entry.is_link);
    ours.map(|entry| (folder.join(&entry.name), entry.is_dir)).find_map(|(path, is_dir)| {
        let inside = || if is_dir && deep > 1 { unwritable_inside(disk, &path, deep - 1) } else { None };
        refuses(&path).or_else(inside)
    })
}

fn refuses(path: &Path) -> Option<String> {
    let refused = rustix::fs::access(path, rustix::fs::Access::WRITE_OK).err()?;
    Some(format!("{} cannot be written to ({refused})", path.display()))
}

/// The parent is synced where the directory is there already, too: an earlier start may have failed between.
pub(super) fn make_root(disk: &dyn Disk, root: &Path) -> Result<(), StoreError> {
    let parent = root.parent().filter(|parent| !parent.as_os_str().is_empty());
    let place = parent.unwrap_or(Path::new("."));
    if disk.exists(root) {
        // Somebody else may have made it, in a place that this user cannot read.
        let _ = disk.sync_dir(place);
        return Ok(());
    }
    if let Some(parent) = parent {
        make_root(disk, parent)?;
    }
    disk.create_dir(root).map_err(StoreError::io(root, "create"))?;
    disk.sync_dir(place).map_err(StoreError::io(place, "sync"))
}

/// A directory without a mark may hold what a broken-off creation leaves, and nothing else.
pub(super) fn refuse_foreign(disk: &dyn Disk, root: &Path) -> Result<(), StoreError> {
    for entry in disk.list(root).map_err(StoreError::io(root, "list"))? {
        let name = entry.name.trim_end_matches(layout::PART_ENDING);
        let ours = [layout::INCOMING, layout::FLIGHTS, layout::PARTIAL, layout::COUNTER_FILE];
        let marks = [layout::STORE_FILE, layout::LOCK_FILE, layout::PENDING_FILE];
        let known = ours.contains(&name) || marks.contains(&name);
        let empty = !entry.is_dir || disk.list(&root.join(&entry.name)).is_ok_and(|list| list.is_empty());
        let harmless = name == "lost+found" || (known && empty);
        if !harmless {
            let why = format!("it has no {} but holds {}", layout::STORE_FILE, entry.name);
            return Err(StoreError::NotAStore { path: root.to_owned(), why });
        }
    }
    Ok(())
}

/// Synced where the directory is there already, too: an earlier call may have failed between.
pub(super) fn ensure_dir(disk: &dyn Disk, root: &Path, name: &str) -> Result<(), StoreError> {
    let path = root.join(name);
    if !disk.exists(&path) {
        disk.create_dir(&path).map_err(StoreError::io(&path, "create"))?;
    }
    disk.sync_dir(root).map_err(StoreError::io(root, "sync"))
}

pub(super) fn save_counter(
    disk: &dyn Disk,
    root: &Path,
    next_flight: u64,
    next_series: u64,
) -> Result<(), StoreError> {
    let path = root.join(layout::COUNTER_FILE);
    let text = jsonl::line(&Counter { next_flight, next_series }).map_err(StoreError::io(&path, "write"))?;
    disk::replace(disk, &path, &text).map_err(StoreError::io(&path, "write"))
}

/// Reads the counter and the newest flight. Ids on disk win over a counter that was lost or set back.
pub(super) fn scan(disk: &dyn Disk, root: &Path, recovery: &mut Recovery) -> Result<Index, StoreError> {
    let mut index = Index { next_flight: 1, next_series: 1, ..Index::default() };
    let path = root.join(layout::COUNTER_FILE);
    let counter = disk.read(&path).ok().and_then(|bytes| serde_json::from_slice::<Counter>(&bytes).ok());
    for flight in catalogue::flights(disk, root)? {
        index.next_flight = layout::flight_number(&flight.id).unwrap_or(0).saturating_add(1);
        for series in catalogue::series(disk, &flight)? {
            let next = layout::series_number(&series.id).unwrap_or(0).saturating_add(1);
            index.next_series = index.next_series.max(next);
        }
        index.last = last_moment(disk, &flight).or(index.last);
        index.flight = Some(flight.id);
    }
    for entry in disk.list(&root.join(layout::INCOMING)).unwrap_or_default() {
        let next = layout::series_number(&entry.name).unwrap_or(0).saturating_add(1);
        index.next_series = index.next_series.max(next);
    }
    let on_disk = (index.next_flight, index.next_series);
    if let Some(counter) = counter {
        index.next_flight = index.next_flight.max(counter.next_flight);
        index.next_series = index.next_series.max(counter.next_series);
    }
    if counter.is_none_or(|c| c.next_flight < on_disk.0 || c.next_series < on_disk.1) {
        recovery.remarks.push("counter.json was damaged or behind; mended from the ids on disk".to_owned());
        save_counter(disk, root, index.next_flight, index.next_series)?;
    }
    Ok(index)
}

/// The last moment recorded in a flight.
fn last_moment(disk: &dyn Disk, flight: &FlightRef) -> Option<Stamp> {
    let series = catalogue::series(disk, flight).ok()?;
    let last = series.iter().rev().find_map(|series| catalogue::manifest(disk, series).ok());
    let of_series = last.and_then(|manifest| {
        let shot = manifest.shots.last().map(|shot| shot.stamp.clone());
        manifest.ended.or(shot).or(manifest.started)
    });
    let of_flight = || catalogue::flight_manifest(disk, flight).ok().map(|manifest| manifest.started);
    let later = |a: Stamp, b: Stamp| if later(&b, &a) { b } else { a };
    of_series.or_else(of_flight).into_iter().chain(live::last_moment(disk, flight)).reduce(later)
}

fn later(one: &Stamp, other: &Stamp) -> bool {
    if one.boot_id == other.boot_id { one.since_boot_s > other.since_boot_s } else { one.utc > other.utc }
}
