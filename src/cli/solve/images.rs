//! Here frames of the command line are solved, or points measured by hand.

use super::{Args, Output, job};
use crate::cli::{Done, Failure, frames, load_installation};
use crate::installation::{self, Fault, Installation, Mountings};
use crate::measure::setup::Orientation;
use crate::pipeline::{self, Job, Sighting, stages};
use crate::record::Reason;

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let Some(directory) = &args.installation else {
        return Err(Failure::Usage("name the installation: --installation DIR".into()));
    };
    let mountings = mountings(args)?;
    let installation = load_installation(directory)?;
    let orientation = installation.require_orientation()?;
    let job = job(args);
    let mut output = Output::new(args);
    let outcome = match &args.observations {
        Some(file) => {
            let observations = installation::read_observations(file, &installation.setup)?;
            let sighting = Sighting::by_hand(&frames::name(file), &observations);
            output.take(pipeline::solve_sighting(&sighting, &installation, orientation, &job))
        }
        None => solve_images(
            args,
            &Known { installation: &installation, orientation, mountings },
            &job,
            &mut output,
        ),
    };
    // What is done is kept, also where the rest is given up.
    let done = output.end();
    outcome.and(done)
}

/// What is known before a frame is seen.
struct Known<'a> {
    installation: &'a Installation,
    orientation: &'a Orientation,
    mountings: Option<Mountings>,
}

fn solve_images(args: &Args, known: &Known, job: &Job, output: &mut Output) -> Result<(), Failure> {
    let Known { installation, orientation, mountings } = known;
    let sight = |name: &str, bytes: Result<&[u8], Reason>| {
        let sighting = match bytes {
            Ok(bytes) => stages::sight(name, bytes, None, installation, Some(*orientation)),
            Err(reason) => Sighting::failed(name, reason),
        };
        Sighting { mounting: mountings.as_ref().and_then(|m| m.of(name)), ..sighting }
    };
    if args.together() {
        let sightings = frames::map(&args.images, args.jobs, "measuring", sight)?;
        let records = pipeline::solve_flight(&sightings, installation, orientation, job);
        return records.into_iter().try_for_each(|record| output.take(record));
    }
    let solve = |name: &str, bytes: Result<&[u8], Reason>| {
        pipeline::solve_sighting(&sight(name, bytes), installation, orientation, job)
    };
    frames::each(&args.images, args.jobs, "solving", solve, |record| output.take(record))
}

/// The mountings as the user knows them, of every frame.
fn mountings(args: &Args) -> Result<Option<Mountings>, Failure> {
    let Some(file) = &args.mountings else { return Ok(None) };
    let read = installation::read_mountings(file)?;
    let names = frames::names(&args.images);
    let missing: Vec<&str> = names.iter().map(String::as_str).filter(|n| read.of(n).is_none()).collect();
    let Some(first) = missing.first() else { return Ok(Some(read)) };
    let problem = match missing.len() {
        1 => format!("says nothing of {first}, or names two files like it"),
        n => format!("says nothing of {first} and {} more frames, or names several files like them", n - 1),
    };
    let mend = "give a line for every frame, with as much of its path as tells it from the others".into();
    Err(Fault { file: file.clone(), place: "column image".into(), problem, mend }.into())
}
