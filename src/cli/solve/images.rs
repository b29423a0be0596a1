//! Solution of image files, or of manually measured points.

use std::path::PathBuf;

use super::{ResultOutput, SolveArgs, job_from_args, report};
use crate::cli::solve::report::ReportFile;
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::fault::Fault;
use wingd_base::output::print_notes;
use wingd_evaluation::inputs::default_paths::{load_installation, resolve_installation};
use wingd_evaluation::inputs::image_names::{image_name, image_names};
use wingd_evaluation::inputs::manual_points::ManualPoints;
use wingd_evaluation::inputs::stopping::run_long_task;
use wingd_evaluation::inputs::{batch, print_flight_prior};
use wingd_evaluation::installation;
use wingd_evaluation::installation::{Installation, Mountings};
use wingd_evaluation::pipeline;
use wingd_evaluation::pipeline::{ProcessedFrame, SolveJob, stages};
use wingd_evaluation::record::Reason;
use wingd_measure::setup::Orientation;

pub(super) fn solve_images(args: &SolveArgs, report: Option<ReportFile>) -> TaskResult<Completion> {
    let directory = resolve_installation(args.installation.as_deref())?;
    if args.images.is_empty() && (args.joint || args.mountings.is_some() || args.report.is_some()) {
        let what = "--joint, --mountings and --report need images in addition to --observations";
        return Err(Failure::Usage(what.into()));
    }
    let files = batch::expand_folders(&args.images)?;
    let mountings = read_mountings(args, &files)?;
    let installation = load_installation(&directory)?;
    print_flight_prior(&installation);
    let orientation = installation.require_orientation()?;
    let job = job_from_args(args);
    let mut output = ResultOutput::new(args, args.report.is_some());
    let manual = args
        .observations
        .as_ref()
        .map(|file| ManualPoints::read(file, &files, &installation.setup));
    let manual = manual.transpose()?.unwrap_or_default();
    print_notes(&manual.note);
    let known = SolveInputs {
        installation: &installation,
        orientation,
        mountings,
        manual,
    };
    let outcome = match &args.observations {
        Some(file) if files.is_empty() => {
            let processed = ProcessedFrame::from_manual(&image_name(file), known.manual.iter());
            output.take_record(pipeline::solve_processed_frame(
                &processed,
                &installation,
                orientation,
                &job,
            ))
        }
        _ => solve_files(args, &files, &known, &job, &mut output),
    };
    let kept = output.kept.take();
    // Finished results are kept even if the others fail.
    let done = output.finish();
    outcome?;
    if let (Some(page), Some(records)) = (report, kept) {
        report::write_image_report(&page, &files, records, &installation)?;
    }
    done
}

/// Inputs common to all frames.
struct SolveInputs<'a> {
    installation: &'a Installation,
    orientation: &'a Orientation,
    mountings: Option<Mountings>,
    manual: ManualPoints,
}

fn solve_files(
    args: &SolveArgs,
    files: &[PathBuf],
    known: &SolveInputs,
    job: &SolveJob,
    output: &mut ResultOutput,
) -> TaskResult<()> {
    let SolveInputs {
        installation,
        orientation,
        mountings,
        manual,
    } = known;
    let process = |name: &str, bytes: Result<&[u8], Reason>| {
        let processed = match bytes {
            Ok(bytes) if args.observations_only => {
                ProcessedFrame::without_detection(name, bytes, manual.for_image(name))
            }
            Ok(bytes) => {
                let mut processed = stages::process_frame(
                    name,
                    bytes,
                    None,
                    &installation.setup,
                    Some(*orientation),
                );
                processed.add_manual(manual.for_image(name));
                processed
            }
            Err(reason) => ProcessedFrame::failed(name, reason),
        };
        ProcessedFrame {
            mounting: mountings.as_ref().and_then(|m| m.find(name)),
            ..processed
        }
    };
    if args.joint {
        let mut processed_frames = Vec::with_capacity(files.len());
        batch::for_each_image(
            files,
            args.jobs,
            "measuring",
            process,
            batch::collect_into(&mut processed_frames),
        )?;
        let adjust = || pipeline::solve_flight(&processed_frames, installation, orientation, job);
        let records = run_long_task("adjusting the frames jointly", adjust);
        return records
            .into_iter()
            .try_for_each(|record| output.take_record(record));
    }
    let solve = |name: &str, bytes: Result<&[u8], Reason>| {
        pipeline::solve_processed_frame(&process(name, bytes), installation, orientation, job)
    };
    batch::for_each_image(files, args.jobs, "solving", solve, |record| {
        output.take_record(record)
    })
}

/// Reads the mountings given by the user; each frame must have one.
fn read_mountings(args: &SolveArgs, files: &[PathBuf]) -> TaskResult<Option<Mountings>> {
    let Some(file) = &args.mountings else {
        return Ok(None);
    };
    let read = installation::read_mountings(file)?;
    let names = image_names(files);
    let missing: Vec<&str> = names
        .iter()
        .map(String::as_str)
        .filter(|n| read.find(n).is_none())
        .collect();
    let Some(first) = missing.first() else {
        return Ok(Some(read));
    };
    let problem = match missing.len() {
        1 => format!("has no line for {first}, or it matches two files"),
        n => format!(
            "has no line for {first} and {} other frames, or they match several files",
            n - 1
        ),
    };
    let remedy = "give a line for every frame, with enough of its path to be unique";
    Err(Fault::new(file, "column image", problem, remedy).into())
}
