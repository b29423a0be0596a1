//! After a crash: what is whole in `incoming/` becomes an interrupted series, what is half goes to `partial/`.

use std::path::Path;

use super::chain::{self, Event};
use super::disk::{Disk, Entry};
use super::error::StoreError;
use super::manifest::{Failure, FlightManifest, JournalHead, JournalLine, SeriesManifest, Shot, State};
use super::results::sha256;
use super::series::UnderWay;
use super::{catalogue, jsonl, layout, results, series, sums};

/// What was found and mended.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Recovery {
    /// Series that became `interrupted` or whose last step was finished.
    pub series: Vec<String>,
    /// Names under `partial/` of what was half.
    pub set_aside: Vec<String>,
    /// What a person should read.
    pub remarks: Vec<String>,
}

/// Empties `incoming/` but for series that this process has under way. May be broken off at any step and called again. What cannot be recovered now
/// (a full disk) stays where it is, is remarked, and does not keep new series from being taken.
pub(crate) fn recover(disk: &dyn Disk, root: &Path, under_way: &UnderWay) -> Result<Recovery, StoreError> {
    let incoming = root.join(layout::INCOMING);
    let mut found = Recovery::default();
    // Flights first ("f" < "s"): a series needs its flight's folder.
    let entries = disk.list(&incoming).map_err(StoreError::io(&incoming, "list"))?;
    for entry in entries.into_iter().filter(|entry| !under_way.has(&entry.name)) {
        if let Err(error) = recover_entry(disk, root, &entry, &mut found) {
            found.remarks.push(format!("{} stays in incoming: {error}", entry.name));
        }
    }
    if let Err(error) = results::settle(disk, root) {
        found.remarks.push(format!("the last result: {error}"));
    }
    Ok(found)
}

fn recover_entry(
    disk: &dyn Disk,
    root: &Path,
    entry: &Entry,
    found: &mut Recovery,
) -> Result<(), StoreError> {
    let folder = root.join(layout::INCOMING).join(&entry.name);
    if entry.is_dir && layout::series_number(&entry.name).is_some() {
        recover_series(disk, root, &entry.name, found)
    } else if entry.is_dir && whole_flight(disk, &folder) {
        disk.sync_dir(&folder).map_err(StoreError::io(&folder, "sync"))?;
        series::move_durably(disk, &folder, &root.join(layout::FLIGHTS).join(&entry.name))
    } else {
        quarantine(disk, root, &folder, &entry.name, found)
    }
}

fn whole_flight(disk: &dyn Disk, folder: &Path) -> bool {
    let read = disk.read(&folder.join(layout::FLIGHT_FILE));
    let manifest = read.ok().and_then(|bytes| serde_json::from_slice::<FlightManifest>(&bytes).ok());
    manifest.is_some_and(|manifest| folder.file_name().is_some_and(|name| name == manifest.flight.as_str()))
}

fn recover_series(disk: &dyn Disk, root: &Path, id: &str, found: &mut Recovery) -> Result<(), StoreError> {
    let folder = layout::incoming(root, id);
    let manifest = match closed(disk, &folder, id) {
        Some(manifest) => manifest,
        None => match rebuild(disk, root, id, found)? {
            Some(manifest) => {
                series::write_manifest(disk, &folder, &manifest)?;
                manifest
            }
            None => {
                found.remarks.push(format!("{id}: broken off before its first shot"));
                return quarantine(disk, root, &folder, id, found);
            }
        },
    };
    clear(disk, root, &folder, &manifest, found)?;
    ensure_flight(disk, root, &manifest)?;
    series::commit(disk, root, &folder, &manifest)?;
    found.series.push(id.to_owned());
    Ok(())
}

/// The manifest, where the series was closed and only the rename is missing.
fn closed(disk: &dyn Disk, folder: &Path, id: &str) -> Option<SeriesManifest> {
    let bytes = disk.read(&folder.join(layout::SERIES_FILE)).ok()?;
    let manifest: SeriesManifest = serde_json::from_slice(&bytes).ok()?;
    (manifest.series == id && layout::flight_number(&manifest.flight).is_some()).then_some(manifest)
}

