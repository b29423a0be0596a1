//! Promise: the page of the commands follows from their help.
//!
//! `UPDATE_TABLES=1 cargo test --test system command_page` writes it.

use std::process::Command;

use crate::result_tables::{assert_or_update, file, with_part};

/// Options that the page describes once for all commands, with the beginning of their purpose.
const COMMON_OPTIONS: [(&str, &str); 9] = [
    ("-h,", ""),
    ("-V,", ""),
    ("--json", ""),
    ("--jobs", ""),
    ("--wide", ""),
    ("--installation", "Installation"),
    ("--config", "Configuration"),
    ("--flight", "Flight"),
    ("--inputs", ""),
];
/// Width of a line of options, characters.
const PAGE_COLUMNS: usize = 110;

fn help_of(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args(arguments)
        .output()
        .unwrap();
    String::from_utf8(output.stdout).unwrap()
}

/// Headings of the groups of commands with the names below each.
fn read_groups(help: &str) -> Vec<(&str, Vec<&str>)> {
    let mut groups: Vec<(&str, Vec<&str>)> = vec![];
    for line in help.lines().take_while(|line| *line != "Options:") {
        match (
            line.strip_suffix(':'),
            line.strip_prefix("  "),
            groups.last_mut(),
        ) {
            (Some(heading), None, _) => groups.push((heading, vec![])),
            (_, Some(entry), Some((_, names))) => names.extend(entry.split(' ').next()),
            _ => {}
        }
    }
    groups
}

/// Name and purpose of each option: a line of the list, continued by the more indented ones.
fn read_options(help: &str) -> Vec<(String, String)> {
    let list = help.split_once("\nOptions:\n").map_or("", |(_, rest)| rest);
    let mut options: Vec<(String, String)> = vec![];
    for line in list.lines().take_while(|line| !line.starts_with("Example")) {
        let text = line.trim_start();
        if text.is_empty() || text.len() == line.len() {
            continue;
        }
        if text.starts_with('-') && line.len() - text.len() <= 6 {
            let (name, purpose) = text.split_once("  ").unwrap_or((text, ""));
            options.push((name.to_owned(), purpose.trim().to_owned()));
        } else if let Some((_, purpose)) = options.last_mut() {
            *purpose = format!("{purpose} {text}").trim().to_owned();
        }
    }
    options
}

/// The first part of a purpose: the help has the rest, with defaults and values.
fn shorten(purpose: &str) -> &str {
    let ends = [": ", "; ", ", ", ". ", " (", " [default", " [possible"]
        .map(|end| purpose.find(end).unwrap_or(purpose.len()));
    &purpose[..ends.into_iter().min().unwrap_or_default()]
}

fn describe_command(name: &str) -> String {
    let help = help_of(&[name, "-h"]);
    let (about, rest) = help.split_once("\n\nUsage: ").unwrap();
    let about = about.split_whitespace().collect::<Vec<_>>().join(" ");
    let usage = rest.lines().next().unwrap().replacen(" [OPTIONS]", "", 1);
    let options = read_options(&help).into_iter();
    let is_common = |name: &str, purpose: &str| {
        let is = |(common, text): &(&str, &str)| {
            name.split(' ').next() == Some(*common) && (text.is_empty() || purpose == *text)
        };
        COMMON_OPTIONS.iter().any(is)
    };
    let own = options.filter(|(option, purpose)| !is_common(option, shorten(purpose)));
    let names: Vec<String> = own.map(|(name, _)| name).collect();
    format!("{usage}\n  {about}.\n{}", wrap(&names))
}

/// Lines of names, each indented and at most as wide as a page.
fn wrap(names: &[String]) -> String {
    let mut lines: Vec<String> = vec![];
    for name in names {
        match lines.last_mut() {
            Some(line) if line.len() + 2 + name.len() <= PAGE_COLUMNS => {
                line.push_str("  ");
                line.push_str(name);
            }
            _ => lines.push(format!("  {name}")),
        }
    }
    lines.iter().map(|line| format!("{line}\n")).collect()
}

#[test]
fn the_page_of_the_commands_follows_from_their_help() {
    let help = help_of(&["--help"]);
    let groups = read_groups(&help);
    // The contract has at most 26 visible commands besides completions and man.
    let visible = groups.iter().map(|(_, names)| names.len()).sum::<usize>();
    assert!((20..=28).contains(&visible), "{help}");
    let part: String = groups
        .iter()
        .map(|(heading, names)| {
            let commands: Vec<String> = names.iter().map(|name| describe_command(name)).collect();
            format!("## {heading}\n\n```text\n{}```\n\n", commands.join("\n"))
        })
        .collect();
    let path = file("docs/reference/cli.md");
    let page = std::fs::read_to_string(&path).unwrap();
    assert_or_update(&path, &with_part(&page, "commands", &part));
}
