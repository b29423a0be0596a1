//! Commands, options, tests, targets and scripts that the pages name exist.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use wingd::cli::external::PACKAGE_COMMANDS;

use super::{ROOT, code, pages};

/// Help text of a command; `None` if there is no such command.
fn help_of(command: &str) -> Option<String> {
    let output = Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args([command, "--help"])
        .output()
        .unwrap();
    output
        .status
        .success()
        .then(|| String::from_utf8(output.stdout).unwrap())
}

#[test]
fn commands_and_options_that_the_pages_name_exist() {
    let (mut helps, mut wrong): (BTreeMap<String, Option<String>>, Vec<String>) =
        (BTreeMap::new(), vec![]);
    for (page, text) in pages()
        .iter()
        .filter(|(page, _)| !page.starts_with("docs/decisions/"))
    {
        for line in code(text) {
            let Some(rest) = line.strip_prefix("wingd ") else {
                continue;
            };
            let words: Vec<&str> = rest.split_whitespace().collect();
            let Some(command) = words
                .first()
                .filter(|w| w.chars().all(|c| c.is_ascii_lowercase() || c == '-'))
            else {
                continue;
            };
            // Code that ends in a space is no command line but the beginning of a text.
            if PACKAGE_COMMANDS.contains(command) && help_of(command).is_none()
                || command.starts_with('-')
                || *command == "help"
                || line.ends_with(' ')
            {
                continue;
            }
            let help = helps
                .entry((*command).to_owned())
                .or_insert_with(|| help_of(command));
            let Some(help) = help else {
                wrong.push(format!("{page}: `{line}`: no such command"));
                continue;
            };
            let options = words
                .iter()
                .map(|w| w.trim_start_matches('[').trim_end_matches(']'));
            for option in options.filter(|w| w.starts_with("--")) {
                let name = option.split('=').next().unwrap_or_default();
                if !help.contains(name) {
                    wrong.push(format!("{page}: `{line}`: no option {name}"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Blocks of figures have the text of their templates, and each figure a command; `make docs-figures` compares the values.
#[test]
fn every_figure_of_the_pages_has_a_command() {
    let script = Path::new(ROOT).join("tests/validation/figures.py");
    let output = Command::new("python3")
        .arg(script)
        .arg("--pages")
        .output()
        .unwrap();
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{printed}");
    let beside = pages().iter().any(|(_, text)| text.contains("<!--figure:"));
    assert!(!beside, "figures are in blocks, not between words");
}

/// Names of the functions and modules of a test binary, or of all of them.
fn names_of_tests(binary: Option<&str>) -> String {
    let mut folders = match binary {
        Some(binary) => vec![Path::new(ROOT).join("tests").join(binary)],
        None => ["src", "crates", "tests"]
            .map(|folder| Path::new(ROOT).join(folder))
            .to_vec(),
    };
    let mut text = String::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                text.push_str(&format!(
                    "mod {}\n",
                    path.file_stem().unwrap().to_string_lossy()
                ));
                text.push_str(&std::fs::read_to_string(path).unwrap());
            }
        }
    }
    text
}

/// Name in a command line of a page that does not exist; `None` if all exist.
fn missing(line: &str, makefile: &str) -> Option<String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    match words.as_slice() {
        ["make", target, ..] if target.chars().all(|c| c.is_ascii_lowercase() || c == '-') => {
            let known = makefile
                .lines()
                .any(|l| l.starts_with(&format!("{target}:")));
            (!known).then(|| "no such target".to_owned())
        }
        ["cargo", "test", rest @ ..] => {
            let after = |flag: &str| rest.iter().skip_while(|w| **w != flag).nth(1).copied();
            let named = |w: &&str| !w.starts_with("--") && *w != "NAME";
            let filter = after("--").filter(named).unwrap_or_default();
            let names = names_of_tests(after("--test").filter(|b| *b != "layers"));
            let known = |part: &str| {
                let mut heads = names.lines().map(str::trim_start);
                heads.any(|l| (l.starts_with("fn ") || l.starts_with("mod ")) && l.contains(part))
            };
            let unknown = filter
                .split("::")
                .find(|part| !part.is_empty() && !known(part));
            unknown.map(|part| format!("no test is called {part}"))
        }
        ["python3", script, ..] | [script, ..]
            if script.ends_with(".py") && script.contains('/') =>
        {
            (!Path::new(ROOT).join(script).exists()).then(|| "no such file".to_owned())
        }
        _ => None,
    }
}

#[test]
fn tests_and_targets_that_the_pages_name_exist() {
    let makefile = std::fs::read_to_string(Path::new(ROOT).join("Makefile")).unwrap();
    let mut wrong = vec![];
    for (page, text) in pages() {
        let lines = code(&text).into_iter();
        wrong.extend(
            lines.filter_map(|l| {
                missing(&l, &makefile).map(|what| format!("{page}: `{l}`: {what}"))
            }),
        );
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
