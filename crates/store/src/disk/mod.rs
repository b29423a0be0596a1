//! File system interface of the store. Every fsync of recorded data is in this module.

mod error;
pub(crate) mod owner;

use std::any::Any;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;
use serde::de::DeserializeOwned;

pub use error::{StoreError, StoreResult};

/// Entry of a directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DirectoryEntry {
    /// Name of the entry; bytes that are not UTF-8 become replacement characters.
    pub name: String,
    /// Folder, not a link to one.
    pub is_dir: bool,
    /// Symbolic link; the store never creates one.
    pub is_link: bool,
    /// Length, bytes; 0 for a directory.
    pub length: u64,
}

/// Guard of the lock file; dropping it releases the lock.
pub type Lock = Box<dyn Any + Send + Sync>;

/// File system operations that the store needs. The *content* of a written file is durable when the call returns; a *name*
/// (new, renamed or removed) is durable only after [`Disk::sync_dir`] of its directory.
pub trait Disk: Send + Sync {
    /// Reads a complete file.
    fn read(&self, path: &Path) -> io::Result<Vec<u8>>;
    /// Reads up to `length` bytes from `offset`; fewer at the end of the file.
    fn read_range(&self, path: &Path, offset: u64, length: usize) -> io::Result<Vec<u8>> {
        let bytes = self.read(path)?;
        let begin = usize::try_from(offset)
            .unwrap_or(usize::MAX)
            .min(bytes.len());
        let end = begin.saturating_add(length).min(bytes.len());
        Ok(bytes.get(begin..end).unwrap_or_default().to_vec())
    }
    /// Returns the length of a file, bytes.
    fn length(&self, path: &Path) -> io::Result<u64> {
        self.read(path).map(|bytes| bytes.len() as u64)
    }
    /// Lists a directory, sorted by name.
    fn list(&self, directory: &Path) -> io::Result<Vec<DirectoryEntry>>;
    /// Returns whether the path exists.
    fn exists(&self, path: &Path) -> bool;
    /// Returns whether this user's permissions allow writing to an existing path.
    fn is_permitted(&self, _path: &Path) -> bool {
        true
    }
    /// Returns whether a path is a directory, not a link to one.
    fn is_directory(&self, path: &Path) -> bool {
        self.list(path).is_ok()
    }
    /// Creates one directory, whose parent exists.
    fn create_dir(&self, path: &Path) -> io::Result<()>;
    /// Writes a file from its beginning; the content is durable.
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Appends to a file, creating it if it does not exist; the content is durable.
    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Truncates a file to `length` bytes, durably.
    fn truncate(&self, path: &Path, length: u64) -> io::Result<()>;
    /// Renames within the store; content that was durable under the old name is durable under the new one.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Removes a file.
    fn remove_file(&self, path: &Path) -> io::Result<()>;
    /// Removes an empty directory.
    fn remove_dir(&self, path: &Path) -> io::Result<()>;
    /// Makes the names in a directory durable.
    fn sync_dir(&self, directory: &Path) -> io::Result<()>;
    /// Returns the bytes that this user may still write.
    fn free_bytes(&self, path: &Path) -> io::Result<u64>;
    /// Takes the lock file; `None` if another process holds it.
    fn lock(&self, path: &Path) -> io::Result<Option<Lock>>;
}

/// File system of the machine. No file is opened through a link: a store may come from elsewhere, and a link leads out of it.
#[derive(Clone, Copy, Debug, Default)]
pub struct RealDisk;

