//! The file system as the store needs it. Every fsync of the project is in this file.

use std::any::Any;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

/// An entry of a directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Its name; names that are not UTF-8 are shown with replacement characters.
    pub name: String,
    /// A directory.
    pub is_dir: bool,
    /// A symbolic link: never ours.
    pub is_link: bool,
    /// Length, bytes; 0 for a directory.
    pub length: u64,
}

/// Held for as long as the lock is.
pub type Lock = Box<dyn Any + Send + Sync>;

/// What the store asks of a file system. A written *file* is durable when the call returns; a *name*
/// (new, renamed or removed) is durable only after [`Disk::sync_dir`] of its directory.
pub trait Disk: Send + Sync {
    /// The whole file.
    fn read(&self, path: &Path) -> io::Result<Vec<u8>>;
    /// A directory's entries in order of their names.
    fn list(&self, directory: &Path) -> io::Result<Vec<Entry>>;
    /// Whether the path exists.
    fn exists(&self, path: &Path) -> bool;
    /// Makes one directory, whose parent exists.
    fn create_dir(&self, path: &Path) -> io::Result<()>;
    /// Writes a file anew, its bytes durable.
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Appends to a file that may not exist yet, the bytes durable.
    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Cuts a file to `length`, durably.
    fn truncate(&self, path: &Path, length: u64) -> io::Result<()>;
    /// Renames within the store; what was durable under the old name is so under the new one.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Removes a file.
    fn remove_file(&self, path: &Path) -> io::Result<()>;
    /// Removes an empty directory.
    fn remove_dir(&self, path: &Path) -> io::Result<()>;
    /// Makes the names in a directory durable.
    fn sync_dir(&self, directory: &Path) -> io::Result<()>;
    /// Bytes that this user may still write.
    fn free_bytes(&self, path: &Path) -> io::Result<u64>;
    /// Takes the lock file, or `None` where another process holds it.
    fn lock(&self, path: &Path) -> io::Result<Option<Lock>>;
}

/// The machine's file system.
#[derive(Clone, Copy, Debug, Default)]
pub struct RealDisk;

impl Disk for RealDisk {
    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        fs::read(path)
    }

    fn list(&self, directory: &Path) -> io::Result<Vec<Entry>> {
        let mut entries = Vec::new();
        for entry in fs::read_dir(directory)? {
            let entry = entry?;
            let meta = entry.metadata()?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let length = if meta.is_dir() { 0 } else { meta.len() };
            entries.push(Entry { name, is_dir: meta.is_dir(), is_link: meta.is_symlink(), length });
        }
        entries.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(entries)
    }

    fn exists(&self, path: &Path) -> bool {
        path.exists()
    }

    fn create_dir(&self, path: &Path) -> io::Result<()> {
        fs::create_dir(path)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        write_and_sync(File::create(path)?, bytes)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        write_and_sync(OpenOptions::new().create(true).append(true).open(path)?, bytes)
    }

    fn truncate(&self, path: &Path, length: u64) -> io::Result<()> {
        let file = OpenOptions::new().write(true).open(path)?;
        file.set_len(length)?;
        file.sync_all()
    }

    #[allow(clippy::disallowed_methods)] // the one place where files are renamed
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)?;
        // FAT gives the new entry length and place only when the file itself is synced again.
        File::open(to)?.sync_all()
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn remove_dir(&self, path: &Path) -> io::Result<()> {
        fs::remove_dir(path)
    }

    fn sync_dir(&self, directory: &Path) -> io::Result<()> {
        File::open(directory)?.sync_all()
    }

    fn free_bytes(&self, path: &Path) -> io::Result<u64> {
        let stat = rustix::fs::statvfs(path)?;
        Ok(stat.f_bavail.saturating_mul(stat.f_frsize))
    }

    fn lock(&self, path: &Path) -> io::Result<Option<Lock>> {
        let file = OpenOptions::new().create(true).truncate(false).write(true).open(path)?;
        match rustix::fs::flock(&file, rustix::fs::FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => Ok(Some(Box::new(Locked(file)))),
            Err(rustix::io::Errno::WOULDBLOCK) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}

/// A locked file. It is unlocked by name: a process that was just begun has the descriptor too until it runs its own
/// program, and would hold the lock as long.
struct Locked(File);

impl Drop for Locked {
    fn drop(&mut self) {
        let _ = rustix::fs::flock(&self.0, rustix::fs::FlockOperation::Unlock);
    }
}

/// One descriptor for writing and syncing, so that a late write error is not missed.
fn write_and_sync(mut file: File, bytes: &[u8]) -> io::Result<()> {
    file.write_all(bytes)?;
    file.sync_all()
}

/// Fills a buffer with random bytes of the system.
pub(crate) fn random(bytes: &mut [u8]) -> io::Result<()> {
    use std::io::Read;
    File::open("/dev/urandom")?.read_exact(bytes)
}

/// Appends to a file that is `length` long. Where that fails the file is cut to that again, as far as the
/// disk lets us: after a failed fsync a file shows bytes that are not on the medium, and no later fsync
/// brings them there, so nothing may be built on them.
pub(crate) fn append(disk: &dyn Disk, path: &Path, length: usize, bytes: &[u8]) -> io::Result<()> {
    disk.append(path, bytes).inspect_err(|_| drop(disk.truncate(path, length as u64)))
}

/// Replaces a small file as a whole: after a crash it holds the old bytes or the new, never a mix.
pub(crate) fn replace(disk: &dyn Disk, path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".part");
    let part = path.with_file_name(name);
    disk.write(&part, bytes)?;
    disk.rename(&part, path)?;
    disk.sync_dir(path.parent().unwrap_or(Path::new(".")))
}
