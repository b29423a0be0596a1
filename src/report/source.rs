//! From a store to what a report shows. Damage in one place does not hide the rest: it is noted.

use std::path::Path;

use super::{Picture, ReportData, SeriesData, ShotData, Site};
use crate::measure::setup::Setup;
use crate::record::{ImageRecord, Status};
use crate::store::manifest::{Refusal, ResultLine, SeriesManifest, Shot, State};
use crate::store::{self, Disk, FlightRef, RealDisk, SeriesRef, StoreError, catalogue, jsonl, layout};

/// Reads one flight, the newest with a series where none is named, and a frame of it to be shown.
pub fn flight(root: &Path, flight: Option<&str>, setup: Option<&Setup>) -> Result<ReportData, StoreError> {
    let disk = RealDisk;
    catalogue::check_format(&disk, root)?;
    let chosen = choose(&disk, root, flight)?;
    let mut data = ReportData { site: setup.map(Site::from), ..ReportData::default() };
    for series in chosen.iter().map(|f| catalogue::series(&disk, f)).collect::<Result<Vec<_>, _>>()?.concat()
    {
        data.series.extend(read_series(&disk, &series, &mut data.notes));
    }
    data.notes.extend(refusals(&disk, root));
    data.picture = picture(&disk, root, &data.series, &mut data.notes);
    Ok(data)
}

/// Reads every series of the store, without pictures.
pub fn all(root: &Path) -> Result<ReportData, StoreError> {
    let disk = RealDisk;
    catalogue::check_format(&disk, root)?;
    let mut data = ReportData::default();
    for flight in catalogue::flights(&disk, root)? {
        for series in catalogue::series(&disk, &flight)? {
            data.series.extend(read_series(&disk, &series, &mut data.notes));
        }
    }
    Ok(data)
}

fn choose(disk: &dyn Disk, root: &Path, wanted: Option<&str>) -> Result<Option<FlightRef>, StoreError> {
    let flights = catalogue::flights(disk, root)?;
    if let Some(wanted) = wanted {
        let known: Vec<&str> = flights.iter().map(|f| f.id.as_str()).collect();
        let why = format!("there is no flight {wanted}, only: {}", known.join(", "));
        let missing = || StoreError::NotAStore { path: layout::finished(root, wanted, ""), why };
        return flights.iter().find(|f| f.id == wanted).cloned().map(Some).ok_or_else(missing);
    }
    let taken = |f: &&FlightRef| catalogue::series(disk, f).is_ok_and(|s| !s.is_empty());
    Ok(flights.iter().rev().find(taken).cloned())
}

fn read_series(disk: &dyn Disk, series: &SeriesRef, notes: &mut Vec<String>) -> Option<SeriesData> {
    let manifest = catalogue::manifest(disk, series).map_err(|e| notes.push(e.to_string())).ok()?;
    let lines = catalogue::latest_results(disk, series).unwrap_or_else(|e| {
        notes.push(e.to_string());
        Vec::new()
    });
    let records = lines.into_iter().filter_map(|line| record(series, line, notes)).collect();
    Some(SeriesData {
        flight: series.flight.clone(),
        name: series.id.clone(),
        begun: begun(&manifest),
        interrupted: manifest.state == State::Interrupted,
        planned: manifest.planned_shots as usize,
        records,
        remarks: manifest.remarks,
        shots: manifest.shots.into_iter().map(shot).collect(),
    })
}

fn begun(manifest: &SeriesManifest) -> Option<crate::clock::Stamp> {
    manifest.started.clone().or_else(|| manifest.shots.first().map(|s| s.stamp.clone()))
}

/// The result as written, under the name that its frame has in the store.
fn record(series: &SeriesRef, line: ResultLine, notes: &mut Vec<String>) -> Option<ImageRecord> {
    let place = format!("{}/{}/{}: {}", series.flight, series.id, layout::RESULTS_FILE, line.frame);
    match serde_json::from_value::<ImageRecord>(line.record) {
        Ok(record) => Some(ImageRecord { image: line.frame, ..record }),
        Err(error) => {
            notes.push(format!("{place}: the result cannot be read ({error}); run `wingd verify`"));
            None
        }
    }
}

fn shot(shot: Shot) -> ShotData {
    let reason = |f: &store::manifest::Failure| format!("{}: {}", f.kind, f.reason);
    let failures = shot.failures.iter().map(reason).collect();
    let (image, sha256, format) = match shot.frame {
        Some(frame) => (Some(frame.file), Some(frame.sha256), Some(frame.format)),
        None => (None, None, None),
    };
    let format = format.and_then(|f| serde_json::from_value(f).ok());
    ShotData { number: shot.shot, image, stamp: Some(shot.stamp), sha256, format, failures }
}

fn refusals(disk: &dyn Disk, root: &Path) -> Vec<String> {
    let bytes = disk.read(&root.join(layout::REFUSED_FILE)).unwrap_or_default();
    let lines = jsonl::parse::<Refusal>(&bytes).good;
    let text = |r: Refusal| format!("Series refused at {}: {}", r.stamp.utc, r.reason);
    lines.into_iter().map(|(_, refusal)| text(refusal)).collect()
}

/// The first solved frame, or the first frame at all.
fn picture(disk: &dyn Disk, root: &Path, series: &[SeriesData], notes: &mut Vec<String>) -> Option<Picture> {
    let frames = || series.iter().flat_map(|s| s.shots.iter().map(move |shot| (s, shot)));
    let solved = |(s, shot): &(&SeriesData, &ShotData)| {
        let of_shot = |r: &&ImageRecord| Some(&r.image) == shot.image.as_ref();
        s.records.iter().find(of_shot).is_some_and(|r| r.status == Status::Ok)
    };
    let (s, shot) = frames().find(solved).or_else(|| frames().find(|(_, shot)| shot.image.is_some()))?;
    let image = shot.image.clone().filter(|name| layout::is_frame_name(name))?;
    let path = layout::finished(root, &s.flight, &s.name).join(&image);
    match disk.read(&path) {
        Ok(bytes) => Some(Picture { series: s.name.clone(), image, bytes, format: shot.format.clone() }),
        Err(error) => {
            notes.push(format!("{}: the frame cannot be read ({error}); run `wingd verify`", path.display()));
            None
        }
    }
}
