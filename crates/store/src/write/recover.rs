//! Recovery after a crash: intact data in `incoming/` becomes an interrupted series, incomplete files go to `partial/`.

use std::path::Path;

use super::root::StoreRoot;
use super::series::ActiveSeries;
use super::{results, series};
use crate::disk::{DirectoryEntry, Disk, StoreError, StoreResult};
use crate::format::chain;
use crate::format::chain::ChainEvent;
use crate::format::manifest::{FlightManifest, JournalLine, SeriesManifest, Shot, ShotFailure};
use crate::format::{jsonl, layout, sha256_hex, sums};
use crate::read::catalogue;

/// Findings and repairs of a recovery.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Recovery {
    /// Series that became `interrupted` or whose last step was finished.
    pub series: Vec<String>,
    /// Names of incomplete files under `partial/`.
    pub set_aside: Vec<String>,
    /// Notes for a person.
    pub remarks: Vec<String>,
}

/// Empties `incoming/`, except for series that this process is recording. It may be interrupted at any step and called
/// again. Entries that cannot be recovered now (for example, because the disk is full) stay, get a remark, and do not block
/// new series.
pub(super) fn recover_incoming(
    root: StoreRoot<'_>,
    under_way: &ActiveSeries,
) -> StoreResult<Recovery> {
    let mut recovering = RecoveryRun {
        root,
        found: Recovery::default(),
    };
    // Flights come first ("f" < "s"): a series needs its flight's folder.
    let entries = root.disk.list_entries(&root.join(layout::INCOMING))?;
    for entry in entries
        .into_iter()
        .filter(|entry| !under_way.contains(&entry.name))
    {
        if let Err(error) = recovering.recover_incoming_entry(&entry) {
            recovering
                .found
                .remarks
                .push(format!("{} remains in incoming: {error}", entry.name));
        }
    }
    let mut found = recovering.found;
    if let Err(error) = results::settle_pending(root) {
        found.remarks.push(format!("the last result: {error}"));
    }
    Ok(found)
}

struct RecoveryRun<'a> {
    root: StoreRoot<'a>,
    found: Recovery,
}

