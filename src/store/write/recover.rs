//! After a crash: what is whole in `incoming/` becomes an interrupted series, what is half goes to `partial/`.

use std::path::Path;

use super::root::Root;
use super::series::UnderWay;
use super::{results, series};
use crate::store::disk::{Disk, Entry, StoreError};
use crate::store::format::chain::{self, Event};
use crate::store::format::manifest::{Failure, FlightManifest, JournalLine, SeriesManifest, Shot};
use crate::store::format::{jsonl, layout, sha256, sums};
use crate::store::read::catalogue;

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

/// Empties `incoming/` but for series that this process has under way. May be broken off at any step and called again.
/// What cannot be recovered now (a full disk) stays where it is, is remarked, and does not keep new series from being
/// taken.
pub(super) fn recover(root: Root<'_>, under_way: &UnderWay) -> Result<Recovery, StoreError> {
    let mut recovering = Recovering { root, found: Recovery::default() };
    // Flights first ("f" < "s"): a series needs its flight's folder.
    let entries = root.disk.entries(&root.join(layout::INCOMING))?;
    for entry in entries.into_iter().filter(|entry| !under_way.has(&entry.name)) {
        if let Err(error) = recovering.entry(&entry) {
            recovering.found.remarks.push(format!("{} stays in incoming: {error}", entry.name));
        }
    }
    let mut found = recovering.found;
    if let Err(error) = results::settle(root) {
        found.remarks.push(format!("the last result: {error}"));
    }
    Ok(found)
}

struct Recovering<'a> {
    root: Root<'a>,
    found: Recovery,
}

impl Recovering<'_> {
    fn entry(&mut self, entry: &Entry) -> Result<(), StoreError> {
        let (root, folder) = (self.root, layout::incoming(self.root.path, &entry.name));
        if entry.is_dir && layout::series_number(&entry.name).is_some() {
            self.series(&folder, &entry.name)
        } else if entry.is_dir && whole_flight(root.disk, &folder) {
            root.disk.sync(&folder)?;
            root.disk.move_durably(&folder, &root.flight(&entry.name))
        } else {
            self.quarantine(&folder, &entry.name)
        }
    }

    fn series(&mut self, folder: &Path, id: &str) -> Result<(), StoreError> {
        let manifest = match closed(self.root.disk, folder, id) {
            Some(manifest) => manifest,
            None => {
                let Some(manifest) = self.rebuild(folder, id)? else {
                    self.found.remarks.push(format!("{id}: broken off before its first shot"));
                    return self.quarantine(folder, id);
                };
                series::write_manifest(self.root.disk, folder, &manifest)?;
                manifest
            }
        };
        self.clear(folder, &manifest)?;
        ensure_flight(self.root, &manifest)?;
        series::commit(self.root, folder, &manifest)?;
        self.found.series.push(id.to_owned());
        Ok(())
    }

    /// A manifest from the journal; `None` where not even its head was written.
    fn rebuild(&mut self, folder: &Path, id: &str) -> Result<Option<SeriesManifest>, StoreError> {
        let bytes = self.root.disk.load_if_there(&folder.join(layout::JOURNAL_FILE))?.unwrap_or_default();
        let lines = jsonl::parse::<JournalLine>(&bytes);
        let Some(mut manifest) = begun(id, &lines.good) else { return Ok(None) };
        for (_, line) in lines.good {
            match line {
                JournalLine::Head(_) => {}
                JournalLine::Camera(camera) => manifest.camera = camera,
                JournalLine::Remark(remark) => manifest.remarks.push(remark),
                JournalLine::Shot(shot) => manifest.shots.push(self.judge(folder, id, *shot)?),
            }
        }
        let name = format!("{id}-journal.torn");
        if self.root.set_tail_aside(&name, &bytes, lines.good_length)? {
            self.found.set_aside.push(name);
        }
        for number in lines.damaged {
            manifest.remarks.push(format!("line {number} of the journal was damaged"));
        }
        Ok(Some(manifest))
    }

    /// Keeps a shot's frame where its bytes are whole, by the hash in the journal.
    fn judge(&mut self, folder: &Path, id: &str, mut shot: Shot) -> Result<Shot, StoreError> {
        let Some(entry) = &shot.frame else { return Ok(shot) };
        let disk = self.root.disk;
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
            disk.replace(&part, &bytes)?;
            disk.move_durably(&part, &path)?;
            return Ok(shot);
        }
        let name = format!("{id}-{}", entry.file);
        let kept = self.root.join(layout::PARTIAL).join(&name);
        for half in [path, part].iter().filter(|half| disk.exists(half)) {
            disk.move_durably(half, &kept)?;
            self.found.set_aside.push(name.clone());
        }
        shot.failures.push(Failure {
            kind: "store".to_owned(),
            reason: "the daemon or the power stopped before the frame was durable".to_owned(),
            kept_as: disk.exists(&kept).then_some(name),
        });
        shot.frame = None;
        Ok(shot)
    }

    /// Moves everything that the manifest does not name out of the folder.
    fn clear(&mut self, folder: &Path, manifest: &SeriesManifest) -> Result<(), StoreError> {
        let named = |name: &str| {
            let mut frames = manifest.frames();
            [layout::SERIES_FILE, layout::JOURNAL_FILE].contains(&name)
                || frames.any(|frame| frame.file == name)
        };
        for entry in self.root.disk.entries(folder)? {
            if !named(&entry.name) {
                let name = format!("{}-{}", manifest.series, entry.name);
                self.quarantine(&folder.join(&entry.name), &name)?;
            }
        }
        Ok(())
    }

    /// Moves a file or folder to `partial/` under a name that is free there.
    fn quarantine(&mut self, from: &Path, name: &str) -> Result<(), StoreError> {
        let partial = self.root.join(layout::PARTIAL);
        let mut free = name.to_owned();
        let mut copy = 2;
        while self.root.disk.exists(&partial.join(&free)) {
            free = format!("{name}.{copy}");
            copy += 1;
        }
        self.root.disk.move_durably(from, &partial.join(&free))?;
        self.found.set_aside.push(free);
        Ok(())
    }
}

