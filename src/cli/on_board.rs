//! Stand-ins for the commands of the desk in the on-board build: each answers with the package that has it.

use std::ffi::OsString;

use clap::{Arg, ArgMatches, Command, FromArgMatches, Subcommand, error::ErrorKind, value_parser};

use super::help::DESK_COMMANDS;
use super::{Completion, TaskResult, not_on_board};

/// Command of the desk, by its name.
pub struct AbsentCommand(String);

impl AbsentCommand {
    /// Returns the failure that names the package for the desk.
    pub fn run(&self) -> TaskResult<Completion> {
        Err(not_on_board(&format!("`wingd {}`", self.0)))
    }
}

impl FromArgMatches for AbsentCommand {
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

impl Subcommand for AbsentCommand {
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
