//! Reading of a report's data from a store. Damaged files are reported in the notes and do not hide the rest.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use super::frame_ranking::FrameRanking;
use super::{
    FramePicture, FullRecord, MarkerCount, ReportData, ReportSite, SeriesData, ShotData, aircraft,
    summary,
};
use crate::aircraft::{AircraftState, AircraftTrack};
use crate::installation;
use crate::record::{ImageRecord, Model, Quality};
use wingd_measure::setup::Setup;
use wingd_store as store;
use wingd_store::manifest::{RefusedSeries, ResultLine, SeriesManifest, SeriesState, Shot};
use wingd_store::result_sets;
use wingd_store::result_sets::{ResultGrouper, ResultSet};
use wingd_store::{
    Disk, FlightRef, RealDisk, SeriesRef, StoreError, StoreResult, catalogue, installations, jsonl,
    layout,
};

/// Selection of a flight and of one of its result sets.
#[derive(Clone, Copy, Debug, Default)]
pub struct ResultChoice<'a> {
    /// Name of the flight; `None` for the default of the reading function.
    pub flight: Option<&'a str>,
    /// Beginning of the key of the inputs; `None` for the default of [`result_sets::ResultSets::choose_set`].
    pub inputs: Option<&'a str>,
}

/// Maximum number of frames with a full record in a report: about 4 MB of the page with 40 markers each.
const MAX_FULL_RECORDS: usize = 400;
/// Default number of images in a report, about 200 kB of the page each.
pub const DEFAULT_PICTURES: usize = 4;

/// Reads one flight with [`DEFAULT_PICTURES`] images: the named one, or the newest one that has a series. Without a setup,
/// ground shape and camera are those of the installation that the store keeps with the results.
///
/// # Errors
/// Returns an error if [`read_flight_with_pictures`] does.
pub fn read_flight(
    root: &Path,
    choice: ResultChoice,
    setup: Option<&Setup>,
) -> StoreResult<ReportData> {
    read_flight_with_pictures(root, choice, setup, DEFAULT_PICTURES)
}

/// Reads one flight with up to `pictures` images. Only the frames that rank first keep their full records; the others keep
/// the values of a list.
///
/// # Errors
/// Returns an error if there is no store, no such flight, or no result with the selected inputs.
pub fn read_flight_with_pictures(
    root: &Path,
    choice: ResultChoice,
    setup: Option<&Setup>,
    pictures: usize,
) -> StoreResult<ReportData> {
    let disk = RealDisk;
    catalogue::check_format(&disk, root)?;
    let mut data = ReportData {
        site: setup.map(ReportSite::from),
        ..ReportData::default()
    };
    let mut whole = FrameRanking::new(MAX_FULL_RECORDS.max(pictures));
    if let Some(chosen) = find_named_or_newest_flight(&disk, root, choice.flight)? {
        let set = select_results(&disk, &chosen, choice, &mut data.warnings)?;
        data.site = data.site.or_else(|| stored_site(root, set.as_ref()?));
        let flights = catalogue::list_flights(&disk, root)?.into_iter();
        data.other_flights = flights
            .map(|f| f.id)
            .filter(|id| *id != chosen.id)
            .collect();
        let track = read_aircraft_track(&disk, root, &chosen, &mut data.notes)?;
        data.feed = (!track.is_empty()).then(|| (track.unused, track.len()));
        for series in catalogue::list_series(&disk, &chosen)? {
            let read = read_series(&disk, &series, set.as_ref(), &mut data.notes);
            let joined = read.map(|mut series| {
                aircraft::join_aircraft_data(&track, &mut series);
                series
            });
            data.series
                .extend(joined.map(|series| reduce_series(series, &mut whole)));
        }
    }
    data.notes.extend(describe_refused_series(&disk, root));
    data.frames = whole.into_frames();
    data.pictures = select_pictures(&data, pictures, |series, shot| {
        read_picture(&disk, root, series, shot)
    });
    let errors = data.pictures.iter().filter_map(|p| p.fault.clone());
    data.notes.extend(errors);
    Ok(data)
}

