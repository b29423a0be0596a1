//! This file reads what a report shows from a store. Damage in one place does not hide the rest: it is noted.

use std::path::Path;

use super::frame_ranking::Ranked;
use super::{MarkerCount, Picture, ReportData, SeriesData, ShotData, Site, Whole, aircraft, summary};
use crate::aircraft::{State as AircraftState, Track};
use crate::installation;
use crate::measure::setup::Setup;
use crate::record::{ImageRecord, Model, Quality};
use crate::store::manifest::{RefusedSeries, ResultLine, Shot, SeriesState};
use crate::store::result_sets::{self, ResultSet};
use crate::store::{
    self, Disk, FlightRef, RealDisk, SeriesRef, StoreError, catalogue, installations, jsonl, layout,
};

/// Which results of a store are meant.
#[derive(Clone, Copy, Debug, Default)]
pub struct Choice<'a> {
    /// A flight's name; its reader says what is meant without one.
    pub flight: Option<&'a str>,
    /// The beginning of the key of the inputs that they were computed from; without one, what
    /// [`sets::Sets::chosen`] says.
    pub inputs: Option<&'a str>,
}

impl<'a> Choice<'a> {
    /// One flight, with the results that stand for it.
    pub fn flight(flight: &'a str) -> Self {
        Self { flight: Some(flight), inputs: None }
    }
}

/// Frames whose records a report keeps whole: 3 MB of its page with 40 markers each.
const FRAMES: usize = 400;
/// Pictures that a report shows where nothing else is asked for; one is some 200 kB of its page.
pub const PICTURES: usize = 4;

/// Reads one flight, the newest with a series where none is named, with [`PICTURES`] frames to be shown. Without a setup
/// ground shape and camera are those of the installation that the store keeps with its results.
///
/// # Errors
/// As [`flight_with`].
pub fn flight(root: &Path, choice: Choice, setup: Option<&Setup>) -> Result<ReportData, StoreError> {
    flight_with(root, choice, setup, PICTURES)
}

/// The same with so many frames to be shown. Of the records those are whole that are to be looked at first: the others
/// have what a list of them shows.
///
/// # Errors
/// Where there is no store, no such flight, or no results of the inputs that are asked for.
pub fn flight_with(
    root: &Path,
    choice: Choice,
    setup: Option<&Setup>,
    pictures: usize,
) -> Result<ReportData, StoreError> {
    let disk = RealDisk;
    catalogue::check_format(&disk, root)?;
    let mut data = ReportData { site: setup.map(Site::from), ..ReportData::default() };
    let mut whole = Ranked::new(FRAMES.max(pictures));
    if let Some(chosen) = choose(&disk, root, choice.flight)? {
        let set = pick(&disk, &chosen, choice, &mut data.warnings)?;
        data.site = data.site.or_else(|| kept(root, set.as_ref()?));
        let track = track(&disk, root, &chosen, &mut data.notes)?;
        data.feed = (!track.is_empty()).then(|| (track.unused, track.len()));
        for series in catalogue::list_series(&disk, &chosen)? {
            let read = read_series(&disk, &series, set.as_ref(), &mut data.notes);
            let joined = read.map(|mut series| {
                aircraft::join(&track, &mut series);
                series
            });
            data.series.extend(joined.map(|series| lean(series, &mut whole)));
        }
    }
    data.notes.extend(refusals(&disk, root));
    data.frames = whole.end();
    data.pictures = shown(&data, pictures, |series, shot| picture(&disk, root, series, shot));
    let said = data.pictures.iter().filter_map(|p| p.fault.clone());
    data.notes.extend(said);
    Ok(data)
}

/// Of the installation that results came from; `None` where the store does not keep it, or this program cannot read it.
fn kept(root: &Path, set: &ResultSet) -> Option<Site> {
    let digest = installations::digest_from_provenance(&set.provenance)?;
    let folder = installations::installation_folder(root, &digest);
    installation::load_without_orientation(&folder).ok().map(|kept| Site::from(&kept.setup))
}

