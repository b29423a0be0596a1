//! `wingd help` groups the commands by purpose and shows examples of each.

use clap::Command;

/// Command groups in the order of a campaign; each visible command is in exactly one.
const COMMAND_GROUPS: [(&str, &[&str]); 5] = [
    (
        "Prepare an aircraft",
        &[
            "init",
            "plan",
            "calibrate",
            "convert",
            "orient",
            "diagnose",
            "mount-check",
            "check",
            "camera-test",
            "time-check",
        ],
    ),
    ("Record in flight", &["run", "status", "trigger"]),
    (
        "Evaluate",
        &[
            "import",
            "detect",
            "mark",
            "solve",
            "learn",
            "compare",
            "report",
            "export",
            "deform",
            "aircraft-data",
        ],
    ),
    (
        "Store and transfer",
        &["verify", "copy", "fetch", "serve", "upload", "prune"],
    ),
    (
        "Demo and utilities",
        &["demo", "simulate", "completions", "man"],
    ),
];

/// Commands of the desk, which the on-board build lacks.
pub const DESK_COMMANDS: [&str; 16] = [
    "aircraft-data",
    "calibrate",
    "compare",
    "convert",
    "deform",
    "demo",
    "export",
    "fetch",
    "import",
    "learn",
    "mark",
    "plan",
    "report",
    "simulate",
    "time-check",
    "upload",
];

/// Examples by command. A test runs them in the folder that the tutorial creates (docs/tutorial.md).
pub const EXAMPLES: &[(&str, &[&str])] = &[
    (
        "init",
        &["wingd init aircraft --side left --root-offset 0.7"],
    ),
    (
        "plan",
        &[
            "wingd plan --span 33 --height 2.5 --chord 4 --focal 12 --sensor 4000x3000x1.54 --markers 20 --fixed 2 --frames 10 --want 5mm",
            "wingd plan --installation installation --tip-deflection 2.5 --figure plan.svg",
        ],
    ),
    (
        "calibrate",
        &[
            "wingd calibrate --board board.toml --output camera.toml --report calibration.html board/*.jpg",
        ],
    ),
    (
        "convert",
        &["wingd convert installation/camera.toml wing.cameramodel"],
    ),
    (
        "orient",
        &["wingd orient --installation installation frames/ground.jpg"],
    ),
    (
        "diagnose",
        &["wingd diagnose --installation installation frames/ground.jpg"],
    ),
    (
        "mount-check",
        &["wingd mount-check --installation installation frames/ground.jpg frames/ground.jpg"],
    ),
    (
        "check",
        &[
            "wingd check --config wingd.toml",
            "wingd check --installation installation",
        ],
    ),
    (
        "camera-test",
        &["wingd camera-test --config wingd.toml --shots 2 --output look"],
    ),
    (
        "time-check",
        &[
            "wingd time-check --page clock.html",
            "wingd time-check store --series s000001",
        ],
    ),
    ("run", &["wingd run --config wingd.toml"]),
    ("status", &["wingd status --config wingd.toml --json"]),
    ("trigger", &["wingd trigger --config wingd.toml"]),
    (
        "detect",
        &["wingd detect --installation installation --overlay drawn frames/ground.jpg"],
    ),
    (
        "import",
        &["wingd import frames --store card --installation installation"],
    ),
    (
        "solve",
        &[
            "wingd solve --installation installation --report report.html frames/flight-1.jpg frames/flight-2.jpg",
            "wingd solve --installation installation frames/flight-1.jpg",
            "wingd solve --installation installation --flight --json frames/flight-*.jpg",
            "wingd solve store --sigma prior",
        ],
    ),
    (
        "mark",
        &[
            "wingd mark store",
            "wingd mark --installation installation frames/flight-1.jpg",
        ],
    ),
    ("learn", &["wingd learn store --installation installation"]),
    ("compare", &["wingd compare store"]),
    ("report", &["wingd report store --output report.html"]),
    (
        "export",
        &[
            "wingd export store --format csv --table span --output span.csv",
            "wingd export store --format parquet --output markers.parquet",
            "wingd export store --format netcdf --output shape.nc",
        ],
    ),
    (
        "deform",
        &["wingd deform store --frame s000001/0001.jpg --surface nodes.csv --output deformed"],
    ),
    (
        "aircraft-data",
        &[
            "wingd aircraft-data demo-flight/store qar.csv --mapping mapping.toml --flight f0001",
            "wingd aircraft-data store --flight f0001 --list",
        ],
    ),
    ("verify", &["wingd verify store"]),
    ("copy", &["wingd copy store copy"]),
    ("fetch", &["wingd fetch http://127.0.0.1:8080 copy"]),
    ("serve", &["wingd serve store"]),
    (
        "upload",
        &["wingd upload store --to file:///srv/wings --aircraft D-ABCD"],
    ),
    (
        "prune",
        &["wingd prune store --verified-copy copy --dry-run"],
    ),
    ("demo", &["wingd demo --output demo"]),
    (
        "simulate",
        &[
            "wingd simulate --output practice --seed 4 --size 1600 1200 --focal 1400 --tip-deflections 2.4,1.8 --board board.toml",
        ],
    ),
    ("completions", &["wingd completions bash > wingd.bash"]),
    ("man", &["wingd man man1"]),
];

/// Column at which the descriptions of the commands begin, characters.
const DESCRIPTION_COLUMN: usize = 17;

/// Adds the grouped list of commands, and examples below the options of each command.
pub fn with_groups_and_examples(mut command: Command) -> Command {
    let groups = command_listing(&command);
    for (name, lines) in EXAMPLES {
        let found = command
            .find_subcommand(name)
            .is_some_and(|c| !c.is_hide_set());
        if found {
            let heading = if lines.len() == 1 {
                "Example:"
            } else {
                "Examples:"
            };
            let text = format!("{heading}\n  {}", lines.join("\n  "));
            command = command.mut_subcommand(name, |c| c.after_help(text));
        }
    }
    command.help_template(format!(
        "{{about}}\n\n{{usage-heading}} {{usage}}\n\n{groups}Options:\n{{options}}{{after-help}}"
    ))
}

fn command_listing(command: &Command) -> String {
    let mut text = String::new();
    for (heading, names) in COMMAND_GROUPS {
        text.push_str(&format!("{heading}:\n"));
        for name in names {
            let about = command
                .find_subcommand(name)
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
    fn every_command_is_in_one_group_has_an_example_and_fits_a_terminal() {
        let command = super::super::Arguments::command();
        for known in command.get_subcommands().filter(|c| !c.is_hide_set()) {
            let name = known.get_name();
            let groups = COMMAND_GROUPS
                .iter()
                .flat_map(|(_, names)| names.iter())
                .filter(|n| **n == name)
                .count();
            assert_eq!(groups, 1, "{name}");
            assert!(
                EXAMPLES
                    .iter()
                    .any(|(n, lines)| *n == name && !lines.is_empty()),
                "{name}"
            );
        }
        let text = command_listing(&command);
        assert!(
            text.lines().all(|line| line.chars().count() <= 80),
            "{text}"
        );
        assert_eq!(
            text.lines().filter(|line| line.starts_with("  ")).count(),
            EXAMPLES.len()
        );
    }

    #[test]
    fn the_commands_of_the_desk_are_listed() {
        use clap::Subcommand;
        let all = wingd_desk::commands::DeskCommand::augment_subcommands(Command::new("desk"));
        let mut names: Vec<&str> = all.get_subcommands().map(Command::get_name).collect();
        names.sort_unstable();
        assert_eq!(names, DESK_COMMANDS);
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
