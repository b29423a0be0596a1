//! Command line: one file per command. Results go to standard output, logs and progress to standard error.

/// Prints a line to standard error. It replaces the macro of the standard library in all commands: no name from a file or a
/// server may control the terminal.
macro_rules! eprintln {
    ($($text:tt)*) => {
        std::eprintln!("{}", $crate::installation::printable_text(&format!($($text)*)))
    };
}

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
pub mod help;
mod image_batch;
mod image_files;
mod import;
mod init;
mod learn;
mod logging;
mod manual_observations;
mod mark;
mod mount_check;
mod orient;
mod pages;
mod plan;
mod prune;
mod recorder;
mod report;
mod run;
mod serve;
mod simulate;
mod solve;
mod status;
mod store_access;
mod stored_frames;
mod stress;
mod time_check;
#[cfg(any(not(feature = "boards"), not(feature = "upload")))]
mod unavailable;
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
#[cfg(feature = "boards")]
use calibrate::CalibrateArgs;
#[cfg(not(feature = "boards"))]
use unavailable::UnavailableArgs as CalibrateArgs;
#[cfg(not(feature = "upload"))]
use unavailable::UnavailableArgs as UploadArgs;
#[cfg(feature = "upload")]
use upload::UploadArgs;

/// Measure the shape of a wing in flight with one camera at a cabin window.
#[derive(Parser)]
#[command(name = "wingd", version, propagate_version = true, arg_required_else_help = true)]
#[command(after_help = "Exit status: 0 success, 1 failure or partial success, 2 wrong usage, \
    78 errors in configuration or installation.")]
struct Arguments {
    #[command(subcommand)]
    command: CliCommand,
}

// Only one value exists per run: its size does not matter.
#[allow(clippy::large_enum_variant)]
#[derive(Subcommand)]
enum CliCommand {
    /// Run the camera process of a recorder
    #[cfg(feature = "gphoto")]
    #[command(hide = true)]
    CameraChild,
    /// Take shots with the configured camera, without the recorder
    CameraTest(camera_test::CameraTestArgs),
    /// Run a bundled flight through the real recorder
    Demo(demo::DemoArgs),
    /// Run the recorder: take series of frames and solve them
    Run(run::RunArgs),
    /// Write a configuration, an installation and a board to fill in
    Init(init::InitArgs),
    /// Check configuration, installation, store and camera
    Check(check::CheckArgs),
    /// Estimate the interior orientation from images of a board
    Calibrate(CalibrateArgs),
    /// Convert a camera from or to OpenCV, ROS, Kalibr and mrcal
    Convert(convert::ConvertArgs),
    /// Measure how far the camera moved between ground frames
    MountCheck(mount_check::MountCheckArgs),
    /// Check times of exposure with images of a clock on a screen
    TimeCheck(time_check::TimeCheckArgs),
    /// Detect markers in images
    Detect(detect::DetectArgs),
    /// Estimate the camera's attitude from ground frames
    Orient(orient::OrientArgs),
    /// Predict resolution and standard deviations
    Plan(plan::PlanArgs),
    /// Import the images of a camera's card into a store
    Import(import::ImportArgs),
    /// Mark undetected markers manually in a browser
    Mark(mark::MarkArgs),
    /// Estimate bending, torsion and positions for each image
    Solve(solve::SolveArgs),
    /// Estimate flight-invariant parameters from several flights
    Learn(learn::LearnArgs),
    /// Write a flight's figures and tables as one HTML file
    Report(report::ReportArgs),
    /// Verify every checksum and every invariant of a store
    Verify(verify::VerifyArgs),
    /// Compare two solves of a store, or two stores
    Compare(compare::CompareArgs),
    /// Copy flights to another disk and verify the copy
    Copy(copy::CopyArgs),
    /// Download flights from a recorder or `wingd serve`
    Fetch(fetch::FetchArgs),
    /// Upload flights to an object store (not in the on-board build)
    Upload(UploadArgs),
    /// Delete flights of which a copy holds every byte
    Prune(prune::PruneArgs),
    /// Show the state of the running recorder
    Status(status::StatusArgs),
    /// Ask the running recorder for an extra series
    Trigger(status::TriggerArgs),
    /// Export results as CSV, Parquet, VTK or JSON lines
    Export(export::ExportArgs),
    /// Add a table of the aircraft's own data to a flight
    AircraftData(aircraft_data::AircraftDataArgs),
    /// Compute bending moments: extremes, load cycles, damage
    Stress(stress::StressArgs),
    /// Serve the page of a store: flights, frames, downloads
    Serve(serve::ServeArgs),
    /// Render frames of a wing, or images of a board
    Simulate(simulate::SimulateArgs),
    /// Print completions for bash, zsh, fish, elvish or powershell
    Completions(pages::CompletionsArgs),
    /// Write the man pages into a directory
    Man(pages::ManArgs),
}

