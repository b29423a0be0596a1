//! Errors of the store, with a remedy each.

use std::io;
use std::path::{Path, PathBuf};
use wingd_base::failure::Failure;

use wingd_base::text::printable_path;

/// Result of an operation on a store.
pub type StoreResult<T> = Result<T, StoreError>;

/// Error of a store operation; variants differ in the caller's reaction.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// A file system call failed.
    #[error(
        "{}: could not {doing}: {source}; {}",
        printable_path(path),
        io_remedy(source)
    )]
    Io {
        path: PathBuf,
        /// Operation that failed: a verb that completes "could not …".
        doing: &'static str,
        source: io::Error,
    },
    /// The free space is below the reserve; no new series begins until a person has made room.
    #[error(
        "{}: {free_mb} MB free, less than the reserve of {reserve_mb} MB; export flights and move them away, or lower [store] reserve_mb",
        printable_path(path)
    )]
    BelowReserve {
        /// Root of the store.
        path: PathBuf,
        free_mb: u64,
        reserve_mb: u64,
    },
    /// The store was written by another program version.
    #[error(
        "{}: store format {found}, this wingd reads and writes format {supported}; use the wingd that wrote it, or choose another directory",
        printable_path(path)
    )]
    Version {
        /// Path of store.toml.
        path: PathBuf,
        /// Format number in the file.
        found: String,
        /// Newest format that this program supports.
        supported: u32,
    },
    /// The directory contains something else.
    #[error(
        "{}: is not a store ({why}); choose an empty directory or an existing store",
        printable_path(path)
    )]
    NotAStore {
        path: PathBuf,
        /// Evidence that it is not a store.
        why: String,
    },
    /// Another process writes to the store.
    #[error(
        "{}: {} is writing to this store; {}",
        printable_path(path),
        printable_path(holder),
        lock_remedy(holder)
    )]
    Locked {
        /// The lock file.
        path: PathBuf,
        /// Command and process that hold the lock, as they have named themselves.
        holder: String,
    },
    /// A file is damaged or not in the format of this program.
    #[error("{}: {problem}; {remedy}", printable_path(path))]
    Damaged {
        path: PathBuf,
        problem: String,
        remedy: &'static str,
    },
}

impl StoreError {
    /// Returns a function for `map_err` that adds path and operation to an I/O error.
    pub fn io(path: &Path, doing: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io {
            path,
            doing,
            source,
        }
    }

    /// Returns whether the disk is full or the free space is below the reserve.
    pub fn is_full(&self) -> bool {
        match self {
            Self::Io { source, .. } => source.kind() == io::ErrorKind::StorageFull,
            Self::BelowReserve { .. } => true,
            _ => false,
        }
    }
}

fn lock_remedy(holder: &str) -> &'static str {
    if holder.starts_with("`wingd run`") {
        "stop the recorder first (systemctl stop wingd, if it is the service)"
    } else {
        "wait until it ends, or stop that process"
    }
}

fn io_remedy(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "export flights and move them away to make room"
        }
        io::ErrorKind::PermissionDenied => "give the user that runs wingd write access",
        io::ErrorKind::ReadOnlyFilesystem => "mount the file system writable and check it (fsck)",
        io::ErrorKind::InvalidInput => "move it out of the store",
        io::ErrorKind::NotFound => "check that the path exists and its disk is mounted",
        _ => "check the disk and its cable (see dmesg)",
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::from_error(error)
    }
}
