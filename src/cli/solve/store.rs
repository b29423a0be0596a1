//! `wingd solve STORE` solves the frames of a store again, results beside the old ones.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value};

use super::marks::Marks;
use super::{Args, Output, job, report};
use crate::aircraft::Track;
use crate::camera::Format;
use crate::cli::{Done, Failure, frames, stores};
use crate::installation::{self, Installation};
use crate::measure::adjust::Mounting;
use crate::measure::setup::Orientation;
use crate::pipeline::{self, Job, Sighting, stages};
use crate::record::{ImageRecord, Reason};
use crate::report::aircraft;
use crate::store::manifest::Cause;
use crate::store::{self, Disk, FlightRef, FrameRef, Inputs, Store, StoreError, catalogue, sets};

/// Kind of a shot's failure where the camera was unplugged or its power cut.
const GONE: &str = "gone";

pub(super) fn run(args: &Args, root: &Path) -> Result<Done, Failure> {
    // Opening would make a store where there is none.
    let flights = stores::flights(root, args.flight.clone().flatten().as_deref())?;
    let (store, recovery) = stores::open(root)?;
    for remark in &recovery.remarks {
        eprintln!("wingd: {remark}");
    }
    let mut output = Output::new(args);
    let solved = flights.iter().try_for_each(|flight| solve_flight(args, &store, flight, &mut output));
    store.seal();
    let done = output.end();
    solved?;
    if let Some(page) = &args.report {
        report::of_store(
            page,
            &store,
            args.flight.clone().flatten().as_deref(),
            args.installation.as_deref(),
        )?;
    }
    done
}

/// The installation of the command line, or the last one kept that the flight's results came from.
fn installation_for(args: &Args, store: &Store, flight: &FlightRef) -> Result<Installation, Failure> {
    let directory = match &args.installation {
        Some(directory) => directory.clone(),
        None => stores::installation_of(store.root(), flight)?,
    };
    let installation = installation::load(&directory)?;
    let files = installation.files()?;
    store.keep_installation(&files)?;
    Ok(installation)
}

