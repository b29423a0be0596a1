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

/// Names of the figures between markers, and whether each marker has its end in the same line.
fn figures(text: &str) -> Vec<(String, bool)> {
    let begun = text
        .lines()
        .flat_map(|line| line.split("<!--figure:").skip(1));
    begun
        .map(|rest| {
            let (name, content) = rest.split_once("-->").unwrap_or((rest, ""));
            (
                name.to_owned(),
                content.contains("<!--end-->") && !content.starts_with('?'),
            )
        })
        .collect()
}

#[test]
fn every_figure_of_the_pages_has_a_command() {
    let script = Path::new(ROOT).join("tests/validation/figures.py");
    let names = Command::new("python3")
        .arg(script)
        .arg("--names")
        .output()
        .unwrap();
    let names: Vec<String> = String::from_utf8(names.stdout)
        .unwrap()
        .lines()
        .map(str::to_owned)
        .collect();
    let pages = pages();
    let all: Vec<_> = pages
        .iter()
        .flat_map(|(page, text)| figures(text).into_iter().map(move |f| (page, f)))
        .collect();
    let wrong: Vec<String> = all
        .iter()
        .filter(|(_, (name, ended))| !ended || !names.contains(name))
        .map(|(page, (name, _))| {
            format!("{page}: {name} is not written, or no figure of tests/validation/figures.py")
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let unused: Vec<&String> = names
        .iter()
        .filter(|name| !all.iter().any(|(_, (used, _))| used == *name))
        .collect();
    assert!(
        unused.is_empty() && names.len() > 50,
        "figures that no page shows: {unused:?} of {}",
        names.len()
    );
    assert_eq!(
        figures("| <!--figure:a-->1<!--end--> | <!--figure:b-->?<!--end--> |"),
        [("a".to_owned(), true), ("b".to_owned(), false)]
    );
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
