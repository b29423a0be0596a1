//! `wingd solve STORE` solves the frames of a store again and adds the results to the existing ones.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value};

use super::{ResultOutput, SolveArgs, job_from_args, report};
use crate::cli::solve::report::ReportFile;
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::print_notes;
use wingd_evaluation::inputs::flight_marks::FlightMarks;
use wingd_evaluation::inputs::stopping::run_long_task;
use wingd_evaluation::inputs::stored_flights;
use wingd_evaluation::inputs::stored_frames;
use wingd_evaluation::inputs::stored_frames::{FlightAircraftData, FlightInputs};
use wingd_evaluation::inputs::{batch, print_flight_prior};
use wingd_evaluation::installation;
use wingd_evaluation::pipeline;
use wingd_evaluation::pipeline::SolveJob;
use wingd_evaluation::record::{ImageRecord, Reason};
use wingd_measure::adjust::AdjustmentMethod;
use wingd_store::{FlightRef, FrameRef, Inputs, Store, result_sets};

pub(super) fn solve_store(
    args: &SolveArgs,
    root: &Path,
    report: Option<ReportFile>,
) -> TaskResult<Completion> {
    // Checked first, because opening would create a missing store.
    let flights = stored_flights::select_flights(root, args.flight.as_deref())?;
    let (store, recovery) = stored_flights::open_store(root)?;
    print_notes(&recovery.remarks);
    let mut output = ResultOutput::new(args, false);
    let solved = flights
        .iter()
        .try_for_each(|flight| solve_flight(args, &store, flight, &mut output));
    store.seal();
    let done = output.finish();
    solved?;
    if let Some(page) = &report {
        report::write_store_report(
            page,
            &store,
            args.flight.as_deref(),
            args.installation.as_deref(),
        )?;
    }
    done
}

fn solve_flight(
    args: &SolveArgs,
    store: &Store,
    flight: &FlightRef,
    output: &mut ResultOutput,
) -> TaskResult<()> {
    let directory =
        stored_flights::flight_installation(args.installation.as_deref(), store.root(), flight)?;
    let installation = installation::load(&directory)?;
    store.keep_installation(&installation.files()?)?;
    print_flight_prior(&installation);
    let orientation = installation.require_orientation()?;
    let job = job_from_args(args);
    let aircraft = match args.no_aircraft_data {
        true => FlightAircraftData::default(),
        false => FlightAircraftData::read(store.disk(), store.root(), flight)?,
    };
    print_notes(&aircraft.notes);
    let marks = match args.no_marks {
        true => FlightMarks::default(),
        false => FlightMarks::read(store.disk(), store.root(), flight, &installation.setup)?,
    };
    print_notes(&marks.notes);
    let jointly = adjusts_jointly(args, store, flight)?;
    let mountings = match jointly {
        true => stored_frames::frame_mountings(store.disk(), flight)?,
        false => BTreeMap::new(),
    };
    let known = FlightInputs {
        installation: &installation,
        orientation,
        aircraft,
        marks,
        mountings,
    };
    let work = FlightSolver {
        args,
        store,
        flight,
        job: &job,
        known,
    };
    if jointly {
        work.solve_jointly(output)
    } else {
        work.solve_frames_singly(output)
    }?;
    print_notes(
        result_sets::flight_result_sets(store.disk(), flight)?
            .mixed_inputs_warning(&flight.id, None),
    );
    Ok(())
}

/// Maximum number of frames of a joint adjustment: its time grows with their third power. 200 take 36 s and
/// 300 MB on one core (21 markers).
const MAX_JOINT_FRAMES: usize = 200;

