//! Every command line of the pages runs: `sh` blocks and the help's examples here, in the folder left by the
//! tutorial; the lines of `console` blocks by the means that `CONSOLE` names.

use std::os::unix::fs::symlink;
use std::path::Path;

use super::quoted::{missing_lines, shown_output};
use super::running::{Running, copied, free_port, shell, wait};
use super::{Block, ROOT, blocks, pages};

/// Tests that run the `sh` blocks of a page that needs more than this program; that file reads the page.
const BY_OTHERS: [(&str, &str); 1] = [("docs/fleet.md", "python/tests/fleet/test_page.py")];

/// First words of a line of a `console` block, and its test. No other line may occur in one.
const CONSOLE: [(&str, &str); 11] = [
    ("make ", "a target of the Makefile, checked by `named`"),
    (
        "cargo test ",
        "a test that `make test` runs, checked by `named`",
    ),
    (
        "wingd mark ",
        "it serves until it is ended: tests/system/marking.rs, tests/browser/mark.mjs",
    ),
    (
        "wingd orient --installation installation --observations ",
        "manual marks: tests/system/marking.rs",
    ),
    (
        "python3.11 -m venv venv",
        "make fleet-test installs so, in a folder of its own",
    ),
    (
        "wingd time-check store ",
        "photographs of a clock: tests/detect/time_code.rs, tests/validation/time_check.py",
    ),
    ("wingd-fleet modes ", "python/tests/fleet/test_modes.py"),
    (
        "python3 tests/validation/rendered_sets.py ",
        "not run: minutes per set; `named` checks the file",
    ),
    (
        "python3 tests/validation/planned_wings.py ",
        "not run: minutes per wing; `named` checks the file",
    ),
    (
        "python3 tests/validation/detections.py ",
        "not run: its sets take an hour to render; `named` checks the file",
    ),
    (
        "python3 docs/validation/calibration/compare.py ",
        "not run: needs OpenCV and mrcal; `named` checks the file",
    ),
];

/// Only numbers, so that a page's figures are of minutes and its test of seconds.
const SHORTER: [(&str, &str, &str); 2] = [
    ("docs/live/figures.md", "--gusts 5 ", "--gusts 0.3 "),
    ("docs/live/figures.md", "--seconds 60 ", "--seconds 2 "),
];

/// Replaces the machine of the pages by this one, at a free port.
fn localize(page: &str, text: &str, port: u16) -> String {
    let mut text = text
        .replace("0.0.0.0:8080", "127.0.0.1:8080")
        .replace("seat12a.local", "localhost");
    for (_, long, short) in SHORTER.iter().filter(|(of, _, _)| *of == page) {
        text = text.replace(long, short);
    }
    text.replace(":8080", &format!(":{port}"))
}

/// Writes a file whose name is in the first line of the block.
fn write_named(block: &Block, folder: &Path) {
    let named = block
        .text
        .split_once('\n')
        .and_then(|(first, rows)| Some((first.strip_prefix("# ")?, rows)));
    if let Some((name, rows)) =
        named.filter(|(name, _)| ["toml", "csv"].iter().any(|e| name.ends_with(e)))
    {
        std::fs::write(folder.join(name), rows).unwrap();
    }
}

/// Runs the commands of a block of a page, and compares the output with the one shown directly below; `wingd serve` runs
/// until the returned value is dropped.
fn follow_block(
    page: &str,
    block: &Block,
    all: &[Block],
    folder: &Path,
    port: u16,
) -> Option<Running> {
    if block.language != "sh" {
        write_named(block, folder);
        return None;
    }
    let text = localize(page, &block.text, port);
    if text.starts_with("wingd serve ") {
        return Some(Running::serving(folder, text.trim_end(), port));
    }
    let output = shell(folder, &text);
    let messages = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "{page}:{}: {text}\n{messages}",
        block.line
    );
    let printed = format!("{}\n{messages}", String::from_utf8_lossy(&output.stdout));
    let missing = shown_output(block, all).map_or(vec![], |shown| missing_lines(shown, &printed));
    assert!(
        missing.is_empty(),
        "{page}:{}: not printed: {missing:#?}\n{printed}",
        block.line
    );
    None
}