/// Returns the installation of a result set; `None` if the store does not keep it or this program cannot read it.
fn stored_site(root: &Path, set: &ResultSet) -> Option<ReportSite> {
    let digest = installations::digest_from_provenance(&set.provenance)?;
    let folder = installations::installation_folder(root, &digest);
    installation::load_without_orientation(&folder)
        .ok()
        .map(|installation| ReportSite::from(&installation.setup))
}

/// Flight name of images that are in no store.
pub const PICTURES_FLIGHT: &str = "pictures";

/// Builds the report of images that are in no store, from series with full records. `picture` returns the image of a shot.
pub fn pictures_report(
    series: Vec<SeriesData>,
    setup: &Setup,
    picture: impl Fn(&SeriesData, &ShotData) -> Option<FramePicture>,
) -> ReportData {
    let mut data = ReportData {
        site: Some(ReportSite::from(setup)),
        ..ReportData::default()
    };
    let mut whole = FrameRanking::new(MAX_FULL_RECORDS);
    data.series.extend(
        series
            .into_iter()
            .map(|series| reduce_series(series, &mut whole)),
    );
    data.frames = whole.into_frames();
    data.pictures = select_pictures(&data, DEFAULT_PICTURES, picture);
    data
}

/// Passes the series of the selected flight, or of all flights, to `take` one at a time, with full records. Returns notes
/// and warnings.
pub fn for_each_series<E: From<StoreError>>(
    root: &Path,
    choice: ResultChoice,
    mut take: impl FnMut(SeriesData) -> Result<(), E>,
) -> Result<ReportData, E> {
    let disk = RealDisk;
    let mut messages = ReportData::default();
    for flight in selected_flights(root, choice.flight)? {
        let set = select_results(&disk, &flight, choice, &mut messages.warnings)?;
        let track = read_aircraft_track(&disk, root, &flight, &mut messages.notes)?;
        for series in catalogue::list_series(&disk, &flight)? {
            if let Some(mut series) = read_series(&disk, &series, set.as_ref(), &mut messages.notes)
            {
                aircraft::join_aircraft_data(&track, &mut series);
                take(series)?;
            }
        }
    }
    Ok(messages)
}

fn read_aircraft_track(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
    notes: &mut Vec<String>,
) -> StoreResult<AircraftTrack> {
    let (track, messages) = aircraft::read_track(disk, root, flight)?;
    notes.extend(messages);
    Ok(track)
}

/// Returns the named flight, or all flights.
pub fn selected_flights(root: &Path, name: Option<&str>) -> StoreResult<Vec<FlightRef>> {
    catalogue::check_format(&RealDisk, root)?;
    match name {
        Some(_) => Ok(find_named_or_newest_flight(&RealDisk, root, name)?
            .into_iter()
            .collect()),
        None => catalogue::list_flights(&RealDisk, root),
    }
}

/// Selects the results of a flight, and warns if there are results from other inputs.
fn select_results(
    disk: &dyn Disk,
    flight: &FlightRef,
    choice: ResultChoice,
    warnings: &mut Vec<String>,
) -> StoreResult<Option<ResultSet>> {
    let sets = result_sets::flight_result_sets(disk, flight)?;
    warnings.extend(sets.mixed_inputs_warning(&flight.id, choice.inputs));
    let found = sets.choose_set(choice.inputs).cloned();
    if let (None, Some(key)) = (&found, choice.inputs) {
        let known: Vec<String> = sets.sets.iter().map(ResultSet::description).collect();
        let why = format!(
            "no results have inputs {key}; available: {}",
            known.join(", ")
        );
        return Err(StoreError::NotAStore {
            path: flight.folder.clone(),
            why,
        });
    }
    Ok(found)
}

/// Reduces the records of a series to the values of a list; the full records are added to the ranking.
fn reduce_series(mut series: SeriesData, whole: &mut FrameRanking) -> SeriesData {
    series.curve = summary::mean_solved_curve(&series.records);
    for record in &mut series.records {
        whole.push(FullRecord {
            series: series.name.clone(),
            record: record.clone(),
        });
        series.counts.push(MarkerCount::from_record(record));
        record.markers.retain(|m| !m.used);
        record.markers.shrink_to_fit();
        record.curve = Vec::new();
        record.model = Model::default();
        record.quality = Quality::default();
    }
    series
}

