//! Command line: one file per command. Results go to standard output, logs and progress to standard error.

/// Prints a line to standard error. It replaces the macro of the standard library in all commands: no name from a file or a
/// server may control the terminal.
macro_rules! eprintln {
    ($($text:tt)*) => {
        std::eprintln!("{}", $crate::installation::printable_text(&format!($($text)*)))
    };
}

mod aircraft_data;
mod batch;
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
mod import;
mod init;
mod learn;
mod logging;
mod mark;
mod mount_check;
mod orient;
mod output;
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
mod stress;
mod time_check;
#[cfg(any(not(feature = "boards"), not(feature = "upload")))]
mod unavailable;
#[cfg(feature = "upload")]
mod upload;
mod verify;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::desk::Failure;
use crate::installation::{self, Installation};
use crate::store::layout;
use output::{byte_progress, print_json, print_line, print_notes, progress_bar, show_busy, write_output};
#[cfg(not(feature = "boards"))]
use unavailable::calibrate;
#[cfg(not(feature = "upload"))]
use unavailable::upload;

/// Measure the shape of a wing in flight with one camera at a cabin window.
#[derive(Parser)]
#[command(name = "wingd", version, propagate_version = true, arg_required_else_help = true)]
#[command(after_help = "Exit status: 0 success, 1 failure or partial success, 2 wrong usage, \
    78 errors in configuration or installation.")]
struct Arguments {
    #[command(subcommand)]
    command: CliCommand,
}

/// Declares the commands in the order of their help: the words of the list, the arguments, and the function that runs them.
macro_rules! commands {
    ($($(#[doc = $about:literal])+ $(#[cfg($built:meta)])? $(#[command($hidden:ident = true)])? $name:ident($args:ty) => $run:path,)+) => {
        // Only one value exists per run: its size does not matter.
        #[allow(clippy::large_enum_variant)]
        #[derive(Subcommand)]
        enum CliCommand {
            $($(#[doc = $about])+ $(#[cfg($built)])? $(#[command($hidden = true)])? $name($args),)+
        }

        impl CliCommand {
            fn run(&self) -> Result<Completion, Failure> {
                match self {
                    $($(#[cfg($built)])? Self::$name(args) => $run(args),)+
                }
            }
        }
    };
}

commands! {
    /// Run the camera process of a recorder
    #[cfg(feature = "gphoto")]
    #[command(hide = true)]
    CameraChild(camera_child::CameraChildArgs) => camera_child::run,
    /// Take shots with the configured camera, without the recorder
    CameraTest(camera_test::CameraTestArgs) => camera_test::run,
    /// Run a bundled flight through the real recorder
    Demo(demo::DemoArgs) => demo::run,
    /// Run the recorder: take series of frames and solve them
    Run(run::RunArgs) => run::run,
    /// Write a configuration, an installation and a board to fill in
    Init(init::InitArgs) => init::run,
    /// Check configuration, installation, store and camera
    Check(check::CheckArgs) => check::run,
    /// Estimate the interior orientation from images of a board
    Calibrate(calibrate::CalibrateArgs) => calibrate::run,
    /// Convert a camera from or to OpenCV, ROS, Kalibr and mrcal
    Convert(convert::ConvertArgs) => convert::run,
    /// Measure how far the camera moved between ground frames
    MountCheck(mount_check::MountCheckArgs) => mount_check::run,
    /// Check times of exposure with images of a clock on a screen
    TimeCheck(time_check::TimeCheckArgs) => time_check::run,
    /// Detect markers in images
    Detect(detect::DetectArgs) => detect::run,
    /// Estimate the camera's attitude from ground frames
    Orient(orient::OrientArgs) => orient::run,
    /// Predict resolution and standard deviations
    Plan(plan::PlanArgs) => plan::run,
    /// Import the images of a camera's card into a store
    Import(import::ImportArgs) => import::run,
    /// Mark undetected markers manually in a browser
    Mark(mark::MarkArgs) => mark::run,
    /// Estimate bending, torsion and positions for each image
    Solve(solve::SolveArgs) => solve::run,
    /// Estimate flight-invariant parameters from several flights
    Learn(learn::LearnArgs) => learn::run,
    /// Write a flight's figures and tables as one HTML file
    Report(report::ReportArgs) => report::run,
    /// Verify every checksum and every invariant of a store
    Verify(verify::VerifyArgs) => verify::run,
    /// Compare two solves of a store, or two stores
    Compare(compare::CompareArgs) => compare::run,
    /// Copy flights to another disk and verify the copy
    Copy(copy::CopyArgs) => copy::run,
    /// Download flights from a recorder or `wingd serve`
    Fetch(fetch::FetchArgs) => fetch::run,
    /// Upload flights to an object store (not in the on-board build)
    Upload(upload::UploadArgs) => upload::run,
    /// Delete flights of which a copy holds every byte
    Prune(prune::PruneArgs) => prune::run,
    /// Show the state of the running recorder
    Status(status::StatusArgs) => status::print_status,
    /// Ask the running recorder for an extra series
    Trigger(status::TriggerArgs) => status::trigger_series,
    /// Export results as CSV, Parquet, VTK or JSON lines
    Export(export::ExportArgs) => export::run,
    /// Add a table of the aircraft's own data to a flight
    AircraftData(aircraft_data::AircraftDataArgs) => aircraft_data::run,
    /// Compute bending moments: extremes, load cycles, damage
    Stress(stress::StressArgs) => stress::run,
    /// Serve the page of a store: flights, frames, downloads
    Serve(serve::ServeArgs) => serve::run,
    /// Render frames of a wing, or images of a board
    Simulate(simulate::SimulateArgs) => simulate::run,
    /// Print completions for bash, zsh, fish, elvish or powershell
    Completions(pages::CompletionsArgs) => pages::write_completions,
    /// Write the man pages into a directory
    Man(pages::ManArgs) => pages::write_man_pages,
}

/// Success of a command: complete or in part.
pub enum Completion {
    /// Complete success. Exit status 0.
    All,
    /// Partial success: some images failed, each with a message. Exit status 1.
    Partly,
    /// Errors in configuration or installation, printed to standard output as results. Exit status 78.
    Faulty,
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
    match arguments.command.run() {
        Ok(Completion::All) => ExitCode::SUCCESS,
        Ok(Completion::Partly) => ExitCode::from(1),
        Ok(Completion::Faulty) => ExitCode::from(78),
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
    }
}

/// Prints to standard error that a prior from earlier flights is used.
fn print_flight_prior(installation: &Installation) {
    if let Some(prior) = &installation.flight_prior {
        eprintln!("wingd: using the prior from {} ({})", prior.flight_count_text(), installation::FLIGHT_PRIOR_FILE);
    }
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
