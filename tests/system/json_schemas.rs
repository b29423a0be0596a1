//! Promise: the output of a command with `--json` conforms to its schema, which is in the package (docs/schema) and
//! describes every field.
//!
//! Python's `jsonschema` (Debian: python3-jsonschema) validates; without it these tests fail with a message.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::common::report_store::{solved, store_with};
use crate::program::{fixture, run};

/// Validates every line against a schema; faults on standard error, exit 1.
const VALIDATOR: &str = "
import json, sys
try:
    import jsonschema
except ImportError:
    sys.exit('jsonschema is missing: install the Debian package python3-jsonschema')

def undescribed(schema, value, path):
    if isinstance(value, list):
        for one in value:
            yield from undescribed(schema.get('items', {}), one, path + '[]')
    if isinstance(value, dict) and 'properties' in schema:
        others = schema.get('additionalProperties')
        for key, one in value.items():
            own = schema['properties'].get(key, others)
            if own is None and 'patternProperties' not in schema:
                yield path + '.' + key
            elif isinstance(own, dict):
                yield from undescribed(own, one, path + '.' + key)

schema = json.load(open(sys.argv[1]))
jsonschema.Draft202012Validator.check_schema(schema)
validator = jsonschema.Draft202012Validator(schema)
lines = [json.loads(line) for line in sys.stdin.read().splitlines() if line.strip()]
faults = [f'line {k + 1}: {e.json_path}: {e.message[:300]}' for k, line in enumerate(lines) for e in validator.iter_errors(line)]
faults += [f'not in the schema: {one}' for one in sorted({one for line in lines for one in undescribed(schema, line, '')})]
sys.exit('\\n'.join(faults) or (0 if lines else 'no line'))
";

/// Checks the lines of a command's standard output.
pub fn assert_valid(command: &str, output: &[u8]) {
    let schema =
        Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("docs/schema/{command}.schema.json"));
    let mut python = Command::new("python3");
    python
        .args(["-c", VALIDATOR])
        .arg(schema)
        .stdin(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = python.spawn().expect("python3 is needed");
    child.stdin.take().unwrap().write_all(output).unwrap();
    let done = child.wait_with_output().unwrap();
    assert!(
        done.status.success(),
        "{command}: {}",
        String::from_utf8_lossy(&done.stderr)
    );
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
        let broken = std::panic::catch_unwind(|| assert_valid("check", line.as_bytes()));
        assert!(broken.is_err(), "{line}");
    }
}