/// Flight of pictures that are in no store.
pub const OF_PICTURES: &str = "pictures";

/// What is shown of pictures that are in no store: their series, with whole records. `picture` gives the bytes of a series'
/// picture by its name.
pub fn pictures(
    series: Vec<SeriesData>,
    setup: &Setup,
    picture: impl Fn(&SeriesData, &ShotData) -> Option<Picture>,
) -> ReportData {
    let mut data = ReportData { site: Some(Site::from(setup)), ..ReportData::default() };
    let mut whole = Ranked::new(FRAMES);
    data.series.extend(series.into_iter().map(|series| lean(series, &mut whole)));
    data.frames = whole.end();
    data.pictures = shown(&data, PICTURES, picture);
    data
}

/// Hands out the series of the chosen flight, or of all flights, one at a time; what could not be read
/// and what is to be said comes back. `take` gets the records whole.
pub fn each<E: From<StoreError>>(
    root: &Path,
    choice: Choice,
    mut take: impl FnMut(SeriesData) -> Result<(), E>,
) -> Result<ReportData, E> {
    let disk = RealDisk;
    let mut said = ReportData::default();
    for flight in chosen(root, choice.flight)? {
        let set = pick(&disk, &flight, choice, &mut said.warnings)?;
        let track = track(&disk, root, &flight, &mut said.notes)?;
        for series in catalogue::list_series(&disk, &flight)? {
            if let Some(mut series) = read_series(&disk, &series, set.as_ref(), &mut said.notes) {
                aircraft::join(&track, &mut series);
                take(series)?;
            }
        }
    }
    Ok(said)
}

fn track(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
    notes: &mut Vec<String>,
) -> Result<Track, StoreError> {
    let (track, said) = aircraft::track(disk, root, flight)?;
    notes.extend(said);
    Ok(track)
}

/// The flight that is named, or all.
pub fn chosen(root: &Path, wanted: Option<&str>) -> Result<Vec<FlightRef>, StoreError> {
    catalogue::check_format(&RealDisk, root)?;
    match wanted {
        Some(_) => Ok(choose(&RealDisk, root, wanted)?.into_iter().collect()),
        None => catalogue::list_flights(&RealDisk, root),
    }
}

/// The results of a flight that are meant; that there are others is said.
fn pick(
    disk: &dyn Disk,
    flight: &FlightRef,
    choice: Choice,
    warnings: &mut Vec<String>,
) -> Result<Option<ResultSet>, StoreError> {
    let sets = result_sets::flight_result_sets(disk, flight)?;
    warnings.extend(sets.mixed_inputs_warning(&flight.id, choice.inputs));
    let found = sets.choose_set(choice.inputs).cloned();
    if let (None, Some(key)) = (&found, choice.inputs) {
        let known: Vec<String> = sets.sets.iter().map(ResultSet::description).collect();
        let why = format!("no results have inputs {key}, there are: {}", known.join(", "));
        return Err(StoreError::NotAStore { path: flight.folder.clone(), why });
    }
    Ok(found)
}

/// A record as a list of records needs it; as it was it goes among the frames.
fn lean(mut series: SeriesData, whole: &mut Ranked) -> SeriesData {
    series.curve = summary::curve_of(&series.records);
    for record in &mut series.records {
        whole.push(Whole { series: series.name.clone(), record: record.clone() });
        series.counts.push(MarkerCount::of(record));
        record.markers.retain(|m| !m.used);
        record.markers.shrink_to_fit();
        record.curve = Vec::new();
        record.model = Model::default();
        record.quality = Quality::default();
    }
    series
}

