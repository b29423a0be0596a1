//! The names of a request lead to files of the store, and their bytes.

use std::fs;
use std::path::{Path, PathBuf};

use super::Refusal;
use super::Site;
use super::send::{Content, Source};
use crate::store::{self, FlightRef, RealDisk, SeriesRef, catalogue, layout};

/// The flight, where the store has it.
pub fn check_flight(site: &Site, flight: &str) -> Result<FlightRef, Refusal> {
    layout::flight_number(flight).ok_or(Refusal::NotFound)?;
    let folder = site.root.join(layout::FLIGHTS).join(flight);
    let real = fs::symlink_metadata(&folder).is_ok_and(|m| m.is_dir());
    real.then(|| FlightRef { id: flight.to_owned(), folder }).ok_or(Refusal::NotFound)
}

/// The series, where the flight has it.
pub fn check_series(site: &Site, flight: &str, series: &str) -> Result<SeriesRef, Refusal> {
    let flight = check_flight(site, flight)?;
    layout::series_number(series).ok_or(Refusal::NotFound)?;
    let folder = flight.folder.join(series);
    let real = fs::symlink_metadata(&folder).is_ok_and(|m| m.is_dir());
    real.then(|| SeriesRef { flight: flight.id, id: series.to_owned(), folder }).ok_or(Refusal::NotFound)
}

/// A frame's place, where it is a file there.
pub fn check_frame(site: &Site, flight: &str, series: &str, file: &str) -> Result<PathBuf, Refusal> {
    layout::is_frame_name(file).then_some(()).ok_or(Refusal::NotFound)?;
    place(&site.root, &format!("{}/{flight}/{series}/{file}", layout::FLIGHTS))
}

/// A drawing.
pub fn svg(text: String, digest: String) -> Content {
    Content::one(text.len() as u64, Source::Bytes(text.into()), digest, "image/svg+xml", false)
}

/// The flight's own files: `flight.json`, its chain, its sums, the aircraft's data, live results.
pub fn in_flight(site: &Site, flight: &str, file: &str) -> Result<Content, Refusal> {
    layout::flight_number(flight).ok_or(Refusal::NotFound)?;
    let kind = match file {
        layout::FLIGHT_FILE => "application/json",
        layout::CHAIN_FILE | layout::SUMS_FILE => "text/plain; charset=utf-8",
        _ if layout::aircraft_number(file).or(layout::marks_number(file)).is_some() => {
            "text/plain; charset=utf-8"
        }
        _ if layout::live_number(file).is_some() => "application/octet-stream",
        _ => return Err(Refusal::NotFound),
    };
    let path = place(&site.root, &format!("{}/{flight}/{file}", layout::FLIGHTS))?;
    let stays = ![layout::CHAIN_FILE, layout::SUMS_FILE].contains(&file);
    small(&path, kind, stays)
}

/// A frame, `series.json` or `results.jsonl`; the last grows and is sent whole.
pub fn in_series(site: &Site, flight: &str, series: &str, file: &str) -> Result<Content, Refusal> {
    layout::flight_number(flight).and(layout::series_number(series)).ok_or(Refusal::NotFound)?;
    let folder = site.root.join(layout::FLIGHTS).join(flight).join(series);
    let series = SeriesRef { flight: flight.to_owned(), id: series.to_owned(), folder };
    let path = || place(&site.root, &format!("{}/{flight}/{}/{file}", layout::FLIGHTS, series.id));
    match file {
        layout::SERIES_FILE => small(&path()?, "application/json", true),
        layout::RESULTS_FILE => small(&path()?, "text/plain; charset=utf-8", false),
        name if layout::is_frame_name(name) => frame(&path()?, &series, name),
        _ => Err(Refusal::NotFound),
    }
}

/// A frame by the digest that it had when it was taken.
fn frame(path: &Path, series: &SeriesRef, file: &str) -> Result<Content, Refusal> {
    let manifest = catalogue::read_series_manifest(&RealDisk, series)?;
    let frames = store::series_frames(series, manifest);
    let entry = frames.into_iter().map(|f| f.entry).find(|e| e.file == file).ok_or(Refusal::NotFound)?;
    let kind = match path.extension().and_then(|ending| ending.to_str()) {
        Some("jpg" | "jpeg") => "image/jpeg",
        Some("png") => "image/png",
        _ => "application/octet-stream",
    };
    Ok(Content::one(entry.bytes, Source::File(path.to_owned()), entry.sha256, kind, true))
}

/// A file that is read here, with its own digest.
fn small(path: &Path, kind: &'static str, by_range: bool) -> Result<Content, Refusal> {
    let bytes =
        fs::read(path).map_err(|e| Refusal::Failed(format!("{}: could not read: {e}", path.display())))?;
    let digest = store::sha256_hex(&bytes);
    Ok(Content::one(bytes.len() as u64, Source::Bytes(bytes.into()), digest, kind, by_range))
}

/// A regular file at exactly this place: no link on the way leads elsewhere.
fn place(root: &Path, name: &str) -> Result<PathBuf, Refusal> {
    let wanted = fs::canonicalize(root).map(|root| root.join(name));
    let found = fs::canonicalize(root.join(name));
    match (wanted, found) {
        (Ok(wanted), Ok(found)) if wanted == found && found.is_file() => Ok(found),
        _ => Err(Refusal::NotFound),
    }
}