impl Disk for RealDisk {
    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        read_whole(open_regular_file(path)?)
    }

    fn read_range(&self, path: &Path, offset: u64, length: usize) -> io::Result<Vec<u8>> {
        let (file, total) = open_regular_file(path)?;
        let left = total.saturating_sub(offset);
        let mut bytes = vec![0; length.min(usize::try_from(left).unwrap_or(length))];
        let mut read = 0;
        while let Some(rest) = bytes.get_mut(read..).filter(|rest| !rest.is_empty()) {
            match file.read_at(rest, offset + read as u64)? {
                0 => break,
                count => read += count,
            }
        }
        bytes.truncate(read);
        Ok(bytes)
    }

    fn length(&self, path: &Path) -> io::Result<u64> {
        let meta = fs::symlink_metadata(path)?;
        meta.is_file().then_some(meta.len()).ok_or_else(not_regular)
    }

    fn list(&self, directory: &Path) -> io::Result<Vec<DirectoryEntry>> {
        let mut entries = Vec::new();
        for entry in fs::read_dir(directory)? {
            let entry = entry?;
            let meta = entry.metadata()?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let length = if meta.is_dir() { 0 } else { meta.len() };
            entries.push(DirectoryEntry {
                name,
                is_dir: meta.is_dir(),
                is_link: meta.is_symlink(),
                length,
            });
        }
        entries.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(entries)
    }

    fn exists(&self, path: &Path) -> bool {
        path.exists()
    }

    fn is_directory(&self, path: &Path) -> bool {
        fs::symlink_metadata(path).is_ok_and(|meta| meta.is_dir())
    }

    fn is_permitted(&self, path: &Path) -> bool {
        rustix::fs::access(path, rustix::fs::Access::WRITE_OK) != Err(rustix::io::Errno::ACCESS)
    }

    fn create_dir(&self, path: &Path) -> io::Result<()> {
        // Below a folder that is closed to other users, no other needs to be.
        let above = fs::metadata(owner::parent_folder(path))?.mode();
        let mode = if above & 0o007 == 0 { 0o777 } else { 0o750 };
        fs::DirBuilder::new().mode(mode).create(path)?;
        owner::inherit_owner(path)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        // A part is always a new file: one that is already there may be another name of a file elsewhere.
        let is_part = path.extension().is_some_and(|ending| ending == "part");
        if is_part
            && let Err(error) = fs::remove_file(path)
            && error.kind() != io::ErrorKind::NotFound
        {
            return Err(error);
        }
        let mut options = OpenOptions::new();
        options.write(true).truncate(true).create(true);
        let file = open_file(options.create_new(is_part), path)?;
        owner::inherit_owner(path)?;
        write_and_sync(file, bytes)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let mut options = OpenOptions::new();
        let file = open_file(options.create(true).append(true), path)?;
        owner::inherit_owner(path)?;
        write_and_sync(file, bytes)
    }

    fn truncate(&self, path: &Path, length: u64) -> io::Result<()> {
        let file = open_file(OpenOptions::new().write(true), path)?;
        file.set_len(length)?;
        file.sync_all()
    }

    #[allow(clippy::disallowed_methods)] // the only place that renames files
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)?;
        // FAT records length and location in the new entry only when the file itself is synced again.
        open_file(OpenOptions::new().read(true), to)?.sync_all()
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
        let mut options = OpenOptions::new();
        options.create(true).truncate(false).write(true);
        let mut file = open_file(&mut options, path)?;
        owner::inherit_owner(path)?;
        match rustix::fs::flock(&file, rustix::fs::FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => {
                file.set_len(0)?;
                let command = std::env::args().nth(1).unwrap_or_default();
                let named = format!("`wingd {command}` (process {})", std::process::id());
                // On a full disk the lock has no name.
                let _ = file.write_all(named.as_bytes());
                Ok(Some(Box::new(LockedFile(file))))
            }
            Err(rustix::io::Errno::WOULDBLOCK) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}

/// Locked file. It is unlocked explicitly: a process that was just forked shares the descriptor until its exec and would
/// keep the lock until then.
struct LockedFile(File);

impl Drop for LockedFile {
    fn drop(&mut self) {
        let _ = rustix::fs::flock(&self.0, rustix::fs::FlockOperation::Unlock);
    }
}

/// Writes and syncs through one descriptor, so that a late write error is not missed.
fn write_and_sync(mut file: File, bytes: &[u8]) -> io::Result<()> {
    file.write_all(bytes)?;
    file.sync_all()
}

/// Opens a file, never through a link, and without waiting for the other end of a pipe.
fn open_file(options: &mut OpenOptions, path: &Path) -> io::Result<File> {
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32;
    let opened = options.custom_flags(flags).open(path);
    opened.map_err(|error| match error.raw_os_error() {
        Some(code) if code == rustix::io::Errno::LOOP.raw_os_error() => not_regular(),
        _ => error,
    })
}

fn not_regular() -> io::Error {
    io::Error::new(
        io::ErrorKind::InvalidInput,
        "is a link, or not a regular file",
    )
}

/// Opens a regular file for reading and returns its length.
fn open_regular_file(path: &Path) -> io::Result<(File, u64)> {
    let file = open_file(OpenOptions::new().read(true), path)?;
    let metadata = file.metadata()?;
    let is_file = metadata.is_file().then_some((file, metadata.len()));
    is_file.ok_or_else(not_regular)
}

fn read_whole((file, length): (File, u64)) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0));
    // Without a limit the library would ask for length and position again.
    file.take(u64::MAX).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Fills a buffer with random bytes from the operating system.
pub(crate) fn fill_random(bytes: &mut [u8]) -> io::Result<()> {
    File::open("/dev/urandom")?.read_exact(bytes)
}

