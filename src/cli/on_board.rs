//! The on-board program in place of `workstation.rs`: it has no commands of the workstation, and says which package has them.

use std::path::Path;

use clap::Subcommand;

use wingd_base::failure::{Completion, TaskResult, not_on_board};
use wingd_base::listed_command::ListedCommand;
use wingd_evaluation::results::ReportBuilder;
use wingd_measure::setup::Setup;
use wingd_store::receive::Receiver;

/// The recorder writes no reports.
pub const REPORT_BUILDER: Option<ReportBuilder> = None;

/// No command.
#[derive(Subcommand)]
pub enum AbsentCommand {}
pub use AbsentCommand as DeskCommand;

/// Lists the commands of the workstation: none.
pub fn listed_commands() -> Vec<ListedCommand> {
    vec![]
}

/// Runs a command of the workstation.
pub fn run(command: &AbsentCommand) -> TaskResult<Completion> {
    match *command {}
}

/// No download.
pub enum AbsentDownload {}
pub use AbsentDownload as Download;

impl AbsentDownload {
    /// Returns the failure that names the package with downloads.
    pub fn open(_: &str, _: Option<&Path>, _: Option<&Path>) -> TaskResult<Self> {
        Err(not_on_board("`wingd copy URL`"))
    }

    /// Lists the flights of a page.
    pub fn flight_names(&mut self) -> TaskResult<Vec<String>> {
        match *self {}
    }

    /// Downloads flights.
    pub fn receive(&mut self, _: &Receiver, _: &[String], _: bool) -> TaskResult<()> {
        match *self {}
    }
}

/// Plans are not part of the recorder's program.
pub fn describe_small_priors(_: &Setup) -> Vec<String> {
    vec!["not checked by the recorder's program; run `wingd check` on the workstation".to_owned()]
}
