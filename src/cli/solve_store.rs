//! `wingd solve STORE`: the frames of a store solved again, results beside the old ones.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::{Map, Value};

use super::solve::{Args, Output, job};
use super::{Done, Failure, frames};
use crate::aircraft::Track;
use crate::camera::Format;
use crate::installation::{self, Installation};
use crate::measure::adjust::Mounting;
use crate::measure::setup::Orientation;
use crate::pipeline::{self, Job, Sighting, stages};
use crate::record::ImageRecord;
use crate::report::aircraft;
use crate::store::{
    self, Disk, FlightRef, FrameRef, Inputs, RealDisk, Store, StoreConfig, StoreError, catalogue,
    installations, sets,
};

/// Kind of a shot's failure where the camera was unplugged or its power cut.
const GONE: &str = "gone";

fn undone(error: StoreError) -> Failure {
    Failure::Undone(error.to_string())
}

/// The flights of a store that a command is about: the one that is named, or all.
pub(super) fn flights(disk: &dyn Disk, root: &Path, wanted: Option<&str>) -> Result<Vec<FlightRef>, Failure> {
    catalogue::check_format(disk, root).map_err(undone)?;
    let all = catalogue::flights(disk, root).map_err(undone)?;
    let Some(wanted) = wanted else { return Ok(all) };
    let known: Vec<&str> = all.iter().map(|flight| flight.id.as_str()).collect();
    let known = known.join(", ");
    let found: Vec<FlightRef> = all.iter().filter(|flight| flight.id == wanted).cloned().collect();
    if found.is_empty() {
        let root = root.display();
        return Err(Failure::Undone(format!("{root}: there is no flight {wanted}, only: {known}")));
    }
    Ok(found)
}

pub(super) fn run(args: &Args, root: &Path) -> Result<Done, Failure> {
    // Opening would make a store where there is none.
    let flights = flights(&RealDisk, root, args.flight.clone().flatten().as_deref())?;
    let config = StoreConfig { reserve_mb: 0, ..StoreConfig::at(root) };
    let (store, recovery) = Store::open(Arc::new(RealDisk), config).map_err(undone)?;
    for remark in &recovery.remarks {
        eprintln!("wingd: {remark}");
    }
    let mut output = Output::new(args);
    let solved = flights.iter().try_for_each(|flight| solve_flight(args, &store, flight, &mut output));
    store.seal();
    let done = output.end();
    solved.and(done)
}

/// The installation of the command line, or the last one kept that the flight's results came from.
fn installation_for(args: &Args, store: &Store, flight: &FlightRef) -> Result<Installation, Failure> {
    let directory = match &args.installation {
        Some(directory) => directory.clone(),
        None => kept(store, flight)?,
    };
    let installation = installation::load(&directory)?;
    let files = installation.files()?;
    store.keep_installation(&files).map_err(undone)?;
    Ok(installation)
}

fn kept(store: &Store, flight: &FlightRef) -> Result<PathBuf, Failure> {
    let known = installations::of_flight(store.disk(), flight).map_err(undone)?;
    let last = known.last().map(|digest| installations::folder(store.root(), digest));
    last.ok_or_else(|| {
        let (root, flight) = (store.root().display(), &flight.id);
        Failure::Undone(format!("{root}: no installation is kept for {flight}; name one with --installation"))
    })
}

fn solve_flight(args: &Args, store: &Store, flight: &FlightRef, output: &mut Output) -> Result<(), Failure> {
    let installation = installation_for(args, store, flight)?;
    let orientation = installation.require_orientation()?;
    let job = job(args);
    let (track, digest) = aircraft_data(args, store, flight)?;
    let work =
        Work { args, store, flight, installation: &installation, orientation, job: &job, track, digest };
    if args.together() { work.together(output) } else { work.one_by_one(output) }?;
    if let Some(warning) = sets::of_flight(store.disk(), flight).map_err(undone)?.warning(&flight.id, None) {
        eprintln!("wingd: {warning}");
    }
    Ok(())
}

struct Work<'a> {
    args: &'a Args,
    store: &'a Store,
    flight: &'a FlightRef,
    installation: &'a Installation,
    orientation: &'a Orientation,
    job: &'a Job,
    /// The aircraft's data, and their digest where there are any.
    track: Track,
    digest: Option<String>,
}

/// The aircraft's data of a flight, where they are wanted.
fn aircraft_data(args: &Args, store: &Store, flight: &FlightRef) -> Result<(Track, Option<String>), Failure> {
    if args.no_aircraft_data {
        return Ok((Track::default(), None));
    }
    let (track, notes) = aircraft::track(store.disk(), store.root(), flight).map_err(undone)?;
    for note in notes {
        eprintln!("wingd: {note}");
    }
    if track.is_empty() {
        return Ok((track, None));
    }
    let digest = store::aircraft::digest(store.disk(), store.root(), flight).map_err(undone)?;
    eprintln!("wingd: {}: air and wing's temperature from {} aircraft samples", flight.id, track.len());
    Ok((track, digest))
}

