//! Creation of a store, and the scan at opening.

use std::path::Path;

use super::index::StoreIndex;
use super::recover::Recovery;
use super::root::StoreRoot;
use crate::disk::owner::{Owner, service_owner};
use crate::disk::{Disk, Lock, StoreError, StoreResult, fill_random};
use crate::format::manifest::Counter;
use crate::format::{jsonl, layout};
use crate::read::catalogue;
use crate::read::catalogue::FlightRef;
use crate::read::live;
use wingd_base::clock::Stamp;

/// Creates a store; its format file is written last, so that a crash leaves a directory that counts as empty.
pub(super) fn create_store(root: StoreRoot<'_>) -> StoreResult<()> {
    make_root(root.disk, root.path)?;
    refuse_foreign(root.disk, root.path)?;
    root.ensure_folders()?;
    save_counter(root, &Counter::FIRST)?;
    write_format_file(root, &random_id()?)
}

/// Rebuilds a damaged or missing format file from the flights' chains, which hold the store's id; without flights the store
/// gets a new id. Returns a remark if it did. A store whose flights have no chains, or those of several stores, is left as
/// it is.
pub(super) fn rebuild_format_file(root: StoreRoot<'_>) -> StoreResult<Option<String>> {
    let path = root.join(layout::STORE_FILE);
    let damaged = match catalogue::check_format_file(root.disk, root.path) {
        Err(StoreError::Damaged { .. }) => true,
        Err(StoreError::NotAStore { .. }) => false,
        _ => return Ok(None),
    };
    let flights = catalogue::list_flights(root.disk, root.path).unwrap_or_default();
    // Without a flight, a new id is as good as the old one; an incomplete copy is not a store.
    if flights.is_empty() && !damaged || root.disk.exists(&root.join(layout::FETCHING)) {
        return Ok(None);
    }
    let chains = flights.iter().map(|flight| {
        catalogue::read_chain(root.disk, &flight.folder)
            .ok()?
            .1
            .store_id()
    });
    let mut ids = chains.collect::<Option<Vec<String>>>().unwrap_or_default();
    ids.dedup();
    let (id, how) = match (ids.as_slice(), flights.is_empty()) {
        ([id], _) => (id.clone(), "rebuilt from the flights' chains"),
        ([], true) => (
            random_id()?,
            "written with a new id, because the store has no flights",
        ),
        _ => return Ok(None),
    };
    let _lock = lock_store(root)?;
    root.disk
        .replace_file(&path, format_file_text(&id).as_bytes())?;
    Ok(Some(format!(
        "{} was damaged or missing; {how}",
        layout::STORE_FILE
    )))
}

/// Maximum length of the name of the lock's holder, bytes.
const MAX_HOLDER: usize = 100;

/// Takes the lock, which is released when the returned guard is dropped.
pub(crate) fn lock_store(root: StoreRoot<'_>) -> StoreResult<Lock> {
    let path = root.join(layout::LOCK_FILE);
    let lock = root
        .disk
        .lock(&path)
        .map_err(StoreError::io(&path, "lock"))?;
    lock.ok_or_else(|| {
        let named = root.disk.read_range(&path, 0, MAX_HOLDER);
        let named = String::from_utf8_lossy(&named.unwrap_or_default()).into_owned();
        let holder = if named.is_empty() {
            "another wingd".to_owned()
        } else {
            named
        };
        StoreError::Locked { path, holder }
    })
}

/// Writes the format file, `store.toml`, and an empty `pending.json`.
pub(crate) fn write_format_file(root: StoreRoot<'_>, id: &str) -> StoreResult<()> {
    root.disk.save_file(&root.join(layout::PENDING_FILE), b"")?;
    root.disk.replace_file(
        &root.join(layout::STORE_FILE),
        format_file_text(id).as_bytes(),
    )
}

/// Returns a random id for a store: 128 bits, hex.
pub fn random_id() -> StoreResult<String> {
    let mut bytes = [0; 16];
    let path = Path::new("/dev/urandom");
    fill_random(&mut bytes).map_err(StoreError::io(path, "read"))?;
    Ok(hex::encode(bytes))
}

/// Returns the text of `store.toml`.
fn format_file_text(id: &str) -> String {
    format!(
        "# A store of wingd; docs/store.md says what is where.\nformat = {}\nid = \"{id}\"\ncreated_by = \"wingd {}\"\n",
        layout::FORMAT,
        env!("CARGO_PKG_VERSION")
    )
}

/// Returns whether opening would create a store here: the directory does not exist, or has no foreign files.
pub fn is_vacant(disk: &dyn Disk, root: &Path) -> bool {
    !disk.exists(root)
        || (!disk.exists(&root.join(layout::STORE_FILE)) && refuse_foreign(disk, root).is_ok())
}

/// Returns the reason for which this user, or the store's owner if root asks, could not record at a path: it, or the nearest existing folder above it, is not
/// writable.
pub fn unwritable_reason(disk: &dyn Disk, root: &Path) -> Option<String> {
    let there = root.ancestors().map(|p| {
        if p.as_os_str().is_empty() {
            Path::new(".")
        } else {
            p
        }
    });
    let owner = service_owner(root);
    let refused = there
        .into_iter()
        .find(|p| p.exists())
        .and_then(|path| write_refusal(path, owner));
    // Rewritten are files of store, flights and flight, not the frames of a series.
    let inside = disk.walk(root, 3).into_iter();
    let mut ours = inside.filter(|(path, entry)| !path.ends_with("lost+found") && !entry.is_link);
    refused.or_else(|| ours.find_map(|(path, _)| write_refusal(&path, owner)))
}

