//! Series being recorded.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use serde_json::{Map, Value};

use super::chain;
use super::root::StoreRoot;
use crate::disk::{Disk, StoreError, StoreResult};
use crate::format::chain::ChainEvent;
use crate::format::manifest::{
    FrameEntry, JournalHead, JournalLine, SeriesManifest, SeriesState, Shot,
};
use crate::format::{jsonl, layout, sha256_hex};
use wingd_base::clock::Stamp;

/// Frame to be stored.
#[derive(Clone, Debug, PartialEq)]
pub struct NewFrame<'a> {
    /// Bytes as delivered by the camera.
    pub bytes: &'a [u8],
    /// Extension of the file name, without the dot.
    pub extension: &'a str,
    /// Pixel or file format, as reported by the camera.
    pub format: Value,
    /// Camera settings of the shot.
    pub settings: Map<String, Value>,
}

/// Series of this process in `incoming/`, which recovery does not touch, each as long as its name is in use.
#[derive(Default)]
pub(super) struct ActiveSeries(Mutex<Vec<Weak<str>>>);

impl ActiveSeries {
    /// Registers an open series until the returned name is dropped.
    pub fn register(&self, id: &str) -> Arc<str> {
        let name: Arc<str> = id.into();
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|held| held.strong_count() > 0);
        all.push(Arc::downgrade(&name));
        name
    }

    /// Returns whether a series is open.
    pub fn contains(&self, id: &str) -> bool {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.iter()
            .filter_map(Weak::upgrade)
            .any(|name| *name == *id)
    }
}

/// Series in `incoming/`. If it is dropped without being closed, or a call fails, it is recovered as an interrupted series
/// before the next one begins.
pub struct OpenSeries {
    disk: Arc<dyn Disk>,
    root: PathBuf,
    folder: PathBuf,
    /// Name, in use until the series is closed or dropped.
    id: Arc<str>,
    manifest: SeriesManifest,
}

impl OpenSeries {
    /// Creates the folder and the head of the journal, both durable.
    pub(crate) fn begin(
        disk: Arc<dyn Disk>,
        root: &Path,
        id: Arc<str>,
        head: JournalHead,
    ) -> StoreResult<Self> {
        let folder = layout::incoming_folder(root, &id);
        let incoming = root.join(layout::INCOMING);
        disk.make_dir(&folder)?;
        let manifest = SeriesManifest::from_journal_head(&id, head.clone());
        let series = Self {
            disk,
            root: root.to_owned(),
            folder,
            id,
            manifest,
        };
        series.append_journal(&JournalLine::Head(head))?;
        series.disk.sync_directory(&series.folder)?;
        series.disk.sync_directory(&incoming)?;
        Ok(series)
    }

    /// Returns the name of the series.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Returns the name of the flight.
    pub fn flight(&self) -> &str {
        &self.manifest.flight
    }

    /// Returns the shots so far.
    pub fn shots(&self) -> &[Shot] {
        &self.manifest.shots
    }

    /// Returns whether the series has a frame with these bytes.
    pub fn contains_frame(&self, bytes: &[u8]) -> bool {
        let hash = sha256_hex(bytes);
        self.manifest.frames().any(|frame| frame.sha256 == hash)
    }

    /// Records the camera's description durably; only the first one is kept.
    pub fn note_camera(&mut self, camera: Map<String, Value>) -> StoreResult<()> {
        if !self.manifest.camera.is_empty() || camera.is_empty() {
            return Ok(());
        }
        self.append_journal(&JournalLine::Camera(camera.clone()))?;
        self.manifest.camera = camera;
        Ok(())
    }

    /// Records a note for a person durably, such as the reason for the series.
    pub fn add_remark(&mut self, remark: &str) -> StoreResult<()> {
        self.append_journal(&JournalLine::Remark(remark.to_owned()))?;
        self.manifest.remarks.push(remark.to_owned());
        Ok(())
    }

