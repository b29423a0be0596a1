//! Root directory of a store, for writing.

use std::path::{Path, PathBuf};

use crate::disk::{Disk, StoreResult};
use crate::format::layout;
use crate::read::catalogue;

/// Root directory of a store, with its disk.
#[derive(Clone, Copy)]
pub(crate) struct StoreRoot<'a> {
    pub disk: &'a dyn Disk,
    pub path: &'a Path,
}

impl StoreRoot<'_> {
    /// Returns the path of a file or folder in the root.
    pub fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Returns the path `flights/<flight>`.
    pub fn flight_folder(&self, flight: &str) -> PathBuf {
        layout::flight_folder(self.path, flight)
    }

    /// Returns whether the store has chains and sums (format 2).
    pub fn has_evidence(&self) -> bool {
        catalogue::store_id(self.disk, self.path).is_some()
    }

    /// Creates a folder if it does not exist. The root is synced in any case: an earlier call may have failed before that.
    pub fn ensure_dir(&self, name: &str) -> StoreResult<()> {
        let path = self.join(name);
        if !self.disk.exists(&path) {
            self.disk.make_dir(&path)?;
        }
        self.disk.sync_directory(self.path)
    }

    /// Creates the folders that every store has.
    pub fn ensure_folders(&self) -> StoreResult<()> {
        [layout::INCOMING, layout::FLIGHTS, layout::PARTIAL]
            .iter()
            .try_for_each(|name| self.ensure_dir(name))
    }

    /// Stores incomplete bytes under `partial/`, replacing an older copy of the same name.
    pub fn set_aside(&self, name: &str, bytes: &[u8]) -> StoreResult<()> {
        let partial = self.join(layout::PARTIAL);
        self.disk.save_file(&partial.join(name), bytes)?;
        self.disk.sync_directory(&partial)
    }

    /// Stores the bytes after the `good` ones under `partial/`; returns whether there were any.
    pub fn set_tail_aside(&self, name: &str, bytes: &[u8], good: usize) -> StoreResult<bool> {
        let tail = bytes.get(good..).unwrap_or_default();
        if !tail.is_empty() {
            self.set_aside(name, tail)?;
        }
        Ok(!tail.is_empty())
    }
}
