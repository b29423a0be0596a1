//! Names of a request -> files of the store, and their bytes.

use std::fs;
use std::path::{Path, PathBuf};

use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use tower_http::services::ServeFile;

use super::{Refusal, Site};
use crate::store::layout;

/// A file that may be sent.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// On disk.
    pub path: PathBuf,
    /// From the store's root, with `/`.
    pub name: String,
    /// Never changes once it is there: may be cached and fetched by range.
    pub immutable: bool,
}

/// Whether the store has this flight.
pub fn check_flight(site: &Site, flight: &str) -> Result<(), Refusal> {
    layout::flight_number(flight).ok_or(Refusal::NotFound)?;
    let folder = site.root.join(layout::FLIGHTS).join(flight);
    let real = fs::symlink_metadata(folder).is_ok_and(|m| m.is_dir());
    real.then_some(()).ok_or(Refusal::NotFound)
}

/// `flight.json`.
pub fn in_flight(site: &Site, flight: &str, file: &str) -> Result<Place, Refusal> {
    layout::flight_number(flight).ok_or(Refusal::NotFound)?;
    if file != layout::FLIGHT_FILE {
        return Err(Refusal::NotFound);
    }
    place(&site.root, format!("{}/{flight}/{file}", layout::FLIGHTS), true)
}

/// A frame, `series.json` or `results.jsonl`; the last grows and is sent whole.
pub fn in_series(site: &Site, flight: &str, series: &str, file: &str) -> Result<Place, Refusal> {
    layout::flight_number(flight).and(layout::series_number(series)).ok_or(Refusal::NotFound)?;
    let grows = file == layout::RESULTS_FILE;
    if !(grows || file == layout::SERIES_FILE || layout::is_frame_name(file)) {
        return Err(Refusal::NotFound);
    }
    place(&site.root, format!("{}/{flight}/{series}/{file}", layout::FLIGHTS), !grows)
}

/// Every file of a flight, in order of their names.
pub fn of_flight(site: &Site, flight: &str) -> Result<Vec<Place>, Refusal> {
    check_flight(site, flight)?;
    let folder = site.root.join(layout::FLIGHTS).join(flight);
    let mut places: Vec<Place> = in_flight(site, flight, layout::FLIGHT_FILE).into_iter().collect();
    for series in names(&folder)? {
        if layout::series_number(&series).is_some() {
            let files = names(&folder.join(&series))?;
            places.extend(files.iter().filter_map(|file| in_series(site, flight, &series, file).ok()));
        }
    }
    Ok(places)
}

fn names(folder: &Path) -> Result<Vec<String>, Refusal> {
    let read = |e: std::io::Error| Refusal::Failed(format!("{}: could not list: {e}", folder.display()));
    let entries = fs::read_dir(folder).map_err(read)?;
    let mut names: Vec<String> = entries.filter_map(|e| e.ok()?.file_name().into_string().ok()).collect();
    names.sort();
    Ok(names)
}

/// A regular file at exactly this place: no link on the way leads elsewhere.
fn place(root: &Path, name: String, immutable: bool) -> Result<Place, Refusal> {
    let wanted = fs::canonicalize(root).map(|root| root.join(&name));
    let found = fs::canonicalize(root.join(&name));
    match (wanted, found) {
        (Ok(wanted), Ok(found)) if wanted == found && found.is_file() => {
            Ok(Place { path: found, name, immutable })
        }
        _ => Err(Refusal::NotFound),
    }
}

/// The file's bytes. What never changes can be fetched by range and kept; what grows is sent whole,
/// because a range of it could join two states.
pub async fn send(place: Place, mut request: Request) -> Result<Response, Refusal> {
    if !place.immutable {
        request.headers_mut().remove(header::RANGE);
    }
    let answer = ServeFile::new(&place.path).try_call(request).await;
    let answer = answer.map_err(|e| Refusal::Failed(format!("{}: could not read: {e}", place.name)))?;
    let mut response = answer.map(Body::new).into_response();
    let keep = if place.immutable { "public, max-age=31536000, immutable" } else { "no-cache" };
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static(keep));
    if !place.immutable {
        response.headers_mut().remove(header::ACCEPT_RANGES);
    }
    Ok(response)
}