impl Work<'_> {
    fn one_by_one(&self, output: &mut Output) -> Result<(), Failure> {
        let mut provenance = pipeline::inputs(self.installation, self.job);
        self.name_aircraft(&mut provenance);
        let inputs = Inputs::new(provenance);
        let frames = self.store.unsolved_of(self.flight, &inputs).map_err(undone)?;
        self.announce(frames.len());
        let solve = |frame: &FrameRef, bytes: Result<&[u8], String>| {
            let sighting = self.sight(frame, bytes);
            let record = pipeline::solve_sighting(&sighting, self.installation, self.orientation, self.job);
            (frame.clone(), record)
        };
        let take = |(frame, record)| self.add(&frame, &inputs, record, output);
        frames::stored(self.store, &frames, self.args.jobs, solve, take)
    }

    /// A result follows from all the frames: their digests are among its inputs.
    fn together(&self, output: &mut Output) -> Result<(), Failure> {
        let frames = frames(self.store.disk(), self.flight, None).map_err(undone)?;
        let job = Job { method: crate::measure::adjust::Method::Flight, ..self.job.clone() };
        let mut provenance = pipeline::inputs(self.installation, &job);
        let digests: String = frames.iter().map(|frame| format!("{}\n", frame.entry.sha256)).collect();
        provenance.insert("frames_together".into(), store::sha256(digests.as_bytes()).into());
        self.name_aircraft(&mut provenance);
        let inputs = Inputs::new(provenance);
        let left = self.store.unsolved_of(self.flight, &inputs).map_err(undone)?;
        self.announce(left.len());
        if left.is_empty() {
            return Ok(());
        }
        let mut sightings = Vec::with_capacity(frames.len());
        let mountings = mountings(self.store.disk(), self.flight).map_err(undone)?;
        let sight = |frame: &FrameRef, bytes: Result<&[u8], String>| {
            let mounting = mountings.get(&frame.entry.sha256).copied();
            Sighting { mounting, ..self.sight(frame, bytes) }
        };
        frames::stored(self.store, &frames, self.args.jobs, sight, |sighting| {
            sightings.push(sighting);
            Ok(())
        })?;
        let records = pipeline::solve_flight(&sightings, self.installation, self.orientation, self.job);
        let mut pairs = frames.iter().zip(records).filter(|(frame, _)| left.contains(frame));
        pairs.try_for_each(|(frame, record)| self.add(frame, &inputs, record, output))
    }

    /// A result follows from the aircraft's data too.
    fn name_aircraft(&self, provenance: &mut Map<String, Value>) {
        provenance
            .extend(self.digest.iter().map(|digest| ("aircraft_data".to_owned(), digest.clone().into())));
    }

    fn announce(&self, count: usize) {
        let flight = &self.flight.id;
        match count {
            0 => eprintln!("wingd: {flight}: every frame has a result of these inputs already"),
            n => eprintln!("wingd: {flight}: {n} frames to solve"),
        }
    }

    fn sight(&self, frame: &FrameRef, bytes: Result<&[u8], String>) -> Sighting {
        let name = format!("{}/{}", frame.series.id, frame.entry.file);
        let sighting = match (bytes, Format::of_manifest(&frame.entry.format)) {
            (Ok(bytes), Ok(format)) => {
                stages::sight(&name, bytes, Some(&format), self.installation, Some(self.orientation))
            }
            (Err(reason), _) | (_, Err(reason)) => failed(name, reason),
        };
        let aircraft = self.track.at(&frame.stamp, frame.exposure.as_ref());
        Sighting { aircraft, ..sighting }
    }

    /// As the recorder writes it: under the frame's own name.
    fn add(
        &self,
        frame: &FrameRef,
        inputs: &Inputs,
        record: ImageRecord,
        output: &mut Output,
    ) -> Result<(), Failure> {
        let written = ImageRecord { image: frame.entry.file.clone(), ..record.clone() };
        let value: Value = serde_json::to_value(&written).map_err(|e| {
            Failure::Undone(format!("{}: result cannot be written as JSON: {e}", record.image))
        })?;
        self.store.add_result(frame, inputs, value).map_err(undone)?;
        output.take(record)
    }
}

fn failed(image: String, reason: String) -> Sighting {
    Sighting { image, failure: Some(reason), ..Sighting::default() }
}

/// Mounting of each frame by its digest: another one after a boot and from where the camera was gone, for nothing tells
/// that it was not taken down then. The recorder opens it anew before each series by itself, which says nothing.
fn mountings(disk: &dyn Disk, flight: &FlightRef) -> Result<BTreeMap<String, Mounting>, StoreError> {
    let mut all = BTreeMap::new();
    let (mut number, mut boot): (usize, Option<String>) = (0, None);
    for series in catalogue::series(disk, flight)? {
        for shot in catalogue::manifest(disk, &series)?.shots {
            let gone = shot.failures.iter().any(|failure| failure.kind == GONE);
            let booted = boot.replace(shot.stamp.boot_id.clone()).is_some_and(|b| b != shot.stamp.boot_id);
            number += usize::from(gone || booted);
            all.extend(shot.frame.map(|frame| (frame.sha256, Mounting::Numbered(number))));
        }
    }
    Ok(all)
}

/// A flight's frames in order: of the series that is named, or of all.
pub(super) fn frames(
    disk: &dyn Disk,
    flight: &FlightRef,
    wanted: Option<&str>,
) -> Result<Vec<FrameRef>, StoreError> {
    let mut frames = Vec::new();
    let is_wanted = |id: &str| wanted.is_none_or(|wanted| wanted == id);
    for series in catalogue::series(disk, flight)?.into_iter().filter(|series| is_wanted(&series.id)) {
        frames.extend(store::frames(&series, catalogue::manifest(disk, &series)?));
    }
    Ok(frames)
}