/// Returns whether the frames of a flight are adjusted jointly, and prints a note if there are too many.
fn adjusts_jointly(args: &SolveArgs, store: &Store, flight: &FlightRef) -> TaskResult<bool> {
    if args.single || !args.is_spatial() {
        return Ok(false);
    }
    let frames = stored_flights::flight_frames(store.disk(), flight, None)?.len();
    if frames > MAX_JOINT_FRAMES {
        eprintln!(
            "wingd: {}: {frames} frames are adjusted one by one; a joint adjustment takes at most {MAX_JOINT_FRAMES}",
            flight.id
        );
    }
    Ok(frames <= MAX_JOINT_FRAMES)
}

struct FlightSolver<'a> {
    args: &'a SolveArgs,
    store: &'a Store,
    flight: &'a FlightRef,
    job: &'a SolveJob,
    known: FlightInputs<'a>,
}

impl FlightSolver<'_> {
    fn solve_frames_singly(&self, output: &mut ResultOutput) -> TaskResult<()> {
        let FlightInputs {
            installation,
            orientation,
            ..
        } = self.known;
        let (inputs, frames) = self.unsolved_frames(self.known.provenance(self.job, None))?;
        let solve = |frame: &FrameRef, bytes: Result<&[u8], Reason>| {
            let processed = self.known.process_frame(frame, bytes);
            (
                frame.clone(),
                pipeline::solve_processed_frame(&processed, installation, orientation, self.job),
            )
        };
        let take = |(frame, record)| self.add_result(&frame, &inputs, record, output);
        batch::for_each_stored_frame(&frames, self.args.jobs, "solving", solve, take)
    }

    /// Solves all frames of the flight together. Each result depends on all frames: their digests are part of its inputs.
    fn solve_jointly(&self, output: &mut ResultOutput) -> TaskResult<()> {
        let FlightInputs {
            installation,
            orientation,
            ..
        } = self.known;
        let frames = stored_flights::flight_frames(self.store.disk(), self.flight, None)?;
        let job = SolveJob {
            method: AdjustmentMethod::Spatial,
            ..self.job.clone()
        };
        let (inputs, left) = self.unsolved_frames(self.known.provenance(&job, Some(&frames)))?;
        if left.is_empty() {
            return Ok(());
        }
        let mut processed = Vec::with_capacity(frames.len());
        let process =
            |frame: &FrameRef, bytes: Result<&[u8], Reason>| self.known.process_frame(frame, bytes);
        let take = batch::collect_into(&mut processed);
        batch::for_each_stored_frame(&frames, self.args.jobs, "measuring", process, take)?;
        let adjust = || pipeline::solve_flight(&processed, installation, orientation, self.job);
        let records = run_long_task("adjusting the frames jointly", adjust);
        let mut pairs = frames
            .iter()
            .zip(records)
            .filter(|(frame, _)| left.contains(frame));
        pairs.try_for_each(|(frame, record)| self.add_result(frame, &inputs, record, output))
    }

    /// Finds the frames without a result from these inputs.
    fn unsolved_frames(
        &self,
        provenance: Map<String, Value>,
    ) -> TaskResult<(Inputs, Vec<FrameRef>)> {
        let inputs = Inputs::new(provenance);
        let frames = self.store.unsolved_in_flight(self.flight, &inputs)?;
        let flight = &self.flight.id;
        match frames.len() {
            0 => eprintln!("wingd: {flight}: every frame already has a result from these inputs"),
            n => eprintln!("wingd: {flight}: {n} frames to solve"),
        }
        Ok((inputs, frames))
    }

    /// Adds a result to the store as the recorder writes it: under the frame's file name.
    fn add_result(
        &self,
        frame: &FrameRef,
        inputs: &Inputs,
        record: ImageRecord,
        output: &mut ResultOutput,
    ) -> TaskResult<()> {
        let written = ImageRecord {
            image: frame.entry.file.clone(),
            ..record.clone()
        };
        let value: Value = serde_json::to_value(&written).map_err(|e| {
            Failure::Failed(format!(
                "{}: result cannot be written as JSON: {e}",
                record.image
            ))
        })?;
        self.store.add_result(frame, inputs, value)?;
        output.take_record(record)
    }
}
