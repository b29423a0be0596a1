//! The pages' own commands: every `sh` block of README and docs runs, in the folder that the tutorial leaves; what the
//! text names besides exists.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// A fenced block.
struct Block {
    language: String,
    line: usize,
    text: String,
}

fn blocks(text: &str) -> Vec<Block> {
    let (mut all, mut open): (Vec<Block>, Option<Block>) = (vec![], None);
    for (number, line) in text.lines().enumerate() {
        match (line.trim_start().strip_prefix("```"), open.take()) {
            (Some(_), Some(block)) => all.push(block),
            (Some(language), None) => {
                let language = language.trim().to_owned();
                open = Some(Block { language, line: number + 1, text: String::new() });
            }
            (None, Some(mut block)) => {
                block.text.push_str(line);
                block.text.push('\n');
                open = Some(block);
            }
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "a block does not end");
    all
}

/// README and every page, decisions too, by their path below the root.
fn pages() -> Vec<(String, String)> {
    let mut all = vec![PathBuf::from("README.md")];
    let mut folders = vec![PathBuf::from("docs")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(Path::new(ROOT).join(&folder)).unwrap() {
            let entry = entry.unwrap();
            let path = folder.join(entry.file_name());
            match path.extension() {
                _ if entry.path().is_dir() => folders.push(path),
                Some(ending) if ending == "md" => all.push(path),
                _ => {}
            }
        }
    }
    all.sort();
    let read = |path: PathBuf| {
        let text = std::fs::read_to_string(Path::new(ROOT).join(&path)).unwrap();
        (path.display().to_string(), text)
    };
    all.into_iter().map(read).collect()
}

fn shell(folder: &Path, script: &str) -> Output {
    let binaries = Path::new(env!("CARGO_BIN_EXE_wingd")).parent().unwrap().to_owned();
    let path = format!("{}:{}", binaries.display(), std::env::var("PATH").unwrap());
    let mut command = Command::new("timeout");
    command.args(["120", "sh", "-e", "-u", "-c", script]).current_dir(folder).env("PATH", path);
    command.output().unwrap()
}

/// Writes a file whose name stands in the block's first line.
fn write_named(block: &Block, folder: &Path) {
    let named = block.text.split_once('\n').and_then(|(first, rows)| Some((first.strip_prefix("# ")?, rows)));
    if let Some((name, rows)) = named.filter(|(name, _)| ["toml", "csv"].iter().any(|e| name.ends_with(e))) {
        std::fs::write(folder.join(name), rows).unwrap();
    }
}

fn follow_block(page: &str, block: &Block, folder: &Path) {
    if block.language == "sh" {
        let output = shell(folder, &block.text);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{page}:{}: {}\n{said}", block.line, block.text);
    } else {
        write_named(block, folder);
    }
}

/// Does what a page says, with its files there from the beginning.
fn follow(page: &str, text: &str, folder: &Path) {
    let blocks = blocks(text);
    blocks.iter().for_each(|block| write_named(block, folder));
    blocks.iter().for_each(|block| follow_block(page, block, folder));
}

fn copied(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copied(&entry.path(), &target);
        } else if entry.file_type().unwrap().is_file() {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Examples of the help that need a running recorder or page, another feature, or more than a folder: what runs them.
const ELSEWHERE: [(&str, &str); 8] = [
    ("status", "daemon_replay"),
    ("trigger", "daemon_replay"),
    ("serve", "http_pages"),
    ("fetch", "http_fetch"),
    ("upload", "make fleet-test"),
    ("demo", "make demo"),
    ("time-check", "tests/validation/time_check.py"),
    ("run", "the tutorial"),
];

/// The help's examples, in the folder that the tutorial and the pages leave.
fn follow_examples(folder: &Path) {
    std::fs::create_dir(folder.join("look")).unwrap();
    for (name, lines) in wingd::cli::help::EXAMPLES {
        if ELSEWHERE.iter().any(|(elsewhere, _)| elsewhere == name) {
            continue;
        }
        for line in *lines {
            let output = shell(folder, line);
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{line}: {said}");
        }
    }
}

#[test]
fn every_command_of_the_pages_runs_where_the_tutorial_ends() {
    let folder = tempfile::tempdir().unwrap();
    let tutorial = folder.path().join("tutorial");
    std::fs::create_dir(&tutorial).unwrap();
    let pages = pages();
    let is_tutorial = |page: &str| page == "docs/tutorial.md";
    let (page, text) = pages.iter().find(|(page, _)| is_tutorial(page)).unwrap();
    blocks(text).iter().for_each(|block| follow_block(page, block, &tutorial));
    assert!(tutorial.join("report.html").exists());
    // What a user has filled in stays.
    let again = shell(&tutorial, "wingd init && wingd check --config wingd.toml --json");
    let said = String::from_utf8(again.stdout).unwrap();
    assert!(said.contains("wingd.toml  is there already, left as it is"), "{said}");
    let checked: serde_json::Value = serde_json::from_str(said.lines().last().unwrap()).unwrap();
    assert_eq!((&checked["ok"], checked["faults"].as_array().unwrap().len()), (&true.into(), 0), "{said}");
    assert!(checked["found"]["installation"].as_str().unwrap().contains("24 markers"), "{said}");
    let copied_away =
        "wingd copy store away --json && wingd prune store --verified-copy away --keep 0 --dry-run --json";
    let said = String::from_utf8(shell(&tutorial, copied_away).stdout).unwrap();
    let objects: Vec<serde_json::Value> = said.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!((&objects[0]["flights"], &objects[1]["flight"]), (&1.into(), &"f0001".into()), "{said}");
    assert_eq!((&objects[1]["deleted"], &objects[1]["reason"]), (&false.into(), &().into()), "{said}");
    let inputs = ["docs/stress.md", "docs/aircraft-data.md"];
    let examples = folder.path().join("examples");
    copied(&tutorial, &examples);
    for (page, text) in pages.iter().filter(|(page, _)| inputs.contains(&page.as_str())) {
        follow(page, text, &examples);
    }
    follow_examples(&examples);
    for (number, (page, text)) in pages.iter().enumerate().filter(|(_, (page, _))| !is_tutorial(page)) {
        if blocks(text).iter().any(|block| block.language == "sh") {
            let own = folder.path().join(number.to_string());
            copied(&tutorial, &own);
            follow(page, text, &own);
        }
    }
}

/// What a command's own help says; `None` where there is no such command.
fn help_of(command: &str) -> Option<String> {
    let output = Command::new(env!("CARGO_BIN_EXE_wingd")).args([command, "--help"]).output().unwrap();
    output.status.success().then(|| String::from_utf8(output.stdout).unwrap())
}

/// Lines of blocks, and code within the text.
fn code(text: &str) -> Vec<String> {
    let mut all: Vec<String> = vec![];
    let mut inside = false;
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            inside = !inside;
        } else if inside {
            all.push(line.split(" #").next().unwrap_or_default().trim().to_owned());
        } else {
            all.extend(line.split('`').skip(1).step_by(2).map(str::to_owned));
        }
    }
    all
}

