//! Contents of a store, read without a lock: for reports, pages, exports and the daemon itself.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::disk::{DirectoryEntry, Disk, StoreError, StoreResult};
use crate::format::append_file_kinds::AppendFileKind;
use crate::format::chain::Chain;
use crate::format::manifest::{FlightManifest, SeriesManifest};
use crate::format::{jsonl, layout};

/// Reference to a flight.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlightRef {
    /// Name of the flight.
    pub id: String,
    pub folder: PathBuf,
}

/// Reference to a finished series.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SeriesRef {
    /// Name of the flight.
    pub flight: String,
    /// Name of the series.
    pub id: String,
    pub folder: PathBuf,
}

/// Parses `store.toml`; `None` if it cannot be read.
fn read_format_file(disk: &dyn Disk, root: &Path) -> Option<toml::Table> {
    let bytes = disk.read(&root.join(layout::STORE_FILE)).ok()?;
    std::str::from_utf8(&bytes).ok()?.parse().ok()
}

/// Returns the store's id; `None` for a store without evidence (format 1).
pub fn store_id(disk: &dyn Disk, root: &Path) -> Option<String> {
    let mark = read_format_file(disk, root)?;
    let id = mark
        .get("id")
        .and_then(toml::Value::as_str)
        .unwrap_or_default();
    (mark.get("format")?.as_integer()? == i64::from(layout::FORMAT)).then(|| id.to_owned())
}

/// Refuses a store that has links. They lead out of it, and a store may come from elsewhere. Files in the folder of a series
/// are refused when they are opened, because there are many.
pub(crate) fn refuse_links(disk: &dyn Disk, root: &Path) -> StoreResult<()> {
    let mut all = disk.walk(root, 3);
    all.extend(disk.walk(&root.join(layout::FETCHING), 4));
    let found = all.into_iter().find(|(_, entry)| entry.is_link);
    found.map_or(Ok(()), |(path, _)| {
        Err(StoreError::Damaged {
            path,
            problem: "is a link, which leads out of the store".to_owned(),
            remedy: "move it out of the store, or replace it by the files themselves",
        })
    })
}

/// Checks that `root` is a store in a supported format, without links.
pub fn check_format(disk: &dyn Disk, root: &Path) -> StoreResult<()> {
    refuse_links(disk, root)?;
    check_format_file(disk, root)
}

/// Checks the format file.
pub(crate) fn check_format_file(disk: &dyn Disk, root: &Path) -> StoreResult<()> {
    let path = root.join(layout::STORE_FILE);
    if !disk.exists(&path) {
        let why = format!("it has no {}", layout::STORE_FILE);
        return Err(StoreError::NotAStore {
            path: root.to_owned(),
            why,
        });
    }
    disk.load_file(&path)?;
    let mark = read_format_file(disk, root);
    let known = [layout::FORMAT_WITHOUT_EVIDENCE, layout::FORMAT].map(i64::from);
    let format = mark.as_ref().and_then(|mark| mark.get("format"));
    let number = format.and_then(toml::Value::as_integer);
    let has_id = store_id(disk, root).is_some_and(|id| !id.is_empty());
    match format {
        Some(_) if number == Some(known[0]) || has_id => Ok(()),
        Some(format) if number != Some(known[1]) => Err(StoreError::Version {
            path,
            found: format.to_string(),
            supported: layout::FORMAT,
        }),
        _ => Err(StoreError::Damaged {
            path,
            problem: "has no format number or no id".to_owned(),
            remedy: "a recorder rebuilds it from the chains of the flights; if they have none, restore it from a copy",
        }),
    }
}

/// Lists the flights of a store, in order.
pub fn list_flights(disk: &dyn Disk, root: &Path) -> StoreResult<Vec<FlightRef>> {
    let folder = root.join(layout::FLIGHTS);
    let ids = numbered_names(disk, &folder, layout::flight_number, |entry| entry.is_dir)?;
    Ok(ids
        .into_iter()
        .map(|id| FlightRef {
            folder: folder.join(&id),
            id,
        })
        .collect())
}

/// Lists the finished series of a flight, in order.
pub fn list_series(disk: &dyn Disk, flight: &FlightRef) -> StoreResult<Vec<SeriesRef>> {
    let ids = numbered_names(disk, &flight.folder, layout::series_number, |entry| {
        entry.is_dir
    })?;
    let series = |id: String| SeriesRef {
        flight: flight.id.clone(),
        folder: flight.folder.join(&id),
        id,
    };
    Ok(ids.into_iter().map(series).collect())
}

/// Lists the closed files of a kind in a flight, in order.
pub(crate) fn closed_files(
    disk: &dyn Disk,
    flight: &FlightRef,
    kind: &AppendFileKind,
) -> StoreResult<Vec<String>> {
    numbered_names(disk, &flight.folder, kind.closed_number, |entry| {
        !entry.is_dir
    })
}

