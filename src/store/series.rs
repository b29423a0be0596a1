//! A series being taken.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use serde_json::{Map, Value};

use super::disk::{self, Disk};
use super::error::StoreError;
use super::manifest::{FrameEntry, JournalHead, JournalLine, SeriesManifest, Shot, State};
use super::results::sha256;
use super::{catalogue, chain, jsonl, layout};
use crate::clock::Stamp;

/// A frame to be stored.
#[derive(Clone, Debug, PartialEq)]
pub struct NewFrame<'a> {
    /// As the camera delivered it.
    pub bytes: &'a [u8],
    /// Of the file, without the dot.
    pub extension: &'a str,
    /// How to read the bytes, in the camera's words.
    pub format: Value,
    /// What the camera says of the shot.
    pub settings: Map<String, Value>,
}

/// Series of this process in `incoming/`: recovering leaves them alone.
#[derive(Clone, Default)]
pub(crate) struct UnderWay(Arc<Mutex<BTreeSet<String>>>);

/// A series' place among them, until it is dropped.
pub(crate) struct Place {
    id: String,
    all: UnderWay,
}

impl UnderWay {
    pub fn enter(&self, id: String) -> Place {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(id.clone());
        Place { id, all: self.clone() }
    }

    pub fn has(&self, id: &str) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).contains(id)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.all.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.id);
    }
}

/// A series in `incoming/`. Where it is dropped without being closed, or a call fails, it is
/// recovered as an interrupted series before the next one begins.
pub struct OpenSeries {
    disk: Arc<dyn Disk>,
    root: PathBuf,
    folder: PathBuf,
    place: Place,
    head: JournalHead,
    camera: Map<String, Value>,
    shots: Vec<Shot>,
    remarks: Vec<String>,
}

impl OpenSeries {
    /// Makes the folder with the head of its journal, both durable.
    pub(crate) fn begin(
        disk: Arc<dyn Disk>,
        root: &Path,
        place: Place,
        head: JournalHead,
    ) -> Result<Self, StoreError> {
        let folder = layout::incoming(root, &place.id);
        let incoming = root.join(layout::INCOMING);
        disk.create_dir(&folder).map_err(StoreError::io(&folder, "create"))?;
        let (camera, shots, remarks) = (Map::new(), Vec::new(), Vec::new());
        let series = Self { disk, root: root.to_owned(), folder, place, head, camera, shots, remarks };
        series.journal(&JournalLine::Head(series.head.clone()))?;
        series.disk.sync_dir(&series.folder).map_err(StoreError::io(&series.folder, "sync"))?;
        series.disk.sync_dir(&incoming).map_err(StoreError::io(&incoming, "sync"))?;
        Ok(series)
    }

    /// Its name.
    pub fn id(&self) -> &str {
        &self.place.id
    }

    /// Its flight's name.
    pub fn flight(&self) -> &str {
        &self.head.flight
    }

    /// Shots so far.
    pub fn shots(&self) -> &[Shot] {
        &self.shots
    }

    /// Notes the camera as it opened; the first note stays.
    pub fn note_camera(&mut self, camera: Map<String, Value>) -> Result<(), StoreError> {
        if !self.camera.is_empty() || camera.is_empty() {
            return Ok(());
        }
        self.journal(&JournalLine::Camera(camera.clone()))?;
        self.camera = camera;
        Ok(())
    }

    /// Notes durably what a person should read: why the series is taken.
    pub fn remark(&mut self, remark: &str) -> Result<(), StoreError> {
        self.journal(&JournalLine::Remark(remark.to_owned()))?;
        self.remarks.push(remark.to_owned());
        Ok(())
    }

    /// Stores a shot, with its frame where there is one. When this returns the frame is durable:
    /// its line in the journal (with the hash that tells a whole file), its bytes, its name.
    pub fn add_shot(&mut self, mut shot: Shot, frame: Option<NewFrame<'_>>) -> Result<&Shot, StoreError> {
        if let Some(frame) = &frame {
            shot.frame = Some(FrameEntry {
                file: layout::frame_name(shot.shot, frame.extension),
                sha256: sha256(frame.bytes),
                bytes: frame.bytes.len() as u64,
                format: frame.format.clone(),
                settings: frame.settings.clone(),
            });
        }
        self.journal(&JournalLine::Shot(Box::new(shot.clone())))?;
        if let (Some(frame), Some(entry)) = (frame, &shot.frame) {
            self.write_frame(&entry.file, frame.bytes)?;
        }
        let index = self.shots.len();
        self.shots.push(shot);
        Ok(&self.shots[index])
    }

