//! Bounded reader of regular files: pipes and devices, which could block a reader or never end, are refused, and so are
//! files that are larger than their kind can be.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

/// Largest file that a user writes or a command prepares: configuration, installation, key, token, list, bytes.
pub const MAX_FILE_BYTES: u64 = 16 << 20;
/// Largest image or table of a flight, bytes.
pub const MAX_DATA_BYTES: u64 = 1 << 30;

/// Flag with which opening a pipe does not wait for its other end; it has no effect on regular files.
const NONBLOCK: i32 = rustix::fs::OFlags::NONBLOCK.bits() as i32;

/// Returns an error for anything but a regular file.
fn require_regular(metadata: &Metadata) -> io::Result<()> {
    let kind = metadata.file_type();
    let problem = match () {
        () if kind.is_file() => return Ok(()),
        () if kind.is_dir() => "is a folder, not a file",
        () if kind.is_fifo() => "is a pipe, not a regular file",
        () if kind.is_socket() => "is a socket, not a regular file",
        () => "is a device, not a regular file",
    };
    Err(io::Error::new(io::ErrorKind::InvalidInput, problem))
}

/// Opens a regular file, without waiting for a pipe's other end, and returns it with its length, bytes.
///
/// # Errors
/// Returns an error for a folder, pipe, socket or device, and if the file cannot be opened.
pub fn open_regular_file(path: &Path, options: &mut OpenOptions) -> io::Result<(File, u64)> {
    // Before opening: to open a device can already have an effect.
    match path.metadata() {
        Ok(metadata) => require_regular(&metadata)?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    let file = options.custom_flags(NONBLOCK).open(path)?;
    let metadata = file.metadata()?;
    require_regular(&metadata)?;
    Ok((file, metadata.len()))
}

/// Reads a complete regular file of at most `max_bytes`.
///
/// # Errors
/// Returns an error for a folder, pipe, socket or device, for a larger file, and if the file cannot be read.
pub fn read_regular_file(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let (file, length) = open_regular_file(path, OpenOptions::new().read(true))?;
    let too_large = |length: u64| {
        let (megabytes, limit) = (length / 1_000_000, max_bytes / 1_000_000);
        let problem = format!("has more than {limit} MB: {megabytes} MB");
        io::Error::new(io::ErrorKind::FileTooLarge, problem)
    };
    if length > max_bytes {
        return Err(too_large(length));
    }
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0));
    // The limit also holds for a file that grows, and for those of /proc, which state no length.
    file.take(max_bytes.saturating_add(1))
        .read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        return Err(too_large(bytes.len() as u64));
    }
    Ok(bytes)
}

/// Reads a regular text file of at most [`MAX_FILE_BYTES`].
///
/// # Errors
/// Returns an error as [`read_regular_file`] does, and if the file is not UTF-8.
pub fn read_small_text(path: &Path) -> io::Result<String> {
    let bytes = read_regular_file(path, MAX_FILE_BYTES)?;
    String::from_utf8(bytes)
        .map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "is not UTF-8 text"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_within_the_limit_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let (pipe, file) = (folder.path().join("pipe"), folder.path().join("file"));
        rustix::fs::mknodat(
            rustix::fs::CWD,
            &pipe,
            rustix::fs::FileType::Fifo,
            0o600.into(),
            0,
        )
        .unwrap();
        std::fs::write(&file, [b'x'; 101]).unwrap();
        let problem = |path: &Path, limit| read_regular_file(path, limit).unwrap_err().to_string();
        assert_eq!(problem(&pipe, 100), "is a pipe, not a regular file");
        assert_eq!(problem(folder.path(), 100), "is a folder, not a file");
        let device = Path::new("/dev/zero");
        assert_eq!(problem(device, 100), "is a device, not a regular file");
        assert_eq!(problem(&file, 100), "has more than 0 MB: 0 MB");
        assert_eq!(read_regular_file(&file, 101).unwrap().len(), 101);
        // Without a stated length.
        let endless = Path::new("/proc/self/maps");
        assert!(problem(endless, 100).starts_with("has more than"));
    }
}