/// A manifest from the journal; `None` where not even its head was written.
fn rebuild(
    disk: &dyn Disk,
    root: &Path,
    id: &str,
    found: &mut Recovery,
) -> Result<Option<SeriesManifest>, StoreError> {
    let folder = layout::incoming(root, id);
    let path = folder.join(layout::JOURNAL_FILE);
    if !disk.exists(&path) {
        return Ok(None);
    }
    let bytes = disk.read(&path).map_err(StoreError::io(&path, "read"))?;
    let lines = jsonl::parse::<JournalLine>(&bytes);
    let Some(mut manifest) = head(id, &lines.good) else { return Ok(None) };
    for (_, line) in lines.good {
        match line {
            JournalLine::Head(_) => {}
            JournalLine::Camera(camera) => manifest.camera = camera,
            JournalLine::Remark(remark) => manifest.remarks.push(remark),
            JournalLine::Shot(shot) => manifest.shots.push(judge(disk, root, &folder, id, *shot, found)?),
        }
    }
    if let Some(tail) = bytes.get(lines.good_length..).filter(|tail| !tail.is_empty()) {
        let name = format!("{id}-journal.torn");
        super::results::set_aside(disk, root, &name, tail)?;
        found.set_aside.push(name);
    }
    for number in lines.damaged {
        manifest.remarks.push(format!("line {number} of the journal was damaged"));
    }
    Ok(Some(manifest))
}

fn head(id: &str, lines: &[(usize, JournalLine)]) -> Option<SeriesManifest> {
    let head: &JournalHead = lines.iter().find_map(|(_, line)| match line {
        JournalLine::Head(head) => Some(head),
        _ => None,
    })?;
    layout::flight_number(&head.flight)?;
    Some(SeriesManifest {
        format: layout::SERIES_FORMAT,
        series: id.to_owned(),
        flight: head.flight.clone(),
        state: State::Interrupted,
        cause: head.cause,
        started: Some(head.started.clone()),
        ended: None,
        planned_shots: head.planned_shots,
        camera: serde_json::Map::new(),
        shots: Vec::new(),
        remarks: vec!["not closed by the daemon; put together at its next start".to_owned()],
    })
}

/// Keeps a shot's frame where its bytes are whole, by the hash in the journal.
fn judge(
    disk: &dyn Disk,
    root: &Path,
    folder: &Path,
    id: &str,
    mut shot: Shot,
    found: &mut Recovery,
) -> Result<Shot, StoreError> {
    let Some(entry) = &shot.frame else { return Ok(shot) };
    let path = folder.join(&entry.file);
    let part = folder.join(format!("{}{}", entry.file, layout::PART_ENDING));
    let whole = |path: &Path| disk.read(path).ok().filter(|bytes| sha256(bytes) == entry.sha256);
    if !layout::is_frame_name(&entry.file) {
        return Ok(Shot { frame: None, exposure: None, ..shot });
    }
    if whole(&path).is_some() {
        return Ok(shot);
    }
    if let Some(bytes) = whole(&part) {
        // Written anew: its fsync may have failed, and then it is only seen to be whole.
        super::disk::replace(disk, &part, &bytes).map_err(StoreError::io(&part, "write"))?;
        series::move_durably(disk, &part, &path)?;
        return Ok(shot);
    }
    let name = format!("{id}-{}", entry.file);
    for half in [path, part].iter().filter(|half| disk.exists(half)) {
        series::move_durably(disk, half, &root.join(layout::PARTIAL).join(&name))?;
        found.set_aside.push(name.clone());
    }
    let kept = disk.exists(&root.join(layout::PARTIAL).join(&name));
    shot.failures.push(Failure {
        kind: "store".to_owned(),
        reason: "the daemon or the power stopped before the frame was durable".to_owned(),
        kept_as: kept.then_some(name),
    });
    shot.frame = None;
    Ok(shot)
}

