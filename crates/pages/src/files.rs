//! Files of the store for the names in a request, and their bytes.

use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::Refusal;
use super::Site;
use super::send::{Content, ContentSource};
use wingd_store as store;
use wingd_store::{Disk, FlightRef, RealDisk, SeriesRef, StoreError, catalogue, layout};

/// Returns the flight if the store has it.
pub fn check_flight(site: &Site, flight: &str) -> Result<FlightRef, Refusal> {
    layout::flight_number(flight).ok_or(Refusal::NotFound)?;
    let folder = site.root.join(layout::FLIGHTS).join(flight);
    let real = fs::symlink_metadata(&folder).is_ok_and(|m| m.is_dir());
    real.then(|| FlightRef {
        id: flight.to_owned(),
        folder,
    })
    .ok_or(Refusal::NotFound)
}

/// Returns the series if the flight has it.
pub fn check_series(site: &Site, flight: &str, series: &str) -> Result<SeriesRef, Refusal> {
    let flight = check_flight(site, flight)?;
    layout::series_number(series).ok_or(Refusal::NotFound)?;
    let folder = flight.folder.join(series);
    let real = fs::symlink_metadata(&folder).is_ok_and(|m| m.is_dir());
    real.then(|| SeriesRef {
        flight: flight.id,
        id: series.to_owned(),
        folder,
    })
    .ok_or(Refusal::NotFound)
}

/// Returns the path of a frame if the file exists.
pub fn check_frame(
    site: &Site,
    flight: &str,
    series: &str,
    file: &str,
) -> Result<PathBuf, Refusal> {
    layout::is_frame_name(file)
        .then_some(())
        .ok_or(Refusal::NotFound)?;
    store_path(
        &site.root,
        &format!("{}/{flight}/{series}/{file}", layout::FLIGHTS),
    )
}

/// Returns the content of an SVG drawing.
pub fn svg_content(text: String, digest: String) -> Content {
    Content::from_source(
        text.len() as u64,
        ContentSource::Bytes(text.into()),
        digest,
        "image/svg+xml",
        false,
    )
}

/// Returns a file of the flight itself: `flight.json`, chain, checksums, aircraft data, manual marks or live results.
pub fn flight_file_content(site: &Site, flight: &str, file: &str) -> Result<Content, Refusal> {
    layout::flight_number(flight).ok_or(Refusal::NotFound)?;
    let kind = match file {
        layout::FLIGHT_FILE => "application/json",
        layout::CHAIN_FILE | layout::SUMS_FILE => "text/plain; charset=utf-8",
        _ if layout::aircraft_number(file)
            .or(layout::marks_number(file))
            .is_some() =>
        {
            "text/plain; charset=utf-8"
        }
        _ if layout::live_number(file).is_some() => "application/octet-stream",
        _ => return Err(Refusal::NotFound),
    };
    let path = store_path(&site.root, &format!("{}/{flight}/{file}", layout::FLIGHTS))?;
    let stays = ![layout::CHAIN_FILE, layout::SUMS_FILE].contains(&file);
    // The checksums are replaced when the flight grows: one state is read at once.
    if file == layout::SUMS_FILE {
        let bytes = RealDisk
            .read(&path)
            .map_err(StoreError::io(&path, "read"))?;
        let digest = store::sha256_hex(&bytes);
        return Ok(Content::from_source(
            bytes.len() as u64,
            ContentSource::Bytes(bytes.into()),
            digest,
            kind,
            false,
        ));
    }
    file_content(&path, kind, stays)
}

/// Returns a file of a series: a frame, `series.json` or `results.jsonl`. `results.jsonl` grows and is sent without ranges.
pub fn series_file_content(
    site: &Site,
    flight: &str,
    series: &str,
    file: &str,
) -> Result<Content, Refusal> {
    layout::flight_number(flight)
        .and(layout::series_number(series))
        .ok_or(Refusal::NotFound)?;
    let folder = site.root.join(layout::FLIGHTS).join(flight).join(series);
    let series = SeriesRef {
        flight: flight.to_owned(),
        id: series.to_owned(),
        folder,
    };
    let path = || {
        store_path(
            &site.root,
            &format!("{}/{flight}/{}/{file}", layout::FLIGHTS, series.id),
        )
    };
    match file {
        layout::SERIES_FILE => file_content(&path()?, "application/json", true),
        layout::RESULTS_FILE => file_content(&path()?, "text/plain; charset=utf-8", false),
        name if layout::is_frame_name(name) => frame_content(&path()?, &series, name),
        _ => Err(Refusal::NotFound),
    }
}

/// Returns a frame, with the digest recorded when it was taken.
fn frame_content(path: &Path, series: &SeriesRef, file: &str) -> Result<Content, Refusal> {
    let manifest = catalogue::read_series_manifest(&RealDisk, series)?;
    let frames = store::series_frames(series, manifest);
    let entry = frames
        .into_iter()
        .map(|f| f.entry)
        .find(|e| e.file == file)
        .ok_or(Refusal::NotFound)?;
    let kind = match path.extension().and_then(|ending| ending.to_str()) {
        Some("jpg" | "jpeg") => "image/jpeg",
        Some("png") => "image/png",
        _ => "application/octet-stream",
    };
    Ok(Content::from_source(
        entry.bytes,
        ContentSource::File(path.to_owned()),
        entry.sha256,
        kind,
        true,
    ))
}

/// Returns the present content of a file. The digest identifies the file and its state, so that it need not be read.
fn file_content(path: &Path, kind: &'static str, by_range: bool) -> Result<Content, Refusal> {
    let failed = |e: io::Error| Refusal::Failed(format!("{}: could not read: {e}", path.display()));
    let meta = fs::metadata(path).map_err(failed)?;
    let state = (
        path,
        meta.dev(),
        meta.ino(),
        meta.len(),
        meta.mtime(),
        meta.mtime_nsec(),
    );
    let digest = store::sha256_hex(format!("{state:?}").as_bytes());
    Ok(Content::from_source(
        meta.len(),
        ContentSource::File(path.to_owned()),
        digest,
        kind,
        by_range,
    ))
}

/// Returns the path of a regular file inside the store; a symbolic link that leads elsewhere is not followed.
fn store_path(root: &Path, name: &str) -> Result<PathBuf, Refusal> {
    let expected = fs::canonicalize(root).map(|root| root.join(name));
    let found = fs::canonicalize(root.join(name));
    match (expected, found) {
        (Ok(expected), Ok(found)) if expected == found && found.is_file() => Ok(found),
        _ => Err(Refusal::NotFound),
    }
}