/// Runs the commands of a page, with its files present from the beginning.
fn follow(page: &str, text: &str, folder: &Path) {
    let (blocks, port) = (blocks(text), free_port());
    blocks.iter().for_each(|block| write_named(block, folder));
    let served: Vec<Running> = blocks
        .iter()
        .filter_map(|block| follow_block(page, block, &blocks, folder, port))
        .collect();
    drop(served);
}

/// A copy of the folder, with the files of a clone of the repository.
fn folder_like(first: &Path, folder: &Path) {
    copied(first, folder);
    for name in ["docs", "fixtures", "tests"] {
        symlink(Path::new(ROOT).join(name), folder.join(name)).unwrap();
    }
    std::fs::create_dir(folder.join("target")).unwrap();
    let binaries = Path::new(env!("CARGO_BIN_EXE_wingd")).parent().unwrap();
    symlink(binaries, folder.join("target/release")).unwrap();
}

/// Runs every line to its end.
fn run_all<'a>(lines: impl Iterator<Item = &'a str>, folder: &Path, port: u16) {
    for line in lines {
        let output = shell(folder, &localize("", line, port));
        assert!(
            output.status.success(),
            "{line}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
}

fn examples(wanted: impl Fn(&str) -> bool) -> impl Iterator<Item = &'static str> {
    let listed = wingd::cli::help::listed_commands().into_iter();
    let of = listed.filter(move |command| wanted(&command.name()));
    of.flat_map(|command| command.examples.iter().copied())
}

/// Excluded commands: they ask the recorder or need a page; `time-check` needs images of a clock (tests/validation/time_check.py), and `mark` serves until it is ended (marking).
const RECORDER: [&str; 2] = ["status", "trigger"];
const BESIDE: [&str; 3] = ["serve", "mark", "time-check"];

/// Copies the tutorial's installation and gives it a stiffness, so that its results have every column.
fn add_stiffness(folder: &Path) {
    let stiff = folder.join("stiff");
    std::fs::create_dir(&stiff).unwrap();
    for entry in std::fs::read_dir(folder.join("installation")).unwrap() {
        let file = entry.unwrap();
        std::fs::copy(file.path(), stiff.join(file.file_name())).unwrap();
    }
    let main = stiff.join("installation.toml");
    let text = std::fs::read_to_string(&main).unwrap();
    let structure = "\n[structure]\nstiffness = \"structure.csv\"\n";
    std::fs::write(&main, text + structure).unwrap();
    let sections = "s_m,ei_n_m2,sigma_ei_n_m2\n2,4.0e8,1.2e7\n10,1.6e8,4.8e6\n";
    std::fs::write(stiff.join("structure.csv"), sections).unwrap();
}

/// The tutorial's recorder without its end, in live mode, with signatures and a stiffness of the wing.
fn record(folder: &Path) {
    add_stiffness(folder);
    let configuration = std::fs::read_to_string(folder.join("wingd.toml")).unwrap();
    let configuration = configuration
        .replace("until = \"1s\"\n", "stale_window = 0\n")
        .replace(
            "installation = \"installation\"",
            "installation = \"stiff\"",
        )
        .replace("[store]\n", "[store]\nsigning_key = \"recorder.pem\"\n");
    // A rate that the machine sustains during other tests: otherwise `status` reports it and ends with 1.
    let live = "\n[live]\nrate_hz = 1\nsocket = \"live.sock\"\n";
    std::fs::write(folder.join("recorder.toml"), configuration + live).unwrap();
    let recorder = Running::start(folder, "wingd run --config recorder.toml");
    wait("live results", || folder.join("store/live.rows").exists());
    run_all(examples(|name| RECORDER.contains(&name)), folder, 0);
    recorder.stop();
}

fn follow_examples(folder: &Path) {
    std::fs::create_dir(folder.join("look")).unwrap();
    let port = free_port();
    let serve = examples(|name| name == "serve").next().unwrap();
    let served = Running::serving(folder, &format!("{serve} --listen 127.0.0.1:{port}"), port);
    run_all(
        examples(|name| !RECORDER.contains(&name) && !BESIDE.contains(&name)),
        folder,
        port,
    );
    drop(served);
}

/// User entries stay, and commands that delete report it in JSON too.
fn check_remaining(tutorial: &Path) {
    let again = shell(
        tutorial,
        "wingd init && wingd check --config wingd.toml --json",
    );
    let messages = String::from_utf8(again.stdout).unwrap();
    assert!(
        messages.contains("wingd.toml  exists, not changed"),
        "{messages}"
    );
    let checked: serde_json::Value =
        serde_json::from_str(messages.lines().last().unwrap()).unwrap();
    assert_eq!(
        (&checked["ok"], checked["faults"].as_array().unwrap().len()),
        (&true.into(), 0),
        "{messages}"
    );
    assert!(
        checked["found"]["installation"]
            .as_str()
            .unwrap()
            .contains("25 markers"),
        "{messages}"
    );
    let copied_away = "wingd copy store away --json && wingd prune store --verified-copy away --keep 0 --dry-run --json";
    let messages = String::from_utf8(shell(tutorial, copied_away).stdout).unwrap();
    let objects: Vec<serde_json::Value> = messages
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    assert_eq!(
        (&objects[0]["flights"], &objects[1]["flight"]),
        (&1.into(), &"f0001".into()),
        "{messages}"
    );
    assert_eq!(
        (&objects[1]["deleted"], &objects[1]["reason"]),
        (&false.into(), &().into()),
        "{messages}"
    );
}

/// The page of tables has each exported column, and every column that it names exists.
fn check_tables(folder: &Path) {
    let page =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/tables.md"))
            .unwrap();
    let messages: std::collections::BTreeSet<&str> = page.split('`').skip(1).step_by(2).collect();
    let mut written = std::collections::BTreeSet::new();
    for table in ["shots", "markers", "span", "parameters", "live"] {
        let script = format!("wingd export store --format csv --table {table} --flight f0001");
        let text = String::from_utf8(shell(folder, &script).stdout).unwrap();
        written.extend(text.lines().next().unwrap().split(',').map(general));
    }
    for name in &written {
        let value = name.strip_prefix("sigma_").unwrap_or(name);
        assert!(
            messages.contains(name.as_str()) || messages.contains(value),
            "docs/tables.md lacks {name}"
        );
    }
    let unit = |name: &&&str| {
        ["_m", "_deg", "_px", "_s", "_ms", "_kg", "_hpa"]
            .iter()
            .any(|u| name.ends_with(u))
    };
    // In addition to columns the page has the unit suffixes, and version 1's names as examples.
    let example = |name: &&&str| {
        name.starts_with('_') || ["deflection_31.00564147942904_m", "twist_tip_deg"].contains(name)
    };
    for name in messages.iter().filter(unit).filter(|name| !example(name)) {
        assert!(written.contains(*name), "nothing writes {name}");
    }
}

/// A column's name with a placeholder for the marker, station, pair or number.
fn general(name: &str) -> String {
    let part = |part: &str| match part {
        _ if part.len() == 3 && part.starts_with('s') && part[1..].parse::<u8>().is_ok() => {
            "sNN".to_owned()
        }
        _ if part.len() == 3 && part.starts_with('b') && part[1..].parse::<u8>().is_ok() => {
            "bNN".to_owned()
        }
        _ if part.len() == 3 && part.starts_with('M') && part[1..].parse::<u8>().is_ok() => {
            "ID".to_owned()
        }
        _ if part.parse::<u8>().is_ok() => "N".to_owned(),
        _ => part.to_owned(),
    };
    let parts: Vec<String> = name.split('_').map(part).collect();
    match parts.first().map(String::as_str) {
        Some("torsion") => format!("torsion_PAIR_{}", parts[2..].join("_")),
        _ => parts.join("_"),
    }
}

/// The reader of the store's page gives the export's numbers, of a packed column and of one that is not.
fn check_column(folder: &Path) {
    let printed = |script: &str| String::from_utf8(shell(folder, script).stdout).unwrap();
    let table = printed("wingd export store --format csv --table live --flight f0001");
    let mut lines = table.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    assert!(!rows.is_empty());
    for (column, exported) in [("since_boot", "since_boot_s"), ("number", "number")] {
        let read = printed(&format!(
            "python3 docs/store/column.py store/flights/f0001/live-000001.rows {column}"
        ));
        let read: Vec<f64> = read.lines().map(|value| value.parse().unwrap()).collect();
        let at = names.iter().position(|name| *name == exported).unwrap();
        let wanted: Vec<f64> = rows.iter().map(|row| row[at].parse().unwrap()).collect();
        assert_eq!(read, wanted, "{column}");
    }
}

#[test]
fn every_command_of_the_pages_runs_after_the_tutorial() {
    let folder = tempfile::tempdir().unwrap();
    let tutorial = folder.path().join("tutorial");
    std::fs::create_dir(&tutorial).unwrap();
    let pages = pages();
    let is_tutorial = |page: &str| page == "docs/tutorial.md";
    let (page, text) = pages.iter().find(|(page, _)| is_tutorial(page)).unwrap();
    let steps = blocks(text);
    steps
        .iter()
        .for_each(|block| assert!(follow_block(page, block, &steps, &tutorial, 0).is_none()));
    assert!(tutorial.join("report.html").exists());
    check_remaining(&tutorial);
    record(&tutorial);
    let inputs = ["docs/stress.md", "docs/aircraft-data.md"];
    let examples = folder.path().join("examples");
    folder_like(&tutorial, &examples);
    for (page, text) in pages
        .iter()
        .filter(|(page, _)| inputs.contains(&page.as_str()))
    {
        follow(page, text, &examples);
    }
    follow_examples(&examples);
    let elsewhere =
        |page: &str| is_tutorial(page) || BY_OTHERS.iter().any(|(other, _)| *other == page);
    for (number, (page, text)) in pages
        .iter()
        .enumerate()
        .filter(|(_, (page, _))| !elsewhere(page))
    {
        if blocks(text).iter().any(|block| block.language == "sh") {
            let own = folder.path().join(number.to_string());
            folder_like(&tutorial, &own);
            follow(page, text, &own);
            match page.as_str() {
                "docs/store.md" => check_column(&own),
                "docs/tables.md" => check_tables(&own),
                _ => {}
            }
        }
    }
}

#[test]
fn commands_that_do_not_run_here_have_another_named_test() {
    let pages = pages();
    for (page, file) in BY_OTHERS {
        let runner = std::fs::read_to_string(Path::new(ROOT).join(file)).unwrap();
        assert!(
            runner.contains(page) && runner.contains("```sh"),
            "{file} does not read {page}"
        );
    }
    let mut wrong = vec![];
    for (page, text) in &pages {
        for block in blocks(text) {
            match block.language.as_str() {
                "sh" | "toml" | "csv" | "json" | "text" | "rust" | "python" | "matlab" => {}
                "console" => wrong.extend(
                    block
                        .lines()
                        .into_iter()
                        .filter(|line| !CONSOLE.iter().any(|(begins, _)| line.starts_with(begins)))
                        .map(|line| format!("{page}:{}: nothing runs `{line}`", block.line)),
                ),
                other => wrong.push(format!(
                    "{page}:{}: unknown block type `{other}`",
                    block.line
                )),
            }
        }
    }
    for (page, long, _) in SHORTER {
        let text = &pages.iter().find(|(name, _)| name == page).unwrap().1;
        if !text.contains(long) {
            wrong.push(format!("{page}: `{long}` is no longer there"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
