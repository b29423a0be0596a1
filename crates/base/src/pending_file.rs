//! Files that get their name when they are complete and on the disk.

use std::fs::{File, Permissions};
use std::io::{self, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, CWD, Mode, OFlags};
use tempfile::NamedTempFile;

/// File that is written beside its name; a reader sees the old content or the new, never a part. Without [`commit`], the
/// old one stays.
///
/// [`commit`]: PendingFile::commit
#[derive(Debug)]
pub enum PendingFile {
    /// Device or link, which is written in place.
    InPlace(File),
    /// File without a name, of which nothing is left if the program is killed.
    Unnamed(File, PathBuf),
    /// Temporary file in the folder of the name, on disks that know no others.
    Beside(NamedTempFile, PathBuf),
}

impl PendingFile {
    /// Creates the file; a link at the name is replaced.
    ///
    /// # Errors
    /// Returns an error of the file system.
    pub fn create(file: &Path) -> io::Result<Self> {
        // The error of the file beside it names that file, which nobody knows.
        let unnamed = |error: io::Error| match error.get_ref().and_then(|named| named.source()) {
            Some(cause) => io::Error::new(error.kind(), cause.to_string()),
            None => error,
        };
        let flags = OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC;
        if let Ok(opened) = rustix::fs::open(directory_of(file), flags, Mode::from_raw_mode(0o600))
        {
            return Ok(Self::Unnamed(opened.into(), file.to_owned()));
        }
        let temporary = NamedTempFile::new_in(directory_of(file)).map_err(unnamed)?;
        Ok(Self::Beside(temporary, file.to_owned()))
    }

    /// Creates an output that a user named: devices and links are written in place.
    ///
    /// # Errors
    /// Returns an error of the file system.
    pub fn create_output(file: &Path) -> io::Result<Self> {
        let in_place = file.symlink_metadata().is_ok_and(|there| !there.is_file());
        if in_place {
            File::create(file).map(Self::InPlace)
        } else {
            Self::create(file)
        }
    }

    /// Returns the file that is written.
    pub fn file(&mut self) -> &mut File {
        match self {
            Self::InPlace(file) | Self::Unnamed(file, _) => file,
            Self::Beside(temporary, _) => temporary.as_file_mut(),
        }
    }

    /// Gives the file its name, after its content is on the disk.
    ///
    /// # Errors
    /// Returns an error of the file system; the old file is unchanged then.
    pub fn commit(self) -> io::Result<()> {
        let (content, temporary, file) = match self {
            Self::InPlace(_) => return Ok(()),
            Self::Unnamed(content, file) => (content, None, file),
            Self::Beside(temporary, file) => {
                let (content, name) = temporary.into_parts();
                (content, Some(name), file)
            }
        };
        content.set_permissions(Permissions::from_mode(0o644))?;
        content.sync_all()?;
        let folder = directory_of(&file);
        let temporary = match temporary {
            Some(temporary) => temporary,
            // An existing file can be replaced only by one that has a name.
            None => tempfile::Builder::new()
                .make_in(folder, |name| give_name(&content, name))?
                .into_temp_path(),
        };
        temporary.persist(&file).map_err(|e| e.error)?;
        File::open(folder)?.sync_all()
    }
}

impl Write for PendingFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file().flush()
    }
}

/// Writes a file atomically; it is durable before its name appears.
///
/// # Errors
/// Returns an error of the file system; the old file is unchanged then.
pub fn write_atomically(file: &Path, content: impl AsRef<[u8]>) -> io::Result<()> {
    let mut pending = PendingFile::create(file)?;
    pending.write_all(content.as_ref())?;
    pending.commit()
}

fn give_name(content: &File, name: &Path) -> io::Result<()> {
    let open = format!("/proc/self/fd/{}", content.as_raw_fd());
    Ok(rustix::fs::linkat(
        CWD,
        open,
        CWD,
        name,
        AtFlags::SYMLINK_FOLLOW,
    )?)
}

fn directory_of(file: &Path) -> &Path {
    file.parent()
        .filter(|directory| !directory.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}