    /// Stores a shot, with its frame if there is one. When this returns, the frame is durable: its line in the journal
    /// (with the digest that identifies a complete file), its bytes, its name.
    pub fn add_shot(&mut self, mut shot: Shot, frame: Option<NewFrame<'_>>) -> StoreResult<&Shot> {
        if let Some(frame) = &frame {
            shot.frame = Some(FrameEntry {
                file: layout::frame_name(shot.shot, frame.extension),
                sha256: sha256_hex(frame.bytes),
                bytes: frame.bytes.len() as u64,
                format: frame.format.clone(),
                settings: frame.settings.clone(),
            });
        }
        self.append_journal(&JournalLine::Shot(Box::new(shot.clone())))?;
        if let (Some(frame), Some(entry)) = (frame, &shot.frame) {
            self.write_frame(&entry.file, frame.bytes)?;
        }
        let index = self.manifest.shots.len();
        self.manifest.shots.push(shot);
        Ok(&self.manifest.shots[index])
    }

    /// Stores the bytes of a bad frame under `partial/`; returns the name there.
    pub fn set_aside(&self, shot: u32, attempt: usize, bytes: &[u8]) -> StoreResult<String> {
        let name = format!("{}-{shot:04}-{attempt}.bad", self.id);
        self.store_root().set_aside(&name, bytes)?;
        Ok(name)
    }

    /// Writes the manifest and moves the folder to its flight by one rename.
    pub(crate) fn close(
        self,
        state: SeriesState,
        ended: &Stamp,
        remarks: Vec<String>,
    ) -> StoreResult<()> {
        let root = StoreRoot {
            disk: self.disk.as_ref(),
            path: &self.root,
        };
        let mut manifest = self.manifest;
        if manifest.cause.is_concurrent()
            && manifest.planned_shots == 0
            && state == SeriesState::Complete
        {
            manifest.planned_shots = u32::try_from(manifest.shots.len()).unwrap_or(u32::MAX);
        }
        (manifest.state, manifest.ended) = (state, Some(ended.clone()));
        manifest.remarks.extend(remarks);
        write_manifest(root.disk, &self.folder, &manifest)?;
        commit_series(root, &self.folder, &manifest)
    }

    fn store_root(&self) -> StoreRoot<'_> {
        StoreRoot {
            disk: self.disk.as_ref(),
            path: &self.root,
        }
    }

    fn append_journal(&self, line: &JournalLine) -> StoreResult<()> {
        let path = self.folder.join(layout::JOURNAL_FILE);
        let bytes = jsonl::encode_line(line).map_err(StoreError::io(&path, "write"))?;
        self.disk
            .append(&path, &bytes)
            .map_err(StoreError::io(&path, "write"))
    }

    fn write_frame(&self, name: &str, bytes: &[u8]) -> StoreResult<()> {
        let path = self.folder.join(name);
        let part = self.folder.join(format!("{name}{}", layout::PART_ENDING));
        self.disk.save_file(&part, bytes)?;
        self.disk
            .rename(&part, &path)
            .map_err(StoreError::io(&path, "name"))?;
        self.disk.sync_directory(&self.folder)
    }
}

/// Writes `series.json` atomically; from then on it is authoritative, and no longer the journal.
pub(super) fn write_manifest(
    disk: &dyn Disk,
    folder: &Path,
    manifest: &SeriesManifest,
) -> StoreResult<()> {
    let path = folder.join(layout::SERIES_FILE);
    let text = serde_json::to_vec_pretty(manifest)
        .map_err(|e| StoreError::io(&path, "write")(e.into()))?;
    disk.replace_file(&path, &text)
}

/// Adds the series to its flight's chain, removes the journal and moves the folder to its flight, durably.
pub(super) fn commit_series(
    root: StoreRoot<'_>,
    folder: &Path,
    manifest: &SeriesManifest,
) -> StoreResult<()> {
    let series = manifest.series.clone();
    if root.has_evidence() {
        let sha256 = sha256_hex(&root.disk.load_file(&folder.join(layout::SERIES_FILE))?);
        chain::ensure_event(
            root,
            &root.flight_folder(&manifest.flight),
            ChainEvent::Series { series, sha256 },
        )?;
    }
    let journal = folder.join(layout::JOURNAL_FILE);
    if root.disk.exists(&journal) {
        root.disk.remove(&journal)?;
    }
    // Even without a journal: its removal may not be on the medium yet.
    root.disk.sync_directory(folder)?;
    root.disk.move_durably(
        folder,
        &layout::series_folder(root.path, &manifest.flight, &manifest.series),
    )
}