    /// Keeps the bytes of a bad frame under `partial/`; returns the name there.
    pub fn set_aside(&self, shot: u32, attempt: usize, bytes: &[u8]) -> Result<String, StoreError> {
        let name = format!("{}-{shot:04}-{attempt}.bad", self.place.id);
        super::results::set_aside(self.disk.as_ref(), &self.root, &name, bytes)?;
        Ok(name)
    }

    /// Writes the manifest and moves the folder to its flight by one rename.
    pub(crate) fn close(self, state: State, ended: &Stamp, remarks: Vec<String>) -> Result<(), StoreError> {
        let head = self.head;
        let open = head.cause.is_beside() && head.planned_shots == 0 && state == State::Complete;
        let taken = u32::try_from(self.shots.len()).unwrap_or(u32::MAX);
        let manifest = SeriesManifest {
            format: layout::SERIES_FORMAT,
            series: self.place.id.clone(),
            flight: head.flight,
            state,
            cause: head.cause,
            started: Some(head.started),
            ended: Some(ended.clone()),
            planned_shots: if open { taken } else { head.planned_shots },
            camera: self.camera,
            shots: self.shots,
            remarks: self.remarks.into_iter().chain(remarks).collect(),
        };
        write_manifest(self.disk.as_ref(), &self.folder, &manifest)?;
        commit(self.disk.as_ref(), &self.root, &self.folder, &manifest)
    }

    fn journal(&self, line: &JournalLine) -> Result<(), StoreError> {
        let path = self.folder.join(layout::JOURNAL_FILE);
        let bytes = jsonl::line(line).map_err(StoreError::io(&path, "write"))?;
        self.disk.append(&path, &bytes).map_err(StoreError::io(&path, "write"))
    }

    fn write_frame(&self, name: &str, bytes: &[u8]) -> Result<(), StoreError> {
        let path = self.folder.join(name);
        let part = self.folder.join(format!("{name}{}", layout::PART_ENDING));
        self.disk.write(&part, bytes).map_err(StoreError::io(&part, "write"))?;
        self.disk.rename(&part, &path).map_err(StoreError::io(&path, "name"))?;
        self.disk.sync_dir(&self.folder).map_err(StoreError::io(&self.folder, "sync"))
    }
}

/// Writes `series.json` as a whole; from here on it is the truth and the journal is not.
pub(crate) fn write_manifest(
    disk: &dyn Disk,
    folder: &Path,
    manifest: &SeriesManifest,
) -> Result<(), StoreError> {
    let path = folder.join(layout::SERIES_FILE);
    let text = serde_json::to_vec_pretty(manifest).map_err(|e| StoreError::io(&path, "write")(e.into()))?;
    disk::replace(disk, &path, &text).map_err(StoreError::io(&path, "write"))
}

/// Notes the series in its flight's chain, removes the journal and moves the folder to its flight, durably.
pub(crate) fn commit(
    disk: &dyn Disk,
    root: &Path,
    folder: &Path,
    manifest: &SeriesManifest,
) -> Result<(), StoreError> {
    if catalogue::store_id(disk, root).is_some() {
        let path = folder.join(layout::SERIES_FILE);
        let bytes = disk.read(&path).map_err(StoreError::io(&path, "read"))?;
        let flight = root.join(layout::FLIGHTS).join(&manifest.flight);
        chain::note_series(disk, root, &flight, &manifest.series, sha256(&bytes))?;
    }
    let journal = folder.join(layout::JOURNAL_FILE);
    if disk.exists(&journal) {
        disk.remove_file(&journal).map_err(StoreError::io(&journal, "remove"))?;
    }
    // Without a journal too: its removal may not be on the medium yet.
    disk.sync_dir(folder).map_err(StoreError::io(folder, "sync"))?;
    let target = layout::finished(root, &manifest.flight, &manifest.series);
    move_durably(disk, folder, &target)
}

/// Renames and makes both directories durable, the new place first.
pub(crate) fn move_durably(disk: &dyn Disk, from: &Path, to: &Path) -> Result<(), StoreError> {
    disk.rename(from, to).map_err(StoreError::io(to, "move to"))?;
    for directory in [to.parent(), from.parent()].into_iter().flatten() {
        disk.sync_dir(directory).map_err(StoreError::io(directory, "sync"))?;
    }
    Ok(())
}
