//! Promise: the output of a command with `--json` conforms to its schema, which is in the package (docs/schema) and
//! describes every field. The schemas are derived from the output: `UPDATE_SCHEMAS=1` writes them.
//!
//! Python's `jsonschema` (Debian: python3-jsonschema) validates; without it these tests fail with a message.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::common::report_store::{solved, store_with};
use crate::program::{fixture, run};

/// Validates every line against a schema, or extends the schema; faults on standard error, exit 1.
const VALIDATOR: &str = include_str!("json_schemas.py");

/// Checks the lines of a command's standard output, or derives the schema from them.
pub fn assert_valid(command: &str, output: &[u8]) {
    let mode = std::env::var_os("UPDATE_SCHEMAS").map(|_| "update");
    let faults = validate(command, output, mode);
    assert!(faults.is_none(), "{command}: {}", faults.unwrap());
}

/// The faults of the lines.
fn validate(command: &str, output: &[u8], mode: Option<&str>) -> Option<String> {
    let schema =
        Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("docs/schema/{command}.schema.json"));
    let mut python = Command::new("python3");
    python
        .args(["-c", VALIDATOR])
        .arg(schema)
        .args(mode)
        .stdin(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = python.spawn().expect("python3 is needed");
    child.stdin.take().unwrap().write_all(output).unwrap();
    let done = child.wait_with_output().unwrap();
    (!done.status.success()).then(|| String::from_utf8_lossy(&done.stderr).into_owned())
}

/// The demo installation, in a writable folder.
fn installation(directory: &Path) -> String {
    let from = fixture("demo/installation");
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        std::fs::copy(entry.path(), directory.join(entry.file_name())).unwrap();
    }
    directory.display().to_string()
}

fn frame(name: &str) -> String {
    fixture("demo/frames").join(name).display().to_string()
}

#[test]
fn output_for_frames_and_an_installation_matches_its_schema() {
    let directory = tempfile::tempdir().unwrap();
    let at = installation(directory.path());
    let (ground, flight) = (frame("ground.jpg"), frame("flight-01.jpg"));
    assert_valid(
        "orient",
        &run(&["orient", "--json", "--installation", &at, &ground]).stdout,
    );
    assert_valid(
        "diagnose",
        &run(&["diagnose", "--json", "--installation", &at, &ground]).stdout,
    );
    assert_valid(
        "diagnose",
        &run(&[
            "diagnose",
            "--joint",
            "--json",
            "--installation",
            &at,
            &flight,
        ])
        .stdout,
    );
    let nothing = directory.path().join("nothing.jpg").display().to_string();
    let images = ["--json", "--installation", &at, &flight, &nothing];
    assert_valid(
        "detect",
        &run(&[&["detect", "--rejected"], &images[..]].concat()).stdout,
    );
    assert_valid("solve", &run(&[&["solve"], &images[..]].concat()).stdout);
    assert_valid(
        "solve",
        &run(&[&["solve", "--method", "profile"], &images[..]].concat()).stdout,
    );
    assert_valid(
        "plan",
        &run(&["plan", "--json", "--installation", &at]).stdout,
    );
    let draft = [
        "--reach",
        "28",
        "--height",
        "2.2",
        "--chord",
        "6",
        "--focal",
        "35",
        "--sensor",
        "6000x4000x3.9",
    ];
    assert_valid(
        "plan",
        &run(&[&["plan", "--json", "--want", "10mm"], &draft[..]].concat()).stdout,
    );
    assert_valid(
        "solve",
        &run(&["solve", "--joint", "--json", "--installation", &at, &flight]).stdout,
    );
    assert_valid(
        "check",
        &run(&["check", "--json", "--installation", &at]).stdout,
    );
    assert_valid(
        "check",
        &run(&["check", "--json", "--installation", &nothing]).stdout,
    );
    assert_valid(
        "mount-check",
        &run(&[
            "mount-check",
            "--json",
            "--installation",
            &at,
            &ground,
            &ground,
        ])
        .stdout,
    );
}

#[test]
fn output_for_a_store_matches_its_schema() {
    let store = store_with(&[&[solved(2.9, 0.006)], &[solved(2.1, 0.006)]]);
    let place = store.path().display().to_string();
    let other = tempfile::tempdir().unwrap();
    let copy = other.path().join("copy").display().to_string();
    assert_valid("verify", &run(&["verify", "--json", &place]).stdout);
    assert_valid("verify", &run(&["copy", "--json", &place, &copy]).stdout);
    let prune = [
        "prune",
        "--json",
        "--dry-run",
        "--keep",
        "0",
        &place,
        "--verified-copy",
        &copy,
    ];
    assert_valid("prune", &run(&prune).stdout);
    let page = other.path().join("report.html").display().to_string();
    let report = ["report", "--json", &place, "--output", &page];
    assert_valid("report", &run(&report).stdout);
}

/// Each command with `--json` has a schema; three share one.
#[test]
fn every_output_has_a_schema() {
    let help = String::from_utf8(run(&["help"]).stdout).unwrap();
    let commands = help
        .lines()
        .filter_map(|line| line.strip_prefix("  ")?.split_once(' '))
        .map(|c| c.0);
    let mut with_json = 0;
    for command in commands.filter(|c| c.starts_with(|first: char| first.is_ascii_lowercase())) {
        let options = String::from_utf8(run(&[command, "--help"]).stdout).unwrap();
        if !options.contains("--json") {
            continue;
        }
        with_json += 1;
        let of = if ["copy", "fetch"].contains(&command) {
            "verify"
        } else {
            command
        };
        let schema =
            Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("docs/schema/{of}.schema.json"));
        assert!(
            schema.is_file(),
            "{command}: {} is missing",
            schema.display()
        );
    }
    assert!(with_json >= 16, "{with_json}");
}

#[test]
fn a_line_that_violates_its_schema_is_a_fault() {
    for line in [
        "{\"ok\":\"yes\",\"found\":{},\"faults\":[]}",
        "{\"ok\":true,\"found\":{},\"faults\":[],\"new\":1}",
    ] {
        assert!(validate("check", line.as_bytes(), None).is_some(), "{line}");
    }
}