/// Built with a feature that this program may lack.
const OPTIONAL: [&str; 1] = ["upload"];

#[test]
fn commands_and_options_that_the_pages_name_exist() {
    let (mut helps, mut wrong): (BTreeMap<String, Option<String>>, Vec<String>) = (BTreeMap::new(), vec![]);
    for (page, text) in pages().iter().filter(|(page, _)| !page.starts_with("docs/decisions/")) {
        for line in code(text) {
            let Some(rest) = line.strip_prefix("wingd ") else { continue };
            let words: Vec<&str> = rest.split_whitespace().collect();
            let Some(command) =
                words.first().filter(|w| w.chars().all(|c| c.is_ascii_lowercase() || c == '-'))
            else {
                continue;
            };
            // What ends in a space is no command line but the beginning of a text.
            if OPTIONAL.contains(command)
                || command.starts_with('-')
                || *command == "help"
                || line.ends_with(' ')
            {
                continue;
            }
            let help = helps.entry((*command).to_owned()).or_insert_with(|| help_of(command));
            let Some(help) = help else {
                wrong.push(format!("{page}: `{line}`: no such command"));
                continue;
            };
            let options = words.iter().map(|w| w.trim_start_matches('[').trim_end_matches(']'));
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

/// The names of the functions and modules of a test binary, or of all of them.
fn names_of_tests(binary: Option<&str>) -> String {
    let mut folders = match binary {
        Some(binary) => vec![Path::new(ROOT).join("tests").join(binary)],
        None => vec![Path::new(ROOT).join("src"), Path::new(ROOT).join("tests")],
    };
    let mut text = String::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                text.push_str(&format!("mod {}\n", path.file_stem().unwrap().to_string_lossy()));
                text.push_str(&std::fs::read_to_string(path).unwrap());
            }
        }
    }
    text
}