/// Returns the reason for which a path cannot be written to; `owner`: the user that runs the recorder, if it is not this one.
fn write_refusal(path: &Path, owner: Option<Owner>) -> Option<String> {
    if owner.is_some_and(|owner| !owner.can_write(path)) {
        return Some(format!(
            "{} cannot be written to by the store's owner",
            path.display()
        ));
    }
    let refused = rustix::fs::access(path, rustix::fs::Access::WRITE_OK).err()?;
    Some(format!(
        "{} cannot be written to ({refused})",
        path.display()
    ))
}

/// Creates the root directory. The parent is synced even if the directory exists: an earlier start may have failed before
/// that.
pub(crate) fn make_root(disk: &dyn Disk, root: &Path) -> StoreResult<()> {
    let parent = root
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty());
    let place = parent.unwrap_or(Path::new("."));
    if disk.exists(root) {
        // Another user may have created it, in a folder that this user cannot read.
        let _ = disk.sync_dir(place);
        return Ok(());
    }
    if let Some(parent) = parent {
        make_root(disk, parent)?;
    }
    disk.make_dir(root)?;
    disk.sync_directory(place)
}

/// Refuses a directory without format file that has anything other than the remains of an interrupted creation.
pub(crate) fn refuse_foreign(disk: &dyn Disk, root: &Path) -> StoreResult<()> {
    for entry in disk.list_entries(root)? {
        let name = entry.name.trim_end_matches(layout::PART_ENDING);
        let ours = [
            layout::INCOMING,
            layout::FLIGHTS,
            layout::PARTIAL,
            layout::COUNTER_FILE,
        ];
        let empty_files = [layout::STORE_FILE, layout::LOCK_FILE, layout::PENDING_FILE];
        let known = ours.contains(&name) || empty_files.contains(&name);
        let empty = !entry.is_dir
            || disk
                .list(&root.join(&entry.name))
                .is_ok_and(|list| list.is_empty());
        let harmless = name == "lost+found" || (known && empty);
        if !harmless {
            let why = format!("it has no {} but holds {}", layout::STORE_FILE, entry.name);
            return Err(StoreError::NotAStore {
                path: root.to_owned(),
                why,
            });
        }
    }
    Ok(())
}

/// Writes the next ids.
pub(crate) fn save_counter(root: StoreRoot<'_>, counter: &Counter) -> StoreResult<()> {
    let path = root.join(layout::COUNTER_FILE);
    root.disk.replace_file(
        &path,
        &jsonl::encode_line(counter).map_err(StoreError::io(&path, "write"))?,
    )
}

/// Reads the counter and the newest flight. Ids on disk take precedence over a counter that was lost or set back.
pub(super) fn scan_store(root: StoreRoot<'_>, recovery: &mut Recovery) -> StoreResult<StoreIndex> {
    let disk = root.disk;
    let (mut on_disk, mut newest, mut last) = (Counter::FIRST, None, None);
    for flight in catalogue::list_flights(disk, root.path)? {
        on_disk.advance_past(&flight.id);
        catalogue::list_series(disk, &flight)?
            .iter()
            .for_each(|series| on_disk.advance_past(&series.id));
        last = last_moment(disk, &flight).or(last);
        newest = Some(flight.id);
    }
    let incoming = disk.list(&root.join(layout::INCOMING)).unwrap_or_default();
    let series = incoming
        .iter()
        .filter(|entry| layout::series_number(&entry.name).is_some());
    series.for_each(|entry| on_disk.advance_past(&entry.name));
    let saved = disk
        .load_json::<Counter>(&root.join(layout::COUNTER_FILE))
        .filter(Counter::is_plausible);
    let counter = saved.map_or(on_disk, |saved| saved.merge(on_disk));
    if saved != Some(counter) {
        recovery
            .remarks
            .push("counter.json was damaged or behind; restored from the ids on disk".to_owned());
        save_counter(root, &counter)?;
    }
    Ok(StoreIndex::new(counter, newest, last))
}

/// Returns the last time recorded in a flight.
fn last_moment(disk: &dyn Disk, flight: &FlightRef) -> Option<Stamp> {
    let series = catalogue::list_series(disk, flight).ok()?;
    let last = series
        .iter()
        .rev()
        .find_map(|series| catalogue::read_series_manifest(disk, series).ok());
    let of_series = last.and_then(|manifest| {
        let shot = manifest.shots.last().map(|shot| shot.stamp.clone());
        manifest.ended.or(shot).or(manifest.started)
    });
    let of_flight = || {
        catalogue::read_flight_manifest(disk, flight)
            .ok()
            .map(|manifest| manifest.started)
    };
    let later = |a: Stamp, b: Stamp| if is_later_stamp(&b, &a) { b } else { a };
    of_series
        .or_else(of_flight)
        .into_iter()
        .chain(live::last_file_start(disk, flight))
        .reduce(later)
}

fn is_later_stamp(one: &Stamp, other: &Stamp) -> bool {
    if one.boot_id == other.boot_id {
        one.since_boot_s > other.since_boot_s
    } else {
        one.utc > other.utc
    }
}
