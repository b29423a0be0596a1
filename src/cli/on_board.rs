//! Stand-ins for the commands of the desk in the on-board build: each answers with the package that has it.

use std::ffi::OsString;

use clap::{Arg, ArgMatches, Command, FromArgMatches, Subcommand, error::ErrorKind, value_parser};

use super::help::DESK_COMMANDS;
use std::path::Path;

use wingd_base::failure::{Completion, TaskResult, not_on_board};
use wingd_evaluation::results::ReportBuilder;
use wingd_measure::setup::Setup;
use wingd_store::receive::Receiver;

/// The recorder writes no reports.
pub const REPORT_BUILDER: Option<ReportBuilder> = None;

/// Runs a command of the workstation.
pub fn run(command: &DeskCommand) -> TaskResult<Completion> {
    command.run()
}

/// The recorder downloads nothing.
pub enum Source {}

impl Source {
    pub fn open(_: &str, _: Option<&Path>, _: Option<&Path>) -> TaskResult<Self> {
        Err(not_on_board("`wingd copy URL`"))
    }

    pub fn flight_names(&mut self) -> TaskResult<Vec<String>> {
        match *self {}
    }

    pub fn receive(&mut self, _: &Receiver, _: &[String], _: bool) -> TaskResult<()> {
        match *self {}
    }
}

/// Plans are not part of the recorder's program.
pub fn describe_small_priors(_: &Setup) -> Vec<String> {
    vec!["not checked by the recorder's program; run `wingd check` on the workstation".to_owned()]
}

/// Command of the desk, by its name.
pub struct DeskCommand(String);

impl DeskCommand {
    /// Returns the failure that names the package for the desk.
    pub fn run(&self) -> TaskResult<Completion> {
        Err(not_on_board(&format!("`wingd {}`", self.0)))
    }
}

impl FromArgMatches for DeskCommand {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let name = matches
            .subcommand_name()
            .filter(|name| Self::has_subcommand(name));
        name.map(|name| Self(name.to_owned()))
            .ok_or_else(|| clap::Error::new(ErrorKind::InvalidSubcommand))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Subcommand for DeskCommand {
    fn augment_subcommands(command: Command) -> Command {
        let any = Arg::new("given")
            .num_args(0..)
            .trailing_var_arg(true)
            .allow_hyphen_values(true);
        let any = any.value_parser(value_parser!(OsString)).hide(true);
        command.subcommands(DESK_COMMANDS.map(|name| {
            Command::new(name)
                .hide(true)
                .disable_help_flag(true)
                .arg(any.clone())
        }))
    }

    fn augment_subcommands_for_update(command: Command) -> Command {
        Self::augment_subcommands(command)
    }

    fn has_subcommand(name: &str) -> bool {
        DESK_COMMANDS.contains(&name)
    }
}
