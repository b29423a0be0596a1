//! Why the store could not do what was asked.

use std::io;
use std::path::{Path, PathBuf};

/// Cut by what the caller does about it.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The file system did not do its part.
    #[error("{}: could not {doing}: {source}; {}", path.display(), mend(source))]
    Io {
        /// What it was about.
        path: PathBuf,
        /// In words.
        doing: &'static str,
        /// The system's answer.
        source: io::Error,
    },
    /// Less free space than the reserve: no new series until a person has made room.
    #[error(
        "{}: {free_mb} MB free, less than the reserve of {reserve_mb} MB; export flights and move them away, or lower [store] reserve_mb",
        path.display()
    )]
    BelowReserve {
        /// The store.
        path: PathBuf,
        /// MB.
        free_mb: u64,
        /// MB.
        reserve_mb: u64,
    },
    /// Written by another program version.
    #[error(
        "{}: store format {found}, this wingd reads and writes format {supported}; use the wingd that wrote it, or choose another directory",
        path.display()
    )]
    Version {
        /// store.toml.
        path: PathBuf,
        /// As the file says.
        found: String,
        /// Ours.
        supported: u32,
    },
    /// The directory holds something else.
    #[error("{}: is not a store ({why}); choose an empty directory or an existing store", path.display())]
    NotAStore {
        /// The directory.
        path: PathBuf,
        /// What was seen.
        why: String,
    },
    /// Another daemon writes to it.
    #[error("{}: another wingd is writing to this store; stop it first (systemctl stop wingd)", path.display())]
    Locked {
        /// The lock file.
        path: PathBuf,
    },
    /// A file is not as this program writes it.
    #[error("{}: {what}; {mend}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
        /// What to do.
        mend: &'static str,
    },
}

impl StoreError {
    /// For `map_err`.
    pub(crate) fn io(path: &Path, doing: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, doing, source }
    }

    /// Whether the disk is full.
    pub fn is_full(&self) -> bool {
        match self {
            Self::Io { source, .. } => source.kind() == io::ErrorKind::StorageFull,
            Self::BelowReserve { .. } => true,
            _ => false,
        }
    }
}

fn mend(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "export flights and move them away to make room"
        }
        io::ErrorKind::PermissionDenied => "give the user that runs wingd write access",
        io::ErrorKind::ReadOnlyFilesystem => "mount the file system writable and check it (fsck)",
        io::ErrorKind::NotFound => "check that the path exists and its disk is mounted",
        _ => "check the disk and its cable (dmesg says more)",
    }
}
