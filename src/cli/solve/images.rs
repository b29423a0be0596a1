//! Here frames of the command line are solved, or points measured by hand.

use std::path::PathBuf;

use super::{Args, Output, job, report};
use crate::cli::manual_observations::ByHand;
use crate::cli::{Done, Failure, default_paths, frames, load_installation, pictures, say_learnt};
use crate::installation::{self, Fault, Installation, Mountings};
use crate::measure::setup::Orientation;
use crate::pipeline::{self, Job, ProcessedFrame, stages};
use crate::record::Reason;

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let directory = default_paths::installation(args.installation.as_deref())?;
    if args.images.is_empty() && (args.together() || args.mountings.is_some() || args.report.is_some()) {
        let what = "--flight, --mountings and --report need images beside --observations";
        return Err(Failure::Usage(what.into()));
    }
    let files = pictures::expand(&args.images)?;
    let mountings = mountings(args, &files)?;
    let installation = load_installation(&directory)?;
    say_learnt(&installation);
    let orientation = installation.require_orientation()?;
    let job = job(args);
    let mut output = Output::keeping(args);
    let manual = args.observations.as_ref().map(|file| ByHand::read(file, &files, &installation.setup));
    let manual = manual.transpose()?.unwrap_or_default();
    let known = Known { installation: &installation, orientation, mountings, manual };
    let outcome = match &args.observations {
        Some(file) if files.is_empty() => {
            let sighting = ProcessedFrame::manual(&frames::name(file), known.manual.all());
            output.take(pipeline::solve_sighting(&sighting, &installation, orientation, &job))
        }
        _ => solve_images(args, &files, &known, &job, &mut output),
    };
    let kept = output.kept.take();
    // What is done is kept, also where the rest is given up.
    let done = output.end();
    outcome?;
    if let (Some(page), Some(records)) = (&args.report, kept) {
        report::of_pictures(page, &files, records, &installation)?;
    }
    done
}

/// What is known before a frame is seen.
struct Known<'a> {
    installation: &'a Installation,
    orientation: &'a Orientation,
    mountings: Option<Mountings>,
    manual: ByHand,
}

fn solve_images(
    args: &Args,
    files: &[PathBuf],
    known: &Known,
    job: &Job,
    output: &mut Output,
) -> Result<(), Failure> {
    let Known { installation, orientation, mountings, manual } = known;
    let sight = |name: &str, bytes: Result<&[u8], Reason>| {
        let sighting = match bytes {
            Ok(bytes) if args.observations_only => ProcessedFrame::only_manual(name, bytes, manual.of(name)),
            Ok(bytes) => {
                let mut sighting = stages::process_frame(name, bytes, None, installation, Some(*orientation));
                sighting.add_manual(manual.of(name));
                sighting
            }
            Err(reason) => ProcessedFrame::failed(name, reason),
        };
        ProcessedFrame { mounting: mountings.as_ref().and_then(|m| m.of(name)), ..sighting }
    };
    if args.together() {
        let sightings = frames::map(files, args.jobs, "measuring", sight)?;
        let records = pipeline::solve_flight(&sightings, installation, orientation, job);
        return records.into_iter().try_for_each(|record| output.take(record));
    }
    let solve = |name: &str, bytes: Result<&[u8], Reason>| {
        pipeline::solve_sighting(&sight(name, bytes), installation, orientation, job)
    };
    frames::each(files, args.jobs, "solving", solve, |record| output.take(record))
}

/// The mountings as the user knows them, of every frame.
fn mountings(args: &Args, files: &[PathBuf]) -> Result<Option<Mountings>, Failure> {
    let Some(file) = &args.mountings else { return Ok(None) };
    let read = installation::read_mountings(file)?;
    let names = frames::names(files);
    let missing: Vec<&str> = names.iter().map(String::as_str).filter(|n| read.of(n).is_none()).collect();
    let Some(first) = missing.first() else { return Ok(Some(read)) };
    let problem = match missing.len() {
        1 => format!("says nothing of {first}, or names two files like it"),
        n => format!("says nothing of {first} and {} more frames, or names several files like them", n - 1),
    };
    let mend = "give a line for every frame, with as much of its path as tells it from the others".into();
    Err(Fault { file: file.clone(), place: "column image".into(), problem, remedy: mend }.into())
}
