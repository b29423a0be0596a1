//! Command line: one file per command. Results go to standard output, logs and progress to standard error.

/// Prints a line to standard error. It replaces the macro of the standard library in all commands: no name from a file or a
/// server may control the terminal.
macro_rules! eprintln {
    ($($text:tt)*) => {
        std::eprintln!("{}", $crate::installation::printable_text(&format!($($text)*)))
    };
}

/// Declares commands: the words of the list, the arguments, and the function that runs them. `[name]` after a function names
/// a value that all commands are given and this one takes.
macro_rules! commands {
    (
        $list:ident($($value:ident: $kind:ty)?)
        $($(#[doc = $about:literal])+ $(#[cfg($built:meta)])? $(#[command($hidden:ident = true)])?
        $name:ident($args:ty) => $run:path $([$given:ident])?,)+
    ) => {
        // Only one value exists per run: its size does not matter.
        #[allow(clippy::large_enum_variant)]
        #[derive(clap::Subcommand)]
        pub enum $list {
            $($(#[doc = $about])+ $(#[cfg($built)])? $(#[command($hidden = true)])? $name($args),)+
        }

        impl $list {
            /// Runs the command.
            pub fn run(&self $(, $value: $kind)?) -> Result<Completion, Failure> {
                match self {
                    $($(#[cfg($built)])? Self::$name(args) => $run(args $(, $given)?),)+
                }
            }
        }
    };
}

#[cfg(feature = "desk")]
mod aircraft_data;
mod batch;
mod board;
#[cfg(feature = "boards")]
mod calibrate;
#[cfg(feature = "gphoto")]
mod camera_child;
mod camera_test;
mod check;
#[cfg(feature = "desk")]
mod compare;
#[cfg(feature = "desk")]
mod convert;
mod copy;
mod default_paths;
#[cfg(feature = "desk")]
mod deform;
#[cfg(feature = "desk")]
mod demo;
#[cfg(feature = "desk")]
mod desk;
mod detect;
mod diagnose;
#[cfg(feature = "desk")]
mod difference;
#[cfg(feature = "desk")]
mod export;
#[cfg(feature = "desk")]
mod fetch;
#[cfg(feature = "desk")]
mod flight_shape;
pub mod help;
#[cfg(feature = "desk")]
mod import;
mod init;
#[cfg(feature = "desk")]
mod learn;
mod logging;
#[cfg(feature = "desk")]
mod mark;
#[cfg(feature = "desk")]
mod mean;
mod mount_check;
#[cfg(not(feature = "desk"))]
mod on_board;
mod orient;
mod output;
mod pages;
#[cfg(feature = "desk")]
mod plan;
mod prune;
mod recorder;
#[cfg(feature = "desk")]
mod report;
mod run;
mod serve;
#[cfg(feature = "desk")]
mod simulate;
mod solve;
mod status;
#[cfg(feature = "desk")]
mod stress;
#[cfg(feature = "desk")]
mod time_check;
#[cfg(all(feature = "desk", not(all(feature = "boards", feature = "upload"))))]
mod unavailable;
#[cfg(feature = "upload")]
mod upload;
mod verify;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::desk::{Failure, TaskResult};
use crate::installation::{self, Installation};
use crate::report::ReportBuilder;
use crate::store::layout;
use board::BoardCommand;
#[cfg(feature = "desk")]
use desk::DeskCommand;
#[cfg(not(feature = "desk"))]
use on_board::AbsentCommand as DeskCommand;
use output::{
    byte_progress, print_json, print_line, print_notes, progress_bar, show_busy, write_output,
};

/// Measure the shape of a wing in flight with one camera at a cabin window.
#[derive(Parser)]
#[command(
    name = "wingd",
    version,
    propagate_version = true,
    arg_required_else_help = true
)]
#[command(
    after_help = "Exit status: 0 success, 1 failure or partial success, 2 wrong usage, \
    78 errors in configuration or installation."
)]
struct Arguments {
    #[command(subcommand)]
    command: CliCommand,
}

// Only one value exists per run: its size does not matter.
#[allow(clippy::large_enum_variant)]
#[derive(Subcommand)]
enum CliCommand {
    #[command(flatten)]
    Board(BoardCommand),
    #[command(flatten)]
    Desk(DeskCommand),
    /// Print completions for bash, zsh, fish, elvish or powershell
    Completions(pages::CompletionsArgs),
    /// Write the man pages into a directory
    Man(pages::ManArgs),
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

/// Parses the arguments and runs the command; docs/reference/cli.md lists the exit statuses.
pub fn main() -> ExitCode {
    let matches = help::with_groups_and_examples(Arguments::command())
        .get_matches_from(join_flight_option(std::env::args_os()));
    let arguments = Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let done = match &arguments.command {
        CliCommand::Board(command) => command.run(REPORT_BUILDER),
        CliCommand::Desk(command) => command.run(),
        CliCommand::Completions(args) => pages::write_completions(args),
        CliCommand::Man(args) => pages::write_man_pages(args),
    };
    match done {
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
        let flight = argument
            .to_str()
            .is_some_and(|text| layout::flight_number(text).is_some());
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
            eprintln!(
                "wingd: {} error{plural} in the configuration or installation",
                faults.len()
            );
            ExitCode::from(78)
        }
    }
}

/// Builder of reports, if this build has it.
#[cfg(feature = "desk")]
const REPORT_BUILDER: Option<ReportBuilder> = Some(crate::report::html::REPORT_BUILDER);
#[cfg(not(feature = "desk"))]
const REPORT_BUILDER: Option<ReportBuilder> = None;

/// Creates the failure for a part of the program that the on-board build lacks.
fn not_on_board(part: &str) -> Failure {
    Failure::Usage(format!(
        "{part} is not in the on-board build; use the package wingd-desk, on a copy of the store"
    ))
}

/// Prints to standard error that a prior from earlier flights is used.
fn print_flight_prior(installation: &Installation) {
    if let Some(prior) = &installation.flight_prior {
        eprintln!(
            "wingd: using the prior from {} ({})",
            prior.flight_count_text(),
            installation::FLIGHT_PRIOR_FILE
        );
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
