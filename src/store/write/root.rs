//! A store's directory for those who write to it.

use std::path::{Path, PathBuf};

use crate::store::disk::{Disk, StoreError};
use crate::store::format::layout;
use crate::store::read::catalogue;

/// A store's directory, and the disk that it is on.
#[derive(Clone, Copy)]
pub(crate) struct StoreRoot<'a> {
    pub disk: &'a dyn Disk,
    pub path: &'a Path,
}

impl StoreRoot<'_> {
    /// Of a file or folder in it.
    pub fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// `flights/<flight>`.
    pub fn flight_folder(&self, flight: &str) -> PathBuf {
        layout::flight_folder(self.path, flight)
    }

    /// Whether it has chains and sums (format 2).
    pub fn has_evidence(&self) -> bool {
        catalogue::store_id(self.disk, self.path).is_some()
    }

    /// Makes a folder. Synced where it is there already, too: an earlier call may have failed between.
    pub fn ensure_dir(&self, name: &str) -> Result<(), StoreError> {
        let path = self.join(name);
        if !self.disk.exists(&path) {
            self.disk.make_dir(&path)?;
        }
        self.disk.sync_directory(self.path)
    }

    /// Makes the folders that every store has.
    pub fn ensure_folders(&self) -> Result<(), StoreError> {
        [layout::INCOMING, layout::FLIGHTS, layout::PARTIAL].iter().try_for_each(|name| self.ensure_dir(name))
    }

    /// Keeps bytes that are not whole under `partial/`, in place of an older copy of the same name.
    pub fn set_aside(&self, name: &str, bytes: &[u8]) -> Result<(), StoreError> {
        let partial = self.join(layout::PARTIAL);
        self.disk.save_file(&partial.join(name), bytes)?;
        self.disk.sync_directory(&partial)
    }

    /// Keeps what of a file lies after its `good` bytes; says whether there was something.
    pub fn set_tail_aside(&self, name: &str, bytes: &[u8], good: usize) -> Result<bool, StoreError> {
        let tail = bytes.get(good..).unwrap_or_default();
        if !tail.is_empty() {
            self.set_aside(name, tail)?;
        }
        Ok(!tail.is_empty())
    }
}