/// Failure of a command, by exit status.
#[derive(Debug)]
pub enum Failure {
    /// Operation that could not be completed; the text names the cause and the remedy. Exit status 1.
    Failed(String),
    /// Wrong usage that the parser does not detect. Exit status 2.
    Usage(String),
    /// Errors in configuration or installation. Exit status 78.
    Faults(Vec<Fault>),
    /// Errors that were already printed to standard output. Exit status 78.
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

/// Success of a command: complete or in part.
pub enum Completion {
    /// Complete success. Exit status 0.
    All,
    /// Partial success: some images failed, each with a message. Exit status 1.
    Partly,
}

impl Completion {
    fn from_success(ok: bool) -> Self {
        if ok { Self::All } else { Self::Partly }
    }
}

/// Parses the arguments and runs the command; docs/interface.md lists the exit statuses.
pub fn main() -> ExitCode {
    let matches =
        help::with_groups_and_examples(Arguments::command()).get_matches_from(join_flight_option(std::env::args_os()));
    let arguments = Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let outcome = match arguments.command {
        #[cfg(feature = "gphoto")]
        CliCommand::CameraChild => camera_child::run(),
        CliCommand::CameraTest(args) => camera_test::run(&args),
        CliCommand::Demo(args) => demo::run(&args),
        CliCommand::Run(args) => run::run(&args),
        CliCommand::Check(args) => check::run(&args),
        #[cfg(feature = "boards")]
        CliCommand::Calibrate(args) => calibrate::run(&args),
        #[cfg(not(feature = "boards"))]
        CliCommand::Calibrate(_) => unavailable::refuse_command("calibrate, like the demonstration build", "boards"),
        CliCommand::Convert(args) => convert::run(&args),
        CliCommand::MountCheck(args) => mount_check::run(&args),
        CliCommand::TimeCheck(args) => time_check::run(&args),
        CliCommand::Detect(args) => detect::run(&args),
        CliCommand::Orient(args) => orient::run(&args),
        CliCommand::Plan(args) => plan::run(&args),
        CliCommand::Import(args) => import::run(&args),
        CliCommand::Mark(args) => mark::run(&args),
        CliCommand::Solve(args) => solve::run(&args),
        CliCommand::Learn(args) => learn::run(&args),
        CliCommand::Report(args) => report::run(&args),
        CliCommand::Verify(args) => verify::run(&args),
        CliCommand::Compare(args) => compare::run(&args),
        CliCommand::Copy(args) => copy::run(&args),
        CliCommand::Fetch(args) => fetch::run(&args),
        #[cfg(feature = "upload")]
        CliCommand::Upload(args) => upload::run(&args),
        #[cfg(not(feature = "upload"))]
        CliCommand::Upload(_) => unavailable::refuse_command("upload, like the on-board build", "upload"),
        CliCommand::Prune(args) => prune::run(&args),
        CliCommand::Status(args) => status::print_status(&args),
        CliCommand::Trigger(args) => status::trigger_series(&args),
        CliCommand::Export(args) => export::run(&args),
        CliCommand::AircraftData(args) => aircraft_data::run(&args),
        CliCommand::Stress(args) => stress::run(&args),
        CliCommand::Serve(args) => serve::run(&args),
        CliCommand::Simulate(args) => simulate::run(&args),
        CliCommand::Init(args) => init::run(&args),
        CliCommand::Completions(args) => pages::write_completions(&args),
        CliCommand::Man(args) => pages::write_man_pages(&args),
    };
    match outcome {
        Ok(Completion::All) => ExitCode::SUCCESS,
        Ok(Completion::Partly) => ExitCode::from(1),
        Err(failure) => report_failure(&failure),
    }
}

/// Joins `--flight f0001` into one argument: `--flight` alone, before images, takes no value.
fn join_flight_option(arguments: impl Iterator<Item = OsString>) -> Vec<OsString> {
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

fn report_failure(failure: &Failure) -> ExitCode {
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
            eprintln!("wingd: {} error{plural} in the configuration or installation", faults.len());
            ExitCode::from(78)
        }
        Failure::AlreadyReported => ExitCode::from(78),
    }
}

/// Prints a line of results; a closed pipe (`| head`) is not an error.
///
/// # Errors
/// Returns an error if the line cannot be written, because a lost result must not look like success.
fn print_line(text: &str) -> Result<(), Failure> {
    use std::io::{ErrorKind, Write};
    let mut output = std::io::stdout().lock();
    match writeln!(output, "{}", installation::printable_text(text)).and_then(|()| output.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Failure::Failed(format!(
            "the results cannot be written to standard output ({error}); free space, or redirect them elsewhere"
        ))),
        _ => Ok(()),
    }
}

/// Creates the failure for a file that could not be written.
fn write_failure(file: &Path, remedy: &str) -> impl Fn(std::io::Error) -> Failure {
    let (file, remedy) = (file.display().to_string(), remedy.to_owned());
    move |error| Failure::Failed(format!("{file} cannot be written ({error}); {remedy}"))
}

/// Remedy for a file that cannot be written.
const CHECK_WRITE_ACCESS: &str = "check permissions and free space";

/// Prints warnings about the installation to standard error.
fn print_warnings(installation: &Installation) {
    for doubt in installation::find_warnings(installation) {
        eprintln!("wingd: warning: {doubt}");
    }
}

/// Prints to standard error that a prior from earlier flights is used.
fn print_flight_prior(installation: &Installation) {
    if let Some(prior) = &installation.flight_prior {
        eprintln!("wingd: using the prior from {} ({})", prior.flight_count_text(), installation::FLIGHT_PRIOR_FILE);
    }
}

/// Loads an installation and prints its warnings.
fn load_installation(directory: &Path) -> Result<Installation, Failure> {
    let installation = installation::load(directory)?;
    print_warnings(&installation);
    Ok(installation)
}

/// Waits for Ctrl-C or SIGTERM.
async fn stop_signal() {
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
