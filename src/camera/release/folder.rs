//! Frames that arrive as files: the folder of a Wi-Fi card or a camera, mounted or synchronised here. The folder is polled,
//! as a network mount reports no changes.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{fs, io};

use serde::{Deserialize, Serialize};
use serde_json::Map;

use crate::camera::deadline::Deadline;
use crate::camera::freshness::LastName;
use crate::camera::{Camera, CameraError, CameraFrame, CameraInfo, jpeg};
use wingd_base::regular_file::{MAX_DATA_BYTES, read_regular_file};
use wingd_evaluation::frame_format::Format;

/// Polling interval. A file is accepted when two polls agree on its size and it is complete.
const POLL_INTERVAL: Duration = Duration::from_millis(200);
/// Maximum depth of subfolders, as on a camera's card.
const MAX_DEPTH: usize = 4;

/// Section `[camera.frames]` with `kind = "folder"`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FolderSection {
    /// Folder of the files; subfolders are searched too.
    pub path: PathBuf,
    /// Delete a file there once our copy is durable.
    #[serde(default)]
    pub delete: bool,
}

/// Watched folder; see [`Camera`].
pub struct WatchedFolder {
    section: FolderSection,
    last_name: LastName,
    /// Files that are not new; `None` while it is closed.
    known: Option<BTreeSet<PathBuf>>,
    last: Option<PathBuf>,
}

impl WatchedFolder {
    /// Creates a closed folder; it is not accessed before `open`.
    pub fn new(section: FolderSection, last_name: LastName) -> Self {
        Self {
            section,
            last_name,
            known: None,
            last: None,
        }
    }

    /// Returns files that appeared without a request; they are no longer new.
    pub fn unexpected_files(&mut self) -> Result<Vec<String>, CameraError> {
        let known = self.known.as_mut().ok_or_else(CameraError::closed)?;
        let mut files: Vec<_> = list_files(&self.section.path)?.into_keys().collect();
        files.retain(|file| known.insert(file.clone()));
        Ok(files
            .iter()
            .map(|file| file.display().to_string())
            .collect())
    }
}

impl Camera for WatchedFolder {
    /// Records the present files as not new.
    fn open(&mut self) -> Result<CameraInfo, CameraError> {
        self.known = Some(list_files(&self.section.path)?.into_keys().collect());
        let name = format!("remote release, files in {}", self.section.path.display());
        Ok(CameraInfo {
            name,
            ..CameraInfo::default()
        })
    }

    /// Waits for the next new file.
    fn shoot(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError> {
        let deadline = Deadline::new(deadline);
        let known = self.known.as_mut().ok_or_else(CameraError::closed)?;
        let mut before = BTreeMap::new();
        loop {
            let left = deadline.remaining(&format!(
                "a new JPEG file in {}",
                self.section.path.display()
            ))?;
            let now = list_files(&self.section.path)?;
            for (file, size) in now.iter().filter(|(file, _)| !known.contains(*file)) {
                if before.get(file) == Some(size) {
                    let bytes = read_regular_file(file, MAX_DATA_BYTES)
                        .map_err(|error| folder_gone_error(file, &error))?;
                    if jpeg::check_complete(&bytes).is_ok() {
                        known.insert(file.clone());
                        self.last = Some(file.clone());
                        let path = file.display().to_string();
                        self.last_name.check(&path)?;
                        let settings = Map::from_iter([("camera_path".to_owned(), path.into())]);
                        return Ok(CameraFrame {
                            bytes,
                            format: Format::Jpeg,
                            settings,
                            exposed: None,
                        });
                    }
                }
            }
            before = now;
            std::thread::sleep(POLL_INTERVAL.min(left));
        }
    }

    fn release_last(&mut self) -> Result<(), CameraError> {
        match self.last.take().filter(|_| self.section.delete) {
            Some(file) => fs::remove_file(&file).map_err(|error| folder_gone_error(&file, &error)),
            None => Ok(()),
        }
    }

    fn close(&mut self) {
        (self.known, self.last) = (None, None);
    }
}

fn folder_gone_error(path: &Path, error: &io::Error) -> CameraError {
    CameraError::Gone(format!(
        "{}: {error}; is the card's folder mounted?",
        path.display()
    ))
}

/// Lists JPEG files and their sizes.
fn list_files(path: &Path) -> Result<BTreeMap<PathBuf, u64>, CameraError> {
    let mut files = BTreeMap::new();
    collect_jpeg_files(path, MAX_DEPTH, &mut files)
        .map_err(|error| folder_gone_error(path, &error))?;
    Ok(files)
}

fn collect_jpeg_files(
    path: &Path,
    depth: usize,
    into: &mut BTreeMap<PathBuf, u64>,
) -> io::Result<()> {
    for entry in fs::read_dir(path)? {
        let entry = entry?;
        let kind = entry.file_type()?;
        if kind.is_dir() && depth > 0 {
            collect_jpeg_files(&entry.path(), depth - 1, into)?;
        } else if kind.is_file() && is_jpeg(&entry.path()) {
            // A file that was deleted in the meantime is skipped.
            if let Ok(data) = entry.metadata() {
                into.insert(entry.path(), data.len());
            }
        }
    }
    Ok(())
}

fn is_jpeg(path: &Path) -> bool {
    let ending = path.extension().map(|ending| ending.to_ascii_lowercase());
    ending.is_some_and(|ending| ending == "jpg" || ending == "jpeg")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::jpeg::tests::picture;

    #[test]
    fn only_complete_new_files_are_delivered() {
        let dir = tempfile::tempdir().unwrap();
        let card = dir.path().join("DCIM/100");
        fs::create_dir_all(&card).unwrap();
        fs::write(card.join("old.jpg"), picture(3)).unwrap();
        let section = FolderSection {
            path: dir.path().to_owned(),
            delete: true,
        };
        let mut folder = WatchedFolder::new(section, LastName::default());
        folder.open().unwrap();

        let late = picture(7);
        let (whole, half) = (late.clone(), late[..late.len() / 2].to_vec());
        let target = card.join("new.JPG");
        let writer = std::thread::spawn(move || {
            fs::write(&target, half).unwrap();
            std::thread::sleep(POLL_INTERVAL * 4);
            fs::write(&target, whole).unwrap();
        });
        let frame = folder.shoot(Duration::from_secs(20)).unwrap();
        writer.join().unwrap();
        assert_eq!(frame.bytes, late);
        folder.release_last().unwrap();
        assert!(!card.join("new.JPG").exists() && card.join("old.jpg").exists());

        let none = folder.shoot(POLL_INTERVAL * 3);
        assert!(matches!(none, Err(CameraError::Timeout { .. })), "{none:?}");
        fs::write(card.join("stray.jpg"), picture(5)).unwrap();
        assert_eq!(folder.unexpected_files().unwrap().len(), 1);
        assert!(folder.unexpected_files().unwrap().is_empty());
    }
}
