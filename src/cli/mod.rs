//! Command line: one file per command. Results go to standard output, logs and progress to standard error.

mod board;
#[cfg(feature = "gphoto")]
mod camera_child;
mod camera_shots;
mod check;
mod copy;
mod detect;
mod diagnose;
pub mod external;
pub mod help;
mod init;
mod mount_check;
mod orient;
mod pages;
mod prune;
mod recorder;
mod run;
mod serve;
mod solve;
mod status;
mod verify;
#[cfg_attr(not(feature = "desk"), path = "on_board.rs")]
mod workstation;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use board::BoardCommand;
use wingd_base::failure::{Completion, Failure};
use workstation::{DeskCommand, REPORT_BUILDER};

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

/// Parses the arguments and runs the command; docs/reference/cli.md lists the exit statuses.
pub fn main() -> ExitCode {
    let given: Vec<OsString> = std::env::args_os().collect();
    if let Some(status) = external::run_external(&Arguments::command(), &given) {
        return status;
    }
    let command = help::with_groups_and_examples(Arguments::command());
    let matches = external::list_external(command, &given).get_matches_from(given);
    let arguments = Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let done = match &arguments.command {
        CliCommand::Board(command) => command.run(REPORT_BUILDER),
        CliCommand::Desk(command) => workstation::run(command),
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