/// What a command line of a page names that is not there; `None` where all is.
fn missing(line: &str, makefile: &str) -> Option<String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    match words.as_slice() {
        ["make", target, ..] if target.chars().all(|c| c.is_ascii_lowercase() || c == '-') => {
            let known = makefile.lines().any(|l| l.starts_with(&format!("{target}:")));
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
            let unknown = filter.split("::").find(|part| !part.is_empty() && !known(part));
            unknown.map(|part| format!("no test is called {part}"))
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
            lines.filter_map(|l| missing(&l, &makefile).map(|what| format!("{page}: `{l}`: {what}"))),
        );
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A heading as a link names it.
fn anchor(heading: &str) -> String {
    let kept = heading
        .to_lowercase()
        .chars()
        .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
        .collect::<String>();
    kept.trim().replace(' ', "-")
}

#[test]
fn links_lead_somewhere_and_every_page_is_in_the_book() {
    let pages = pages();
    let summary = &pages.iter().find(|(page, _)| page == "docs/SUMMARY.md").unwrap().1;
    let mut wrong = vec![];
    for (page, text) in &pages {
        let folder = Path::new(page).parent().unwrap();
        let targets = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        for target in targets.filter(|t| !t.contains("://") && !t.contains(' ')) {
            let (file, place) = target.split_once('#').unwrap_or((target, ""));
            let path = if file.is_empty() { PathBuf::from(page) } else { folder.join(file) };
            let found = Path::new(ROOT).join(&path);
            let there = found.exists();
            let text = if there && !place.is_empty() {
                std::fs::read_to_string(&found).unwrap_or_default()
            } else {
                String::new()
            };
            let headed = |l: &str| l.starts_with('#') && anchor(l.trim_start_matches('#')) == place;
            if !there || !place.is_empty() && !text.lines().any(headed) {
                wrong.push(format!("{page}: {target}"));
            }
        }
        let listed = page.strip_prefix("docs/").filter(|name| *name != "SUMMARY.md");
        if let Some(name) = listed.filter(|name| !summary.contains(&format!("({name})"))) {
            wrong.push(format!("docs/SUMMARY.md does not list {name}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Words a page may have, and a paragraph, which a reader takes in at once.
const LONGEST_PAGE: usize = 3000;
const LONGEST_PARAGRAPH: usize = 120;

#[test]
fn no_page_and_no_paragraph_is_too_long_to_read() {
    let mut wrong = vec![];
    for (page, text) in pages() {
        let words = text.split_whitespace().count();
        if words > LONGEST_PAGE {
            wrong.push(format!("{page}: {words} words"));
        }
        let mut inside = false;
        let mut words = 0;
        for (number, line) in text.lines().chain([""]).enumerate() {
            let line = line.trim_start();
            inside ^= line.starts_with("```");
            let item = |l: &str| l.trim_start_matches(|c: char| c.is_ascii_digit()).starts_with(". ");
            let aside =
                inside || line.is_empty() || ["|", "#", "```"].iter().any(|mark| line.starts_with(mark));
            let begins = aside || line.starts_with("- ") || line.starts_with("* ") || item(line);
            if begins {
                if words > LONGEST_PARAGRAPH {
                    wrong.push(format!("{page}:{number}: a paragraph of {words} words"));
                }
                words = 0;
            }
            words += if aside { 0 } else { line.split_whitespace().count() };
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