fn choose(disk: &dyn Disk, root: &Path, wanted: Option<&str>) -> Result<Option<FlightRef>, StoreError> {
    let flights = catalogue::list_flights(disk, root)?;
    if let Some(wanted) = wanted {
        let known: Vec<&str> = flights.iter().map(|f| f.id.as_str()).collect();
        let why = format!("there is no flight {wanted}, only: {}", known.join(", "));
        let missing = || StoreError::NotAStore { path: layout::series_folder(root, wanted, ""), why };
        return flights
            .iter()
            .find(|f| catalogue::is_called(disk, f, wanted))
            .cloned()
            .map(Some)
            .ok_or_else(missing);
    }
    let taken = |f: &&FlightRef| catalogue::list_series(disk, f).is_ok_and(|s| !s.is_empty());
    Ok(flights.iter().rev().find(taken).cloned())
}

/// A series with the results of a set, its records whole; `None` where its manifest cannot be read.
pub fn read_series(
    disk: &dyn Disk,
    series: &SeriesRef,
    set: Option<&ResultSet>,
    notes: &mut Vec<String>,
) -> Option<SeriesData> {
    let manifest = catalogue::read_series_manifest(disk, series).map_err(|e| notes.push(e.to_string())).ok()?;
    let lines = result_sets::results_in_set(disk, series, set).unwrap_or_else(|e| {
        notes.push(e.to_string());
        Vec::new()
    });
    let records = lines.into_iter().filter_map(|line| record(series, line, notes)).collect();
    Some(SeriesData {
        flight: series.flight.clone(),
        name: series.id.clone(),
        begun: manifest.start_time(),
        interrupted: manifest.state == SeriesState::Interrupted,
        planned: manifest.planned_shots as usize,
        curve: Vec::new(),
        counts: Vec::new(),
        inputs: set.map(|set| set.key.clone()),
        records,
        remarks: manifest.remarks,
        shots: manifest.shots.into_iter().map(shot).collect(),
    })
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
    let reason = |f: &store::manifest::ShotFailure| format!("{}: {}", f.kind, f.reason);
    let failures = shot.failures.iter().map(reason).collect();
    let source = shot.frame.as_ref().and_then(|f| f.settings.get("source")?.as_str().map(str::to_owned));
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

fn refusals(disk: &dyn Disk, root: &Path) -> Vec<String> {
    let bytes = disk.read(&root.join(layout::REFUSED_FILE)).unwrap_or_default();
    let lines = jsonl::parse_lines::<RefusedSeries>(&bytes).good;
    let text = |r: RefusedSeries| format!("Series refused at {}: {}", r.stamp.utc, r.reason);
    lines.into_iter().map(|(_, refusal)| text(refusal)).collect()
}

/// The frames that stand first, or the first frame at all.
fn shown(
    data: &ReportData,
    most: usize,
    picture: impl Fn(&SeriesData, &ShotData) -> Option<Picture>,
) -> Vec<Picture> {
    let ranked = data.frames.iter().filter_map(|frame| {
        let series = data.series.iter().find(|s| s.name == frame.series)?;
        let shot = series.shots.iter().find(|s| s.image.as_ref() == Some(&frame.record.image))?;
        Some((series, shot))
    });
    let all = data.series.iter().flat_map(|s| s.shots.iter().map(move |shot| (s, shot)));
    let all = all.filter(|(_, shot)| shot.image.is_some());
    let chosen: Vec<_> = ranked.take(most).collect();
    let chosen = if chosen.is_empty() { all.take(most.min(1)).collect() } else { chosen };
    chosen.into_iter().filter_map(|(series, shot)| picture(series, shot)).collect()
}

fn picture(disk: &dyn Disk, root: &Path, series: &SeriesData, shot: &ShotData) -> Option<Picture> {
    let image = shot.image.clone().filter(|name| layout::is_frame_name(name))?;
    let path = layout::series_folder(root, &series.flight, &series.name).join(&image);
    let (bytes, fault) = match disk.read(&path) {
        Ok(bytes) => (bytes, None),
        Err(error) => {
            let text = format!("{}: the frame cannot be read ({error}); run `wingd verify`", path.display());
            (Vec::new(), Some(text))
        }
    };
    Some(Picture { series: series.name.clone(), image, bytes, format: shot.format.clone(), fault })
}