fn solve_flight(args: &Args, store: &Store, flight: &FlightRef, output: &mut Output) -> Result<(), Failure> {
    let installation = installation_for(args, store, flight)?;
    let orientation = installation.require_orientation()?;
    let job = job(args);
    let (track, digest) = aircraft_data(args, store, flight)?;
    let marks = Marks::read(args, store, flight, &installation)?;
    let work = Work {
        args,
        store,
        flight,
        installation: &installation,
        orientation,
        job: &job,
        track,
        digest,
        marks,
    };
    if args.together() { work.together(output) } else { work.one_by_one(output) }?;
    if let Some(warning) = sets::of_flight(store.disk(), flight)?.warning(&flight.id, None) {
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
    marks: Marks,
}

/// The aircraft's data of a flight, where they are wanted.
fn aircraft_data(args: &Args, store: &Store, flight: &FlightRef) -> Result<(Track, Option<String>), Failure> {
    if args.no_aircraft_data {
        return Ok((Track::default(), None));
    }
    let (track, notes) = aircraft::track(store.disk(), store.root(), flight)?;
    for note in notes {
        eprintln!("wingd: {note}");
    }
    if track.is_empty() {
        return Ok((track, None));
    }
    let digest = store::aircraft::digest(store.disk(), store.root(), flight)?;
    eprintln!("wingd: {}: air and wing's temperature from {} aircraft samples", flight.id, track.len());
    Ok((track, digest))
}

impl Work<'_> {
    fn one_by_one(&self, output: &mut Output) -> Result<(), Failure> {
        let mut provenance = pipeline::inputs(self.installation, self.job);
        self.name_beside(&mut provenance);
        let inputs = Inputs::new(provenance);
        let frames = self.store.unsolved_of(self.flight, &inputs)?;
        self.announce(frames.len());
        let solve = |frame: &FrameRef, bytes: Result<&[u8], Reason>| {
            let sighting = self.sight(frame, bytes);
            let record = pipeline::solve_sighting(&sighting, self.installation, self.orientation, self.job);
            (frame.clone(), record)
        };
        let take = |(frame, record)| self.add(&frame, &inputs, record, output);
        frames::stored(self.store, &frames, self.args.jobs, solve, take)
    }

    /// A result follows from all the frames: their digests are among its inputs.
    fn together(&self, output: &mut Output) -> Result<(), Failure> {
        let frames = stores::frames(self.store.disk(), self.flight, None)?;
        let job = Job { method: crate::measure::adjust::Method::Flight, ..self.job.clone() };
        let mut provenance = pipeline::inputs(self.installation, &job);
        let digests: String = frames.iter().map(|frame| format!("{}\n", frame.entry.sha256)).collect();
        provenance.insert("frames_together".into(), store::sha256(digests.as_bytes()).into());
        self.name_beside(&mut provenance);
        let inputs = Inputs::new(provenance);
        let left = self.store.unsolved_of(self.flight, &inputs)?;
        self.announce(left.len());
        if left.is_empty() {
            return Ok(());
        }
        let mut sightings = Vec::with_capacity(frames.len());
        let mountings = mountings(self.store.disk(), self.flight)?;
        let sight = |frame: &FrameRef, bytes: Result<&[u8], Reason>| {
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

    /// A result follows from the aircraft's data and from what people marked, too.
    fn name_beside(&self, provenance: &mut Map<String, Value>) {
        let named = [("aircraft_data", &self.digest), ("marks", &self.marks.digest)];
        let there = named.into_iter().filter_map(|(name, digest)| Some((name, digest.clone()?)));
        provenance.extend(there.map(|(name, digest)| (name.to_owned(), digest.into())));
    }

    fn announce(&self, count: usize) {
        let flight = &self.flight.id;
        match count {
            0 => eprintln!("wingd: {flight}: every frame has a result of these inputs already"),
            n => eprintln!("wingd: {flight}: {n} frames to solve"),
        }
    }

    fn sight(&self, frame: &FrameRef, bytes: Result<&[u8], Reason>) -> Sighting {
        let name = stores::name_of(frame);
        let mut sighting = match (bytes, Format::of_manifest(&frame.entry.format)) {
            (Ok(bytes), Ok(format)) => {
                stages::sight(&name, bytes, Some(&format), self.installation, Some(self.orientation))
            }
            (Err(reason), _) => Sighting::failed(name, reason),
            (_, Err(unknown)) => Sighting::failed(name, Reason::of(unknown)),
        };
        sighting.add_by_hand(self.marks.of(&stores::name_of(frame)));
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
        self.store.add_result(frame, inputs, value)?;
        output.take(record)
    }
}

/// Mounting of each frame by its digest: another one after a boot and from where the camera was gone, for nothing tells
/// that it was not taken down then. The recorder opens it anew before each series by itself, which says nothing. Of
/// imported pictures nothing is known: none of them stands here.
fn mountings(disk: &dyn Disk, flight: &FlightRef) -> Result<BTreeMap<String, Mounting>, StoreError> {
    let mut all = BTreeMap::new();
    let (mut number, mut boot): (usize, Option<String>) = (0, None);
    for series in catalogue::series(disk, flight)? {
        let manifest = catalogue::manifest(disk, &series)?;
        let shots = manifest.shots.into_iter().filter(|_| manifest.cause != Cause::Imported);
        for shot in shots {
            let gone = shot.failures.iter().any(|failure| failure.kind == GONE);
            let booted = boot.replace(shot.stamp.boot_id.clone()).is_some_and(|b| b != shot.stamp.boot_id);
            number += usize::from(gone || booted);
            all.extend(shot.frame.map(|frame| (frame.sha256, Mounting::Numbered(number))));
        }
    }
    Ok(all)
}