/// Moves everything that the manifest does not name out of the folder.
fn clear(
    disk: &dyn Disk,
    root: &Path,
    folder: &Path,
    manifest: &SeriesManifest,
    found: &mut Recovery,
) -> Result<(), StoreError> {
    let named = |name: &str| {
        [layout::SERIES_FILE, layout::JOURNAL_FILE].contains(&name)
            || manifest.shots.iter().filter_map(|shot| shot.frame.as_ref()).any(|frame| frame.file == name)
    };
    for entry in disk.list(folder).map_err(StoreError::io(folder, "list"))? {
        if !named(&entry.name) {
            let name = format!("{}-{}", manifest.series, entry.name);
            quarantine(disk, root, &folder.join(&entry.name), &name, found)?;
        }
    }
    Ok(())
}

/// A flight whose folder was moved away by hand is begun again under its name.
fn ensure_flight(disk: &dyn Disk, root: &Path, manifest: &SeriesManifest) -> Result<(), StoreError> {
    let folder = root.join(layout::FLIGHTS).join(&manifest.flight);
    let started = manifest.started.clone().or_else(|| manifest.shots.first().map(|shot| shot.stamp.clone()));
    match started {
        Some(started) if !disk.exists(&folder) => {
            let because = "recovered series of a flight that is not here any more".to_owned();
            make_flight(disk, root, &FlightManifest { flight: manifest.flight.clone(), started, because })
        }
        _ => Ok(()),
    }
}

/// Makes a flight's folder whole in `incoming/` and moves it to its place.
pub(crate) fn make_flight(disk: &dyn Disk, root: &Path, manifest: &FlightManifest) -> Result<(), StoreError> {
    let made = layout::incoming(root, &manifest.flight);
    if !disk.exists(&made) {
        disk.create_dir(&made).map_err(StoreError::io(&made, "create"))?;
    }
    let path = made.join(layout::FLIGHT_FILE);
    let text = serde_json::to_vec_pretty(manifest).map_err(|e| StoreError::io(&path, "write")(e.into()))?;
    // flight.json comes last: a folder that has it is whole.
    if let Some(store) = catalogue::store_id(disk, root) {
        begin_evidence(disk, &made, store, &manifest.flight, sha256(&text))?;
    }
    super::disk::replace(disk, &path, &text).map_err(StoreError::io(&path, "write"))?;
    series::move_durably(disk, &made, &root.join(layout::FLIGHTS).join(&manifest.flight))
}

/// The first line of a flight's chain, and its sums.
fn begin_evidence(
    disk: &dyn Disk,
    made: &Path,
    store: String,
    flight: &str,
    sha256: String,
) -> Result<(), StoreError> {
    let begun = Event::Flight { store, flight: flight.to_owned(), sha256: sha256.clone() };
    let path = made.join(layout::CHAIN_FILE);
    let line = chain::lines([begun]).map_err(StoreError::io(&path, "write"))?;
    super::disk::replace(disk, &path, &line).map_err(StoreError::io(&path, "write"))?;
    let sums = sums::Sums::from([
        (layout::FLIGHT_FILE.to_owned(), sha256),
        (layout::CHAIN_FILE.to_owned(), results::sha256(&line)),
    ]);
    let path = made.join(layout::SUMS_FILE);
    super::disk::replace(disk, &path, sums::text(&sums).as_bytes()).map_err(StoreError::io(&path, "write"))
}

/// Moves a file or folder to `partial/` under a name that is free there.
fn quarantine(
    disk: &dyn Disk,
    root: &Path,
    from: &Path,
    name: &str,
    found: &mut Recovery,
) -> Result<(), StoreError> {
    let partial = root.join(layout::PARTIAL);
    let mut free = name.to_owned();
    let mut copy = 2;
    while disk.exists(&partial.join(&free)) {
        free = format!("{name}.{copy}");
        copy += 1;
    }
    series::move_durably(disk, from, &partial.join(&free))?;
    found.set_aside.push(free);
    Ok(())
}
