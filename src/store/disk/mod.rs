//! The file system as the store needs it. Every fsync of what is recorded is in this file.

mod error;
pub mod fake;

use std::any::Any;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

use serde::de::DeserializeOwned;

pub use error::StoreError;

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

/// The same calls as the store makes them: an error names what it was about. What changes names is durable.
impl dyn Disk + '_ {
    /// The whole file.
    pub(crate) fn load(&self, path: &Path) -> Result<Vec<u8>, StoreError> {
        self.read(path).map_err(StoreError::io(path, "read"))
    }

    /// The whole file; `None` where there is none.
    pub(crate) fn load_if_there(&self, path: &Path) -> Result<Option<Vec<u8>>, StoreError> {
        match self.read(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            read => read.map(Some).map_err(StoreError::io(path, "read")),
        }
    }

    /// What a file of JSON says; `None` where it cannot be read, or is another thing.
    pub(crate) fn json<T: DeserializeOwned>(&self, path: &Path) -> Option<T> {
        self.read(path).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok())
    }

    /// A directory's entries in order of their names.
    pub(crate) fn entries(&self, directory: &Path) -> Result<Vec<Entry>, StoreError> {
        self.list(directory).map_err(StoreError::io(directory, "list"))
    }

    /// A file's length, bytes; `None` where there is none, or a link or directory instead of it.
    pub(crate) fn length(&self, path: &Path) -> Result<Option<u64>, StoreError> {
        let entries = self.entries(path.parent().unwrap_or(Path::new(".")))?;
        let name = path.file_name().unwrap_or_default();
        let file = |e: &Entry| e.name.as_str() == name && !e.is_dir && !e.is_link;
        Ok(entries.into_iter().find(file).map(|entry| entry.length))
    }

    /// Writes a file anew; its name may not be durable.
    pub(crate) fn save(&self, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        self.write(path, bytes).map_err(StoreError::io(path, "write"))
    }

    /// Replaces a small file as a whole: after a crash it holds the old bytes or the new, never a mix.
    pub(crate) fn replace(&self, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        self.put_in_place(path, bytes).map_err(StoreError::io(path, "write"))
    }

    /// [`Self::replace`] for a caller that says itself what it was doing.
    pub(crate) fn put_in_place(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".part");
        let part = path.with_file_name(name);
        self.write(&part, bytes)?;
        self.rename(&part, path)?;
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        self.sync_dir(parent.unwrap_or(Path::new(".")))
    }

    /// Appends to a file that is `length` long. Where that fails the file is cut to that again, as far as the
    /// disk lets us: after a failed fsync a file shows bytes that are not on the medium, and no later fsync
    /// brings them there, so nothing may be built on them.
    pub(crate) fn extend(&self, path: &Path, length: usize, bytes: &[u8]) -> Result<(), StoreError> {
        let appended = self.append(path, bytes).inspect_err(|_| drop(self.truncate(path, length as u64)));
        appended.map_err(StoreError::io(path, "write"))
    }

    /// Makes one directory, whose parent exists; its name may not be durable.
    pub(crate) fn make_dir(&self, path: &Path) -> Result<(), StoreError> {
        self.create_dir(path).map_err(StoreError::io(path, "create"))
    }

    /// Makes the names in a directory durable.
    pub(crate) fn sync(&self, directory: &Path) -> Result<(), StoreError> {
        self.sync_dir(directory).map_err(StoreError::io(directory, "sync"))
    }

    /// Removes a file; its name may come back after a power cut.
    pub(crate) fn remove(&self, path: &Path) -> Result<(), StoreError> {
        self.remove_file(path).map_err(StoreError::io(path, "remove"))
    }

    /// Removes a folder with all that is in it; a link is removed, never followed.
    pub(crate) fn remove_tree(&self, folder: &Path) -> Result<(), StoreError> {
        for entry in self.entries(folder)? {
            let path = folder.join(&entry.name);
            if entry.is_dir && !entry.is_link { self.remove_tree(&path)? } else { self.remove(&path)? }
        }
        self.sync(folder)?;
        self.remove_dir(folder).map_err(StoreError::io(folder, "remove"))
    }

    /// Renames and makes both directories durable, the new place first.
    pub(crate) fn move_durably(&self, from: &Path, to: &Path) -> Result<(), StoreError> {
        self.rename(from, to).map_err(StoreError::io(to, "move to"))?;
        [to.parent(), from.parent()].into_iter().flatten().try_for_each(|directory| self.sync(directory))
    }
}
