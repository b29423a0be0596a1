//! Owner of a store's files. Commands that root runs on a store leave its files to the user that runs the recorder.

use std::fs;
use std::io;
use std::os::unix::fs::{MetadataExt, lchown};
use std::path::Path;

/// User and group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Owner {
    pub user: u32,
    pub group: u32,
}

pub(super) fn parent_folder(path: &Path) -> &Path {
    path.parent()
        .filter(|parent| !parent.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

fn is_root() -> bool {
    rustix::process::geteuid().is_root()
}

/// Gives a file that root has created to the owner of its folder.
pub(crate) fn inherit_owner(path: &Path) -> io::Result<()> {
    if !is_root() {
        return Ok(());
    }
    let (folder, file) = (
        fs::metadata(parent_folder(path))?,
        fs::symlink_metadata(path)?,
    );
    if folder.uid() == file.uid() {
        Ok(())
    } else {
        lchown(path, Some(folder.uid()), Some(folder.gid()))
    }
}

/// Returns the owner of a store, or of the nearest existing folder above it, if root asks and it is another user: that user
/// runs the recorder.
pub fn service_owner(store: &Path) -> Option<Owner> {
    let meta = store
        .ancestors()
        .find_map(|path| fs::metadata(path).ok())
        .filter(|_| is_root())?;
    (meta.uid() != 0).then(|| Owner {
        user: meta.uid(),
        group: meta.gid(),
    })
}

impl Owner {
    /// Returns whether this user has a permission for a file: 4 to read, 2 to write, 1 to enter a folder.
    fn may(self, path: &Path, permission: u32) -> bool {
        let Ok(meta) = fs::metadata(path) else {
            return true;
        };
        let mode = match (meta.uid() == self.user, meta.gid() == self.group) {
            (true, _) => meta.mode() >> 6,
            (false, true) => meta.mode() >> 3,
            (false, false) => meta.mode(),
        };
        mode & permission != 0
    }

    /// Returns whether this user can read a file; a file that does not exist is no obstacle.
    pub fn can_read(self, path: &Path) -> bool {
        self.may(path, 4)
            && path
                .ancestors()
                .skip(1)
                .filter(|p| !p.as_os_str().is_empty())
                .all(|p| self.may(p, 1))
    }

    /// Returns whether this user can write to a file or folder.
    pub fn can_write(self, path: &Path) -> bool {
        self.may(path, 2)
    }
}
