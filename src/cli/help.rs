//! `wingd help` groups the commands by purpose and shows examples of each.

use clap::Command;
use wingd_base::listed_command::{Group, ListedCommand};

use super::board::BoardCommand;
use super::workstation;

/// Typical order of the commands for a new aircraft.
const TYPICAL_ORDER: &str =
    "Typical order: init, calibrate, check, plan, orient, run or import,\nsolve, report.";

/// Lists all commands of this program.
pub fn listed_commands() -> Vec<ListedCommand> {
    let utility = |identifier, examples| ListedCommand {
        identifier,
        group: Group::Utility,
        examples,
    };
    let mut all = BoardCommand::LISTED.to_vec();
    all.extend(workstation::listed_commands());
    all.push(utility(
        "Completions",
        &["wingd completions bash > wingd.bash"],
    ));
    all.push(utility("Man", &["wingd man man1"]));
    all
}

/// Column at which the descriptions of the commands begin, characters.
const DESCRIPTION_COLUMN: usize = 17;

/// Adds the grouped list of commands, and examples below the options of each command.
pub fn with_groups_and_examples(mut command: Command) -> Command {
    let groups = command_listing(&command);
    for listed in listed_commands() {
        let heading = match listed.examples.len() {
            0 => continue,
            1 => "Example:",
            _ => "Examples:",
        };
        let text = format!("{heading}\n  {}", listed.examples.join("\n  "));
        command = command.mut_subcommand(listed.name(), |c| c.after_help(text));
    }
    command.help_template(format!(
        "{{about}}\n\n{{usage-heading}} {{usage}}\n\n{groups}{TYPICAL_ORDER}\n\nOptions:\n{{options}}{{after-help}}"
    ))
}

fn command_listing(command: &Command) -> String {
    let mut text = String::new();
    let all = listed_commands();
    for (group, heading) in Group::HEADINGS {
        text.push_str(&format!("{heading}:\n"));
        for name in all
            .iter()
            .filter(|listed| listed.group == group)
            .map(ListedCommand::name)
        {
            let about = command
                .find_subcommand(&name)
                .filter(|c| !c.is_hide_set())
                .and_then(Command::get_about);
            if let Some(about) = about {
                text.push_str(&format!(
                    "  {name:<width$}{about}\n",
                    width = DESCRIPTION_COLUMN - 2
                ));
            }
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn every_command_has_a_group_and_an_example_and_fits_a_terminal() {
        let command = super::super::Arguments::command();
        let listed = listed_commands();
        for known in command.get_subcommands().filter(|c| !c.is_hide_set()) {
            let name = known.get_name();
            let found = listed.iter().find(|listed| listed.name() == name);
            let found = found.unwrap_or_else(|| panic!("{name} is not listed"));
            assert!(
                found.group != Group::Hidden && !found.examples.is_empty(),
                "{name}"
            );
        }
        let text = command_listing(&command);
        assert!(
            text.lines().all(|line| line.chars().count() <= 80),
            "{text}"
        );
    }

    #[test]
    fn every_help_fits_a_terminal_of_80_columns() {
        let mut all = with_groups_and_examples(super::super::Arguments::command()).term_width(80);
        all.build();
        let mut texts = vec![all.render_long_help().to_string()];
        for command in all.get_subcommands_mut() {
            let mut command = command.clone().term_width(80);
            texts.extend([
                command.render_help().to_string(),
                command.render_long_help().to_string(),
            ]);
        }
        let wide = texts
            .iter()
            .flat_map(|text| text.lines())
            .find(|line| line.chars().count() > 80);
        assert_eq!(wide, None);
    }
}
