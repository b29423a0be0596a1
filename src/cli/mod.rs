//! Each command has a file. Results go to standard output, logs and progress to standard error.

mod aircraft_data;
#[cfg(feature = "boards")]
mod calibrate;
#[cfg(feature = "gphoto")]
mod camera_child;
mod camera_test;
mod check;
mod compare;
mod convert;
mod copy;
mod default_paths;
mod demo;
mod detect;
mod export;
mod fetch;
mod frames;
pub mod help;
mod import;
mod init;
mod learn;
mod logging;
mod manual_observations;
mod mark;
mod mount_check;
#[cfg(any(not(feature = "boards"), not(feature = "upload")))]
mod not_built;
mod orient;
mod pages;
mod pictures;
mod plan;
mod prune;
mod report;
mod run;
mod serve;
mod service;
mod simulate;
mod solve;
mod status;
mod stored;
mod stores;
mod stress;
mod time_check;
#[cfg(feature = "upload")]
mod upload;
mod verify;

use std::ffi::OsString;
use std::path::Path;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::installation::{self, Fault, Installation};
use crate::record::Reason;
use crate::store::{StoreError, layout};
#[cfg(not(feature = "boards"))]
use not_built as calibrate;
#[cfg(not(feature = "upload"))]
use not_built as upload;

/// The shape of a wing in flight, measured with one camera at a cabin window.
#[derive(Parser)]
#[command(name = "wingd", version, propagate_version = true, arg_required_else_help = true)]
#[command(after_help = "Exit status: 0 all went well, 1 something could not be done, 2 wrong usage, \
    78 configuration or installation at fault.")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

// One command exists per run: its size does not matter.
#[allow(clippy::large_enum_variant)]
#[derive(Subcommand)]
enum Command {
    /// Be the camera process of a recorder
    #[cfg(feature = "gphoto")]
    #[command(hide = true)]
    CameraChild,
    /// Pictures by the configured camera, without the recorder
    CameraTest(camera_test::Args),
    /// A bundled flight through the real recorder: store and report
    Demo(demo::Args),
    /// The recorder: series of frames, solved until told to stop
    Run(run::Args),
    /// A configuration, an installation and a board to fill in
    Init(init::Args),
    /// Every fault of configuration, installation, store and camera
    Check(check::Args),
    /// Interior orientation from pictures of a board
    Calibrate(calibrate::Args),
    /// A camera from and to OpenCV, ROS, Kalibr and mrcal
    Convert(convert::Args),
    /// How far the camera moved between frames taken on ground
    MountCheck(mount_check::Args),
    /// The instant of exposure, from pictures of a clock on a screen
    TimeCheck(time_check::Args),
    /// Markers in images
    Detect(detect::Args),
    /// The camera's attitude from ground frames: orientation.toml
    Orient(orient::Args),
    /// Resolution and predicted standard deviations
    Plan(plan::Args),
    /// Pictures of a camera's card into a store
    Import(import::Args),
    /// Markers that a person sees, in a page: kept with who and why
    Mark(mark::Args),
    /// Bending, torsion and positions, one result per image
    Solve(solve::Args),
    /// What flights tell together of all that lasts: flight_prior.json
    Learn(learn::Args),
    /// A flight's figures and tables as one HTML file
    Report(report::Args),
    /// Every checksum and every invariant of a store
    Verify(verify::Args),
    /// What changed between two solves, or between two stores
    Compare(compare::Args),
    /// A store's flights to another disk, resumed and read back
    Copy(copy::Args),
    /// Flights from the page of a recorder or `wingd serve`, read back
    Fetch(fetch::Args),
    /// Flights into an object store (not in the program on board)
    Upload(upload::Args),
    /// Delete flights of which a copy holds every byte
    Prune(prune::Args),
    /// Ask the running recorder how it is
    Status(status::StatusArgs),
    /// Ask the running recorder for an extra series
    Trigger(status::TriggerArgs),
    /// A store's results as CSV, Parquet, VTK or JSON lines
    Export(export::Args),
    /// A table of the aircraft's own data into a flight
    AircraftData(aircraft_data::Args),
    /// Bending moments from the curvature: extremes, cycles, damage
    Stress(stress::Args),
    /// The page of a store: flights, frames, downloads
    Serve(serve::Args),
    /// Frames of a wing, or pictures of a board, with known truth
    Simulate(simulate::Args),
    /// Completions for a shell: bash, zsh, fish, elvish, powershell
    Completions(pages::CompletionsArgs),
    /// Man pages, one for each command, into a directory
    Man(pages::ManArgs),
}

/// How a command ends when it did not end well.
#[derive(Debug)]
pub enum Failure {
    /// Something could not be done; the text says what and how to mend it. Exit status 1.
    Failed(String),
    /// Wrong usage that the parser cannot see. Exit status 2.
    Usage(String),
    /// Configuration or installation at fault. Exit status 78.
    Faults(Vec<Fault>),
    /// The same, where standard output has said it. Exit status 78.
    AlreadyReported,
}

impl From<Vec<Fault>> for Failure {
    fn from(faults: Vec<Fault>) -> Self {
        Self::Faults(faults)
    }
}

impl From<Fault> for Failure {
    fn from(fault: Fault) -> Self {
        Self::Faults(vec![fault])
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::Failed(error.to_string())
    }
}

impl From<Reason> for Failure {
    fn from(reason: Reason) -> Self {
        Self::Failed(reason.to_string())
    }
}

/// Outcome of a command: whether everything asked for was done.
pub enum Done {
    /// Exit status 0.
    All,
    /// Some images failed, each with its own line. Exit status 1.
    Partly,
}