/// Operations of [`Disk`] whose errors name the path. Operations that change names make them durable unless noted.
impl dyn Disk + '_ {
    /// Reads a complete file.
    pub(crate) fn load_file(&self, path: &Path) -> StoreResult<Vec<u8>> {
        self.read(path).map_err(StoreError::io(path, "read"))
    }

    /// Reads a complete file; `None` if it does not exist.
    pub(crate) fn load_if_exists(&self, path: &Path) -> StoreResult<Option<Vec<u8>>> {
        match self.read(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            read => read.map(Some).map_err(StoreError::io(path, "read")),
        }
    }

    /// Parses a JSON file; `None` if it cannot be read or parsed.
    pub(crate) fn load_json<T: DeserializeOwned>(&self, path: &Path) -> Option<T> {
        self.read(path)
            .ok()
            .and_then(|bytes| serde_json::from_slice(&bytes).ok())
    }

    /// Lists a directory, sorted by name.
    pub fn list_entries(&self, directory: &Path) -> StoreResult<Vec<DirectoryEntry>> {
        self.list(directory)
            .map_err(StoreError::io(directory, "list"))
    }

    /// Lists the entries of a folder and, down to `depth` levels of names, below it, each before those in it. Folders that this
    /// user cannot list (lost+found), or that are moved meanwhile, are not entered.
    pub(crate) fn walk(&self, folder: &Path, depth: usize) -> Vec<(PathBuf, DirectoryEntry)> {
        let mut all = Vec::new();
        for entry in self.list(folder).unwrap_or_default() {
            let path = folder.join(&entry.name);
            let is_entered = entry.is_dir && depth > 1;
            all.push((path.clone(), entry));
            if is_entered {
                all.extend(self.walk(&path, depth - 1));
            }
        }
        all
    }

    /// Returns the length of a file, bytes; `None` if it does not exist, or is a link or directory.
    pub(crate) fn file_length(&self, path: &Path) -> StoreResult<Option<u64>> {
        use io::ErrorKind::{InvalidInput, NotFound};
        match self.length(path) {
            Err(error) if matches!(error.kind(), NotFound | InvalidInput) => Ok(None),
            length => length.map(Some).map_err(StoreError::io(path, "read")),
        }
    }

    /// Writes a file from its beginning; its name may not be durable.
    pub(crate) fn save_file(&self, path: &Path, bytes: &[u8]) -> StoreResult<()> {
        self.write(path, bytes)
            .map_err(StoreError::io(path, "write"))
    }

    /// Replaces a small file atomically: after a crash it has either the old or the new content.
    pub fn replace_file(&self, path: &Path, bytes: &[u8]) -> StoreResult<()> {
        self.replace_file_io(path, bytes)
            .map_err(StoreError::io(path, "write"))
    }

    /// Replaces a file as [`Self::replace_file`] does, for callers that describe the operation themselves.
    pub fn replace_file_io(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".part");
        let part = path.with_file_name(name);
        self.write(&part, bytes)?;
        self.rename(&part, path)?;
        let parent = path
            .parent()
            .filter(|parent| !parent.as_os_str().is_empty());
        self.sync_dir(parent.unwrap_or(Path::new(".")))
    }

    /// Appends to a file of `length` bytes. If that fails, the file is truncated to `length`, as far as the disk permits:
    /// after a failed fsync the file shows bytes that are not on the medium and that no later fsync writes, so nothing may
    /// depend on them.
    pub(crate) fn extend_file(&self, path: &Path, length: u64, bytes: &[u8]) -> StoreResult<()> {
        let appended = self
            .append(path, bytes)
            .inspect_err(|_| drop(self.truncate(path, length)));
        appended.map_err(StoreError::io(path, "write"))
    }

    /// Creates one directory, whose parent exists; its name may not be durable.
    pub(crate) fn make_dir(&self, path: &Path) -> StoreResult<()> {
        self.create_dir(path)
            .map_err(StoreError::io(path, "create"))
    }

    /// Makes the names in a directory durable.
    pub(crate) fn sync_directory(&self, directory: &Path) -> StoreResult<()> {
        self.sync_dir(directory)
            .map_err(StoreError::io(directory, "sync"))
    }

    /// Removes a file; its name may reappear after a power cut.
    pub(crate) fn remove(&self, path: &Path) -> StoreResult<()> {
        self.remove_file(path)
            .map_err(StoreError::io(path, "remove"))
    }

    /// Removes a file, or a directory with its content; a link is removed, never followed.
    pub(crate) fn remove_tree(&self, folder: &Path) -> StoreResult<()> {
        if !self.is_directory(folder) {
            return self.remove(folder);
        }
        for entry in self.list_entries(folder)? {
            self.remove_tree(&folder.join(&entry.name))?;
        }
        self.sync_directory(folder)?;
        self.remove_dir(folder)
            .map_err(StoreError::io(folder, "remove"))
    }

    /// Renames and makes both directories durable, the target first.
    pub(crate) fn move_durably(&self, from: &Path, to: &Path) -> StoreResult<()> {
        self.rename(from, to)
            .map_err(StoreError::io(to, "move to"))?;
        [to.parent(), from.parent()]
            .into_iter()
            .flatten()
            .try_for_each(|directory| self.sync_directory(directory))
    }
}
