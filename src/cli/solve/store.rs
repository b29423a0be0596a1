//! `wingd solve STORE` solves the frames of a store again and adds the results to the existing ones.

use std::path::Path;

use serde_json::{Map, Value};

use super::marks::FlightMarks;
use super::{ResultOutput, SolveArgs, report, solve_job};
use crate::aircraft::AircraftTrack;
use crate::cli::{Completion, Failure, image_batch, print_flight_prior, store_access, stored_frames};
use crate::installation::{self, Installation};
use crate::measure::setup::Orientation;
use crate::pipeline::{self, ProcessedFrame, SolveJob};
use crate::record::{ImageRecord, Reason};
use crate::store::{self, FlightRef, FrameRef, Inputs, Store, result_sets};

pub(super) fn solve_store(args: &SolveArgs, root: &Path) -> Result<Completion, Failure> {
    // Checked first, because opening would create a missing store.
    let flights = store_access::select_flights(root, args.flight.clone().flatten().as_deref())?;
    let (store, recovery) = store_access::open_store(root)?;
    for remark in &recovery.remarks {
        eprintln!("wingd: {remark}");
    }
    let mut output = ResultOutput::new(args);
    let solved = flights.iter().try_for_each(|flight| solve_flight(args, &store, flight, &mut output));
    store.seal();
    let done = output.finish();
    solved?;
    if let Some(page) = &args.report {
        report::write_store_report(
            page,
            &store,
            args.flight.clone().flatten().as_deref(),
            args.installation.as_deref(),
        )?;
    }
    done
}

/// Loads the installation of the command line, or the kept one that the flight's last results came from.
fn installation_for(args: &SolveArgs, store: &Store, flight: &FlightRef) -> Result<Installation, Failure> {
    let directory = match &args.installation {
        Some(directory) => directory.clone(),
        None => store_access::flight_installation(store.root(), flight)?,
    };
    let installation = installation::load(&directory)?;
    let files = installation.files()?;
    store.keep_installation(&files)?;
    Ok(installation)
}

fn solve_flight(args: &SolveArgs, store: &Store, flight: &FlightRef, output: &mut ResultOutput) -> Result<(), Failure> {
    let installation = installation_for(args, store, flight)?;
    print_flight_prior(&installation);
    let orientation = installation.require_orientation()?;
    let job = solve_job(args);
    let (track, digest) = match args.no_aircraft_data {
        true => (AircraftTrack::default(), None),
        false => stored_frames::read_aircraft_data(store.disk(), store.root(), flight)?,
    };
    let marks = FlightMarks::read(args, store, flight, &installation)?;
    let work =
        FlightSolver { args, store, flight, installation: &installation, orientation, job: &job, track, digest, marks };
    if args.adjusts_jointly() { work.solve_jointly(output) } else { work.solve_frames_singly(output) }?;
    if let Some(warning) = result_sets::flight_result_sets(store.disk(), flight)?.mixed_inputs_warning(&flight.id, None)
    {
        eprintln!("wingd: {warning}");
    }
    Ok(())
}

struct FlightSolver<'a> {
    args: &'a SolveArgs,
    store: &'a Store,
    flight: &'a FlightRef,
    installation: &'a Installation,
    orientation: &'a Orientation,
    job: &'a SolveJob,
    /// Aircraft data, with their digest if there are any.
    track: AircraftTrack,
    digest: Option<String>,
    marks: FlightMarks,
}

impl FlightSolver<'_> {
    fn solve_frames_singly(&self, output: &mut ResultOutput) -> Result<(), Failure> {
        let mut provenance = pipeline::provenance_map(self.installation, self.job);
        self.add_input_digests(&mut provenance);
        let inputs = Inputs::new(provenance);
        let frames = self.store.unsolved_in_flight(self.flight, &inputs)?;
        self.announce_count(frames.len());
        let solve = |frame: &FrameRef, bytes: Result<&[u8], Reason>| {
            let processed = self.process_frame(frame, bytes);
            let record = pipeline::solve_processed_frame(&processed, self.installation, self.orientation, self.job);
            (frame.clone(), record)
        };
        let take = |(frame, record)| self.add_result(&frame, &inputs, record, output);
        image_batch::for_each_stored_frame(self.store, &frames, self.args.jobs, solve, take)
    }

    /// Solves all frames of the flight together. Each result depends on all frames: their digests are part of its inputs.
    fn solve_jointly(&self, output: &mut ResultOutput) -> Result<(), Failure> {
        let frames = store_access::flight_frames(self.store.disk(), self.flight, None)?;
        let job = SolveJob { method: crate::measure::adjust::AdjustmentMethod::Flight, ..self.job.clone() };
        let mut provenance = pipeline::provenance_map(self.installation, &job);
        let digests: String = frames.iter().map(|frame| format!("{}\n", frame.entry.sha256)).collect();
        provenance.insert("frames_together".into(), store::sha256_hex(digests.as_bytes()).into());
        self.add_input_digests(&mut provenance);
        let inputs = Inputs::new(provenance);
        let left = self.store.unsolved_in_flight(self.flight, &inputs)?;
        self.announce_count(left.len());
        if left.is_empty() {
            return Ok(());
        }
        let mut processed_frames = Vec::with_capacity(frames.len());
        let mountings = stored_frames::frame_mountings(self.store.disk(), self.flight)?;
        let process = |frame: &FrameRef, bytes: Result<&[u8], Reason>| {
            let mounting = mountings.get(&frame.entry.sha256).copied();
            ProcessedFrame { mounting, ..self.process_frame(frame, bytes) }
        };
        image_batch::for_each_stored_frame(self.store, &frames, self.args.jobs, process, |processed| {
            processed_frames.push(processed);
            Ok(())
        })?;
        let records = pipeline::solve_flight(&processed_frames, self.installation, self.orientation, self.job);
        let mut pairs = frames.iter().zip(records).filter(|(frame, _)| left.contains(frame));
        pairs.try_for_each(|(frame, record)| self.add_result(frame, &inputs, record, output))
    }

    /// Adds the digests of aircraft data and manual marks to the inputs of a result.
    fn add_input_digests(&self, provenance: &mut Map<String, Value>) {
        let named = [("aircraft_data", &self.digest), ("marks", &self.marks.digest)];
        let there = named.into_iter().filter_map(|(name, digest)| Some((name, digest.clone()?)));
        provenance.extend(there.map(|(name, digest)| (name.to_owned(), digest.into())));
    }

    fn announce_count(&self, count: usize) {
        let flight = &self.flight.id;
        match count {
            0 => eprintln!("wingd: {flight}: every frame already has a result from these inputs"),
            n => eprintln!("wingd: {flight}: {n} frames to solve"),
        }
    }

    fn process_frame(&self, frame: &FrameRef, bytes: Result<&[u8], Reason>) -> ProcessedFrame {
        let mut processed =
            stored_frames::process_stored_frame(frame, bytes, self.installation, self.orientation, &self.track);
        processed.add_manual(self.marks.for_frame(&store_access::frame_name(frame)));
        processed
    }

    /// Adds a result to the store as the recorder writes it: under the frame's file name.
    fn add_result(
        &self,
        frame: &FrameRef,
        inputs: &Inputs,
        record: ImageRecord,
        output: &mut ResultOutput,
    ) -> Result<(), Failure> {
        let written = ImageRecord { image: frame.entry.file.clone(), ..record.clone() };
        let value: Value = serde_json::to_value(&written)
            .map_err(|e| Failure::Failed(format!("{}: result cannot be written as JSON: {e}", record.image)))?;
        self.store.add_result(frame, inputs, value)?;
        output.take_record(record)
    }
}