impl RecoveryRun<'_> {
    fn recover_incoming_entry(&mut self, entry: &DirectoryEntry) -> StoreResult<()> {
        let (root, folder) = (
            self.root,
            layout::incoming_folder(self.root.path, &entry.name),
        );
        if entry.is_dir && layout::series_number(&entry.name).is_some() {
            self.recover_series(&folder, &entry.name)
        } else if entry.is_dir && is_complete_flight(root.disk, &folder) {
            root.disk.sync_directory(&folder)?;
            root.disk
                .move_durably(&folder, &root.flight_folder(&entry.name))
        } else {
            self.quarantine(&folder, &entry.name)
        }
    }

    fn recover_series(&mut self, folder: &Path, id: &str) -> StoreResult<()> {
        let manifest = match closed_manifest(self.root.disk, folder, id) {
            Some(manifest) => manifest,
            None => {
                let Some(manifest) = self.rebuild_manifest(folder, id)? else {
                    self.found
                        .remarks
                        .push(format!("{id}: interrupted before its first shot"));
                    return self.quarantine(folder, id);
                };
                series::write_manifest(self.root.disk, folder, &manifest)?;
                manifest
            }
        };
        self.quarantine_unnamed(folder, &manifest)?;
        ensure_flight(self.root, &manifest)?;
        series::commit_series(self.root, folder, &manifest)?;
        self.found.series.push(id.to_owned());
        Ok(())
    }

    /// Rebuilds a manifest from the journal; `None` if not even its head was written.
    fn rebuild_manifest(&mut self, folder: &Path, id: &str) -> StoreResult<Option<SeriesManifest>> {
        let bytes = self
            .root
            .disk
            .load_if_exists(&folder.join(layout::JOURNAL_FILE))?
            .unwrap_or_default();
        let lines = jsonl::parse_lines::<JournalLine>(&bytes);
        let Some(mut manifest) = manifest_from_journal(id, &lines.good) else {
            return Ok(None);
        };
        for (_, line) in lines.good {
            match line {
                JournalLine::Head(_) => {}
                JournalLine::Camera(camera) => manifest.camera = camera,
                JournalLine::Remark(remark) => manifest.remarks.push(remark),
                JournalLine::Shot(shot) => {
                    manifest.shots.push(self.recover_shot(folder, id, *shot)?)
                }
            }
        }
        let name = format!("{id}-journal.torn");
        if self.root.set_tail_aside(&name, &bytes, lines.good_length)? {
            self.found.set_aside.push(name);
        }
        for number in lines.damaged {
            manifest
                .remarks
                .push(format!("line {number} of the journal was damaged"));
        }
        Ok(Some(manifest))
    }

    /// Keeps a shot's frame if its bytes have the digest in the journal.
    fn recover_shot(&mut self, folder: &Path, id: &str, mut shot: Shot) -> StoreResult<Shot> {
        let Some(entry) = &shot.frame else {
            return Ok(shot);
        };
        let disk = self.root.disk;
        let path = folder.join(&entry.file);
        let part = folder.join(format!("{}{}", entry.file, layout::PART_ENDING));
        let whole = |path: &Path| {
            disk.read(path)
                .ok()
                .filter(|bytes| sha256_hex(bytes) == entry.sha256)
        };
        if !layout::is_frame_name(&entry.file) {
            return Ok(Shot {
                frame: None,
                exposure: None,
                ..shot
            });
        }
        if whole(&path).is_some() {
            return Ok(shot);
        }
        if let Some(bytes) = whole(&part) {
            // Written again: if its fsync failed, the intact bytes may not be on the disk.
            disk.replace_file(&part, &bytes)?;
            disk.move_durably(&part, &path)?;
            return Ok(shot);
        }
        let name = format!("{id}-{}", entry.file);
        let kept = self.root.join(layout::PARTIAL).join(&name);
        for half in [path, part].iter().filter(|half| disk.exists(half)) {
            disk.move_durably(half, &kept)?;
            self.found.set_aside.push(name.clone());
        }
        shot.failures.push(ShotFailure {
            kind: "store".to_owned(),
            reason: "the daemon or the power stopped before the frame was durable".to_owned(),
            kept_as: disk.exists(&kept).then_some(name),
        });
        shot.frame = None;
        Ok(shot)
    }

    /// Moves everything that the manifest does not name out of the folder.
    fn quarantine_unnamed(&mut self, folder: &Path, manifest: &SeriesManifest) -> StoreResult<()> {
        let named = |name: &str| {
            let mut frames = manifest.frames();
            [layout::SERIES_FILE, layout::JOURNAL_FILE].contains(&name)
                || frames.any(|frame| frame.file == name)
        };
        for entry in self.root.disk.list_entries(folder)? {
            if !named(&entry.name) {
                let name = format!("{}-{}", manifest.series, entry.name);
                self.quarantine(&folder.join(&entry.name), &name)?;
            }
        }
        Ok(())
    }

    /// Moves a file or folder to `partial/` under an unused name.
    fn quarantine(&mut self, from: &Path, name: &str) -> StoreResult<()> {
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

fn is_complete_flight(disk: &dyn Disk, folder: &Path) -> bool {
    let manifest = disk.load_json::<FlightManifest>(&folder.join(layout::FLIGHT_FILE));
    manifest.is_some_and(|manifest| {
        folder
            .file_name()
            .is_some_and(|name| name == manifest.flight.as_str())
    })
}

/// Returns the manifest if the series was closed and only the rename is missing.
fn closed_manifest(disk: &dyn Disk, folder: &Path, id: &str) -> Option<SeriesManifest> {
    let manifest = disk.load_json::<SeriesManifest>(&folder.join(layout::SERIES_FILE))?;
    (manifest.series == id && layout::flight_number(&manifest.flight).is_some()).then_some(manifest)
}

fn manifest_from_journal(id: &str, lines: &[(usize, JournalLine)]) -> Option<SeriesManifest> {
    let head = lines.iter().find_map(|(_, line)| match line {
        JournalLine::Head(head) => Some(head.clone()),
        _ => None,
    })?;
    layout::flight_number(&head.flight)?;
    let remarks = vec!["not closed by the daemon; reconstructed at its next start".to_owned()];
    Some(SeriesManifest {
        remarks,
        ..SeriesManifest::from_journal_head(id, head)
    })
}

/// Creates a flight again if its folder was moved away manually.
fn ensure_flight(root: StoreRoot<'_>, manifest: &SeriesManifest) -> StoreResult<()> {
    let started = manifest
        .started
        .clone()
        .or_else(|| manifest.shots.first().map(|shot| shot.stamp.clone()));
    match started {
        Some(started) if !root.disk.exists(&root.flight_folder(&manifest.flight)) => {
            let because = "recovered series of a flight that is no longer here".to_owned();
            let flight = manifest.flight.clone();
            make_flight(
                root,
                &FlightManifest {
                    flight,
                    started,
                    because,
                    name: None,
                },
            )
        }
        _ => Ok(()),
    }
}

/// Creates a complete flight folder in `incoming/` and moves it to its place.
pub(super) fn make_flight(root: StoreRoot<'_>, manifest: &FlightManifest) -> StoreResult<()> {
    let made = layout::incoming_folder(root.path, &manifest.flight);
    if !root.disk.exists(&made) {
        root.disk.make_dir(&made)?;
    }
    let path = made.join(layout::FLIGHT_FILE);
    let text = serde_json::to_vec_pretty(manifest)
        .map_err(|e| StoreError::io(&path, "write")(e.into()))?;
    // flight.json is written last: a folder that has it is complete.
    if let Some(store) = catalogue::store_id(root.disk, root.path) {
        begin_evidence(root.disk, &made, store, &manifest.flight, sha256_hex(&text))?;
    }
    root.disk.replace_file(&path, &text)?;
    root.disk
        .move_durably(&made, &root.flight_folder(&manifest.flight))
}

/// Writes the first line of a flight's chain, and its sums.
fn begin_evidence(
    disk: &dyn Disk,
    made: &Path,
    store: String,
    flight: &str,
    sha256_of_flight: String,
) -> StoreResult<()> {
    let first = ChainEvent::Flight {
        store,
        flight: flight.to_owned(),
        sha256: sha256_of_flight.clone(),
    };
    let path = made.join(layout::CHAIN_FILE);
    let line = chain::encode_chain([first]).map_err(StoreError::io(&path, "write"))?;
    disk.replace_file(&path, &line)?;
    let sums = sums::FileDigests::from([
        (layout::FLIGHT_FILE.to_owned(), sha256_of_flight),
        (layout::CHAIN_FILE.to_owned(), sha256_hex(&line)),
    ]);
    disk.replace_file(
        &made.join(layout::SUMS_FILE),
        sums::format_sums(&sums).as_bytes(),
    )
}