fn find_named_or_newest_flight(
    disk: &dyn Disk,
    root: &Path,
    name: Option<&str>,
) -> StoreResult<Option<FlightRef>> {
    let flights = catalogue::list_flights(disk, root)?;
    if let Some(name) = name {
        let known: Vec<&str> = flights.iter().map(|f| f.id.as_str()).collect();
        let why = format!("there is no flight {name}; available: {}", known.join(", "));
        let missing = || StoreError::NotAStore {
            path: layout::series_folder(root, name, ""),
            why,
        };
        return flights
            .iter()
            .find(|f| catalogue::is_called(disk, f, name))
            .cloned()
            .map(Some)
            .ok_or_else(missing);
    }
    let taken = |f: &&FlightRef| catalogue::list_series(disk, f).is_ok_and(|s| !s.is_empty());
    Ok(flights.iter().rev().find(taken).cloned())
}

/// Reads a series with full records of a result set; `None` if its manifest cannot be read.
pub fn read_series(
    disk: &dyn Disk,
    series: &SeriesRef,
    set: Option<&ResultSet>,
    notes: &mut Vec<String>,
) -> Option<SeriesData> {
    let manifest = catalogue::read_series_manifest(disk, series)
        .map_err(|e| notes.push(e.to_string()))
        .ok()?;
    let mut damaged = Vec::new();
    let records = result_sets::results_in_set(disk, series, set, |line| {
        parse_record(series, line, &mut damaged)
    });
    let records = records.unwrap_or_else(|e| {
        notes.push(e.to_string());
        Vec::new()
    });
    notes.append(&mut damaged);
    Some(SeriesData {
        records,
        inputs: set.map(|set| set.key.clone()),
        ..series_data(series, manifest)
    })
}

/// Returns a series without its results.
fn series_data(series: &SeriesRef, manifest: SeriesManifest) -> SeriesData {
    SeriesData {
        flight: series.flight.clone(),
        name: series.id.clone(),
        begun: manifest.start_time(),
        interrupted: manifest.state == SeriesState::Interrupted,
        planned: manifest.planned_shots as usize,
        remarks: manifest.remarks,
        shots: manifest.shots.into_iter().map(shot_data).collect(),
        ..SeriesData::default()
    }
}

/// A series with the places of its results, which are read frame by frame: all results of a long event do not fit into the
/// memory of a recorder.
pub struct SeriesIndex {
    /// The series without its results.
    pub data: SeriesData,
    /// Warning if there are results from other inputs than those shown.
    pub warning: Option<String>,
    results: PathBuf,
    places: BTreeMap<String, Range<u64>>,
}

impl SeriesIndex {
    /// Reads the manifest, and the beginnings of the results.
    ///
    /// # Errors
    /// Returns an error if one of the files cannot be read.
    pub fn read(disk: &dyn Disk, series: &SeriesRef) -> StoreResult<Self> {
        let data = series_data(series, catalogue::read_series_manifest(disk, series)?);
        let mut grouper = ResultGrouper::default();
        let heads =
            grouper.add_series(disk, series, &[], |head| (head.set, head.frame, head.place))?;
        let sets = grouper.finish();
        let chosen = sets.choose_set(None);
        let shown = heads
            .into_iter()
            .filter(|(set, ..)| chosen.is_some_and(|chosen| chosen.index() == *set));
        Ok(Self {
            data: SeriesData {
                inputs: chosen.map(|set| set.key.clone()),
                ..data
            },
            warning: sets.mixed_inputs_warning(&series.id, None),
            results: series.folder.join(layout::RESULTS_FILE),
            places: shown.map(|(_, frame, place)| (frame, place)).collect(),
        })
    }

    /// Returns whether there are results.
    pub fn has_results(&self) -> bool {
        !self.places.is_empty()
    }