/// Calls `give` with the content of a flight's files of a kind, in the order written: the closed ones, then the one being
/// written, which may belong to another flight.
pub(crate) fn for_each_file<E: From<StoreError>>(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
    kind: &AppendFileKind,
    mut give: impl FnMut(&Path, &[u8]) -> Result<(), E>,
) -> Result<(), E> {
    // The open file is read first: if a recorder closes it meanwhile, it is among the closed ones listed next.
    let path = root.join(kind.open_name);
    let mut open = disk.load_if_exists(&path)?;
    for closed in closed_files(disk, flight, kind)?
        .into_iter()
        .map(|file| flight.folder.join(file))
    {
        let bytes = disk.load_file(&closed)?;
        open = open.filter(|open| !bytes.starts_with(open));
        give(&closed, &bytes)?;
    }
    open.map_or(Ok(()), |bytes| give(&path, &bytes))
}

/// Heads with their lines, and notes on unreadable files.
type HeadedFiles<H, L> = (Vec<(H, Vec<L>)>, Vec<String>);

/// Reads the head and the lines of a flight's files of a kind, in the order written; `flight_of` returns the flight in a head.
/// Returns them with notes on unreadable files.
pub(crate) fn read_headed_files<H: DeserializeOwned, L: DeserializeOwned>(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
    kind: &AppendFileKind,
    flight_of: fn(&H) -> &str,
) -> StoreResult<HeadedFiles<H, L>> {
    let (mut all, mut notes) = (Vec::new(), Vec::new());
    for_each_file(disk, root, flight, kind, |path, bytes| {
        match jsonl::parse_headed::<H, L>(bytes) {
            Some((head, lines)) if flight_of(&head) == flight.id => all.push((head, lines)),
            Some(_) => {}
            None => notes.push(format!(
                "{}: its first line is damaged; run `wingd verify`",
                path.display()
            )),
        }
        Ok::<_, StoreError>(())
    })?;
    Ok((all, notes))
}

/// Lists numbered names in a folder, sorted by number.
fn numbered_names(
    disk: &dyn Disk,
    folder: &Path,
    number: fn(&str) -> Option<u64>,
    is_member: fn(&DirectoryEntry) -> bool,
) -> StoreResult<Vec<String>> {
    let entries = disk.list_entries(folder)?.into_iter().filter(is_member);
    let mut found: Vec<_> = entries
        .filter_map(|e| Some((number(&e.name)?, e.name)))
        .collect();
    found.sort();
    Ok(found.into_iter().map(|(_, name)| name).collect())
}

/// Reads a flight's chain: its bytes, empty if there is none, and the parsed chain.
pub(crate) fn read_chain(disk: &dyn Disk, flight: &Path) -> StoreResult<(Vec<u8>, Chain)> {
    let bytes = disk
        .load_if_exists(&flight.join(layout::CHAIN_FILE))?
        .unwrap_or_default();
    let chain = Chain::parse(&bytes);
    Ok((bytes, chain))
}

/// Reads the manifest of a flight, `flight.json`.
pub fn read_flight_manifest(disk: &dyn Disk, flight: &FlightRef) -> StoreResult<FlightManifest> {
    read_json(disk, &flight.folder.join(layout::FLIGHT_FILE))
}

/// Returns whether a flight has the given id, or was imported under the given name.
pub fn is_called(disk: &dyn Disk, flight: &FlightRef, name: &str) -> bool {
    let imported_name = || {
        read_flight_manifest(disk, flight)
            .ok()
            .and_then(|manifest| manifest.name)
    };
    flight.id == name
        || layout::flight_number(name).is_none() && imported_name().as_deref() == Some(name)
}

/// Reads the manifest of a series, `series.json`.
pub fn read_series_manifest(disk: &dyn Disk, series: &SeriesRef) -> StoreResult<SeriesManifest> {
    read_json(disk, &series.folder.join(layout::SERIES_FILE))
}

/// Length of the pieces in which a file of lines is read, bytes.
const PIECE_BYTES: usize = 256 * 1024;

/// Calls `give` with the place of each complete line of a file, and the line without its newline. Reads in pieces: results
/// of a long series do not fit into the memory of a recorder. A missing file has no lines.
pub fn for_each_line(
    disk: &dyn Disk,
    path: &Path,
    mut give: impl FnMut(std::ops::Range<u64>, &[u8]),
) -> StoreResult<()> {
    let (mut buffer, mut at) = (Vec::new(), 0);
    loop {
        let piece = match disk.read_range(path, at + buffer.len() as u64, PIECE_BYTES) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            read => read.map_err(StoreError::io(path, "read"))?,
        };
        buffer.extend_from_slice(&piece);
        let mut begin = 0;
        for end in memchr::memchr_iter(b'\n', &buffer) {
            give(
                at + begin as u64..at + end as u64,
                buffer.get(begin..end).unwrap_or_default(),
            );
            begin = end + 1;
        }
        buffer.drain(..begin);
        at += begin as u64;
        if piece.len() < PIECE_BYTES {
            return Ok(());
        }
    }
}

fn read_json<T: DeserializeOwned>(disk: &dyn Disk, path: &Path) -> StoreResult<T> {
    serde_json::from_slice(&disk.load_file(path)?).map_err(|error| StoreError::Damaged {
        path: path.to_owned(),
        problem: error.to_string(),
        remedy: "copy it from an export or a backup; run `wingd verify` for other damage",
    })
}