fn whole_flight(disk: &dyn Disk, folder: &Path) -> bool {
    let manifest = disk.json::<FlightManifest>(&folder.join(layout::FLIGHT_FILE));
    manifest.is_some_and(|manifest| folder.file_name().is_some_and(|name| name == manifest.flight.as_str()))
}

/// The manifest, where the series was closed and only the rename is missing.
fn closed(disk: &dyn Disk, folder: &Path, id: &str) -> Option<SeriesManifest> {
    let manifest = disk.json::<SeriesManifest>(&folder.join(layout::SERIES_FILE))?;
    (manifest.series == id && layout::flight_number(&manifest.flight).is_some()).then_some(manifest)
}

fn begun(id: &str, lines: &[(usize, JournalLine)]) -> Option<SeriesManifest> {
    let head = lines.iter().find_map(|(_, line)| match line {
        JournalLine::Head(head) => Some(head.clone()),
        _ => None,
    })?;
    layout::flight_number(&head.flight)?;
    let remarks = vec!["not closed by the daemon; put together at its next start".to_owned()];
    Some(SeriesManifest { remarks, ..SeriesManifest::begun(id, head) })
}

/// A flight whose folder was moved away by hand is begun again under its name.
fn ensure_flight(root: Root<'_>, manifest: &SeriesManifest) -> Result<(), StoreError> {
    let started = manifest.started.clone().or_else(|| manifest.shots.first().map(|shot| shot.stamp.clone()));
    match started {
        Some(started) if !root.disk.exists(&root.flight(&manifest.flight)) => {
            let because = "recovered series of a flight that is not here any more".to_owned();
            let flight = manifest.flight.clone();
            make_flight(root, &FlightManifest { flight, started, because, name: None })
        }
        _ => Ok(()),
    }
}

/// Makes a flight's folder whole in `incoming/` and moves it to its place.
pub(super) fn make_flight(root: Root<'_>, manifest: &FlightManifest) -> Result<(), StoreError> {
    let made = layout::incoming(root.path, &manifest.flight);
    if !root.disk.exists(&made) {
        root.disk.make_dir(&made)?;
    }
    let path = made.join(layout::FLIGHT_FILE);
    let text = serde_json::to_vec_pretty(manifest).map_err(|e| StoreError::io(&path, "write")(e.into()))?;
    // flight.json comes last: a folder that has it is whole.
    if let Some(store) = catalogue::store_id(root.disk, root.path) {
        begin_evidence(root.disk, &made, store, &manifest.flight, sha256(&text))?;
    }
    root.disk.replace(&path, &text)?;
    root.disk.move_durably(&made, &root.flight(&manifest.flight))
}

/// The first line of a flight's chain, and its sums.
fn begin_evidence(
    disk: &dyn Disk,
    made: &Path,
    store: String,
    flight: &str,
    sha256_of_flight: String,
) -> Result<(), StoreError> {
    let begun = Event::Flight { store, flight: flight.to_owned(), sha256: sha256_of_flight.clone() };
    let path = made.join(layout::CHAIN_FILE);
    let line = chain::lines([begun]).map_err(StoreError::io(&path, "write"))?;
    disk.replace(&path, &line)?;
    let sums = sums::Sums::from([
        (layout::FLIGHT_FILE.to_owned(), sha256_of_flight),
        (layout::CHAIN_FILE.to_owned(), sha256(&line)),
    ]);
    disk.replace(&made.join(layout::SUMS_FILE), sums::text(&sums).as_bytes())
}