impl Done {
    fn all(ok: bool) -> Self {
        if ok { Self::All } else { Self::Partly }
    }
}

/// Parses the arguments and runs the command; the exit status is that of docs/interface.md.
pub fn main() -> ExitCode {
    let matches = help::dress(Arguments::command()).get_matches_from(joined(std::env::args_os()));
    let arguments = Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let outcome = match arguments.command {
        #[cfg(feature = "gphoto")]
        Command::CameraChild => camera_child::run(),
        Command::CameraTest(args) => camera_test::run(&args),
        Command::Demo(args) => demo::run(&args),
        Command::Run(args) => run::run(&args),
        Command::Check(args) => check::run(&args),
        #[cfg(feature = "boards")]
        Command::Calibrate(args) => calibrate::run(&args),
        #[cfg(not(feature = "boards"))]
        Command::Calibrate(_) => not_built::refused("calibrate, as for the demonstration", "boards"),
        Command::Convert(args) => convert::run(&args),
        Command::MountCheck(args) => mount_check::run(&args),
        Command::TimeCheck(args) => time_check::run(&args),
        Command::Detect(args) => detect::run(&args),
        Command::Orient(args) => orient::run(&args),
        Command::Plan(args) => plan::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Mark(args) => mark::run(&args),
        Command::Solve(args) => solve::run(&args),
        Command::Learn(args) => learn::run(&args),
        Command::Report(args) => report::run(&args),
        Command::Verify(args) => verify::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Copy(args) => copy::run(&args),
        Command::Fetch(args) => fetch::run(&args),
        #[cfg(feature = "upload")]
        Command::Upload(args) => upload::run(&args),
        #[cfg(not(feature = "upload"))]
        Command::Upload(_) => not_built::refused("upload, as for on board", "upload"),
        Command::Prune(args) => prune::run(&args),
        Command::Status(args) => status::status(&args),
        Command::Trigger(args) => status::trigger(&args),
        Command::Export(args) => export::run(&args),
        Command::AircraftData(args) => aircraft_data::run(&args),
        Command::Stress(args) => stress::run(&args),
        Command::Serve(args) => serve::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::Init(args) => init::run(&args),
        Command::Completions(args) => pages::completions(&args),
        Command::Man(args) => pages::man(&args),
    };
    match outcome {
        Ok(Done::All) => ExitCode::SUCCESS,
        Ok(Done::Partly) => ExitCode::from(1),
        Err(failure) => complain(&failure),
    }
}

/// `--flight f0001` as one argument: `--flight` alone stands before images too, and takes no value there.
fn joined(arguments: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut all: Vec<OsString> = Vec::new();
    for argument in arguments {
        let flight = argument.to_str().is_some_and(|text| layout::flight_number(text).is_some());
        match all.last_mut() {
            Some(last) if flight && last == "--flight" => {
                last.push("=");
                last.push(argument);
            }
            _ => all.push(argument),
        }
    }
    all
}

fn complain(failure: &Failure) -> ExitCode {
    match failure {
        Failure::Failed(text) => {
            eprintln!("wingd: {text}");
            ExitCode::from(1)
        }
        Failure::Usage(text) => {
            eprintln!("wingd: {text}\nTry 'wingd --help'.");
            ExitCode::from(2)
        }
        Failure::Faults(faults) => {
            for fault in faults {
                eprintln!("wingd: {fault}");
            }
            let plural = if faults.len() == 1 { "" } else { "s" };
            eprintln!("wingd: {} fault{plural} to mend", faults.len());
            ExitCode::from(78)
        }
        Failure::AlreadyReported => ExitCode::from(78),
    }
}

/// Prints a line of results; a closed pipe (`| head`) is no fault.
///
/// # Errors
/// Where it cannot be written: exit status 1, for a result that is lost is no result.
fn print(text: &str) -> Result<(), Failure> {
    use std::io::{ErrorKind, Write};
    let mut output = std::io::stdout().lock();
    match writeln!(output, "{text}").and_then(|()| output.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Failure::Failed(format!(
            "the results cannot be written to standard output ({error}); free space, or send them elsewhere"
        ))),
        _ => Ok(()),
    }
}

/// A file that could not be written, and what to do about it.
fn unwritable(file: &Path, mend: &str) -> impl Fn(std::io::Error) -> Failure {
    let (file, mend) = (file.display().to_string(), mend.to_owned());
    move |error| Failure::Failed(format!("{file} cannot be written ({error}); {mend}"))
}

/// What mostly helps there.
const RIGHTS: &str = "check rights and space";

/// Says on standard error which surveyed points are to be looked at; that holds nothing up.
fn say_doubts(installation: &Installation) {
    for doubt in installation::doubts(installation) {
        eprintln!("wingd: to be looked at: {doubt}");
    }
}

/// Says on standard error with what earlier flights taught.
fn say_learnt(installation: &Installation) {
    if let Some(learnt) = &installation.learnt {
        eprintln!("wingd: with what {} taught ({})", learnt.counted(), installation::LEARNT_FILE);
    }
}

/// An installation, with a word on its doubtful points.
fn load_installation(directory: &Path) -> Result<Installation, Failure> {
    let installation = installation::load(directory)?;
    say_doubts(&installation);
    Ok(installation)
}

/// Ctrl-C or SIGTERM.
async fn interrupt() {
    use tokio::signal::unix::{SignalKind, signal};
    match signal(SignalKind::terminate()) {
        Ok(mut terminate) => tokio::select! {
            _ = tokio::signal::ctrl_c() => {}
            _ = terminate.recv() => {}
        },
        Err(_) => {
            let _ = tokio::signal::ctrl_c().await;
        }
    }
}