    /// Reads the result of a frame; `None` if it has none, or a damaged one.
    pub fn record(&self, disk: &dyn Disk, image: &str) -> Option<ImageRecord> {
        let place = self.places.get(image)?;
        let line = disk
            .read_range(
                &self.results,
                place.start,
                usize::try_from(place.end - place.start).ok()?,
            )
            .ok()?;
        let line: ResultLine = serde_json::from_slice(&line).ok()?;
        Some(ImageRecord {
            image: line.frame,
            ..serde_json::from_value(line.record).ok()?
        })
    }
}

/// Parses a result, with the file name that its frame has in the store.
fn parse_record(
    series: &SeriesRef,
    line: ResultLine,
    notes: &mut Vec<String>,
) -> Option<ImageRecord> {
    let place = format!(
        "{}/{}/{}: {}",
        series.flight,
        series.id,
        layout::RESULTS_FILE,
        line.frame
    );
    match serde_json::from_value::<ImageRecord>(line.record) {
        Ok(record) => Some(ImageRecord {
            image: line.frame,
            ..record
        }),
        Err(error) => {
            notes.push(format!(
                "{place}: the result cannot be read ({error}); run `wingd verify`"
            ));
            None
        }
    }
}

fn shot_data(shot: Shot) -> ShotData {
    let reason = |f: &store::manifest::ShotFailure| format!("{}: {}", f.kind, f.reason);
    let failures = shot.failures.iter().map(reason).collect();
    let source = shot
        .frame
        .as_ref()
        .and_then(|f| f.settings.get("source")?.as_str().map(str::to_owned));
    let (image, sha256, format) = match shot.frame {
        Some(frame) => (Some(frame.file), Some(frame.sha256), Some(frame.format)),
        None => (None, None, None),
    };
    let format = format.and_then(|f| serde_json::from_value(f).ok());
    let (number, exposure) = (shot.shot, shot.exposure);
    ShotData {
        number,
        image,
        source,
        stamp: Some(shot.stamp),
        exposure,
        aircraft: AircraftState::new(),
        sha256,
        format,
        failures,
    }
}

fn describe_refused_series(disk: &dyn Disk, root: &Path) -> Vec<String> {
    let bytes = disk
        .read(&root.join(layout::REFUSED_FILE))
        .unwrap_or_default();
    let lines = jsonl::parse_lines::<RefusedSeries>(&bytes).good;
    let text = |r: RefusedSeries| format!("Series rejected at {}: {}", r.stamp.utc, r.reason);
    lines
        .into_iter()
        .map(|(_, refusal)| text(refusal))
        .collect()
}

/// Selects the images of the frames that rank first, or the first frame if there are none.
fn select_pictures(
    data: &ReportData,
    most: usize,
    picture: impl Fn(&SeriesData, &ShotData) -> Option<FramePicture>,
) -> Vec<FramePicture> {
    let ranked = data.frames.iter().filter_map(|frame| {
        let series = data.series.iter().find(|s| s.name == frame.series)?;
        let shot = series
            .shots
            .iter()
            .find(|s| s.image.as_ref() == Some(&frame.record.image))?;
        Some((series, shot))
    });
    let all = data
        .series
        .iter()
        .flat_map(|s| s.shots.iter().map(move |shot| (s, shot)));
    let all = all.filter(|(_, shot)| shot.image.is_some());
    let chosen: Vec<_> = ranked.take(most).collect();
    let chosen = if chosen.is_empty() {
        all.take(most.min(1)).collect()
    } else {
        chosen
    };
    chosen
        .into_iter()
        .filter_map(|(series, shot)| picture(series, shot))
        .collect()
}

fn read_picture(
    disk: &dyn Disk,
    root: &Path,
    series: &SeriesData,
    shot: &ShotData,
) -> Option<FramePicture> {
    let image = shot
        .image
        .clone()
        .filter(|name| layout::is_frame_name(name))?;
    let path = layout::series_folder(root, &series.flight, &series.name).join(&image);
    let (bytes, fault) = match disk.read(&path) {
        Ok(bytes) => (bytes, None),
        Err(error) => {
            let text = format!(
                "{}: the frame cannot be read ({error}); run `wingd verify`",
                path.display()
            );
            (Vec::new(), Some(text))
        }
    };
    Some(FramePicture {
        series: series.name.clone(),
        image,
        bytes,
        format: shot.format.clone(),
        fault,
    })
}
