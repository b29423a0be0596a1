//! Promise: what a command prints with `--json` holds to its schema, which is in the package (docs/schema).
//!
//! Python's `jsonschema` (Debian: python3-jsonschema) validates; without it these tests fail and say so.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use wingd::measure::render::{SeededRandom, SensorModel};

use crate::common::clock_screen::{BEGIN_S, Display, photograph};
use crate::common::report_store::{solved, store_with};
use crate::program::{fixture, run};

/// Every line against a schema; faults on standard error, exit 1.
const VALIDATOR: &str = "
import json, sys
try:
    import jsonschema
except ImportError:
    sys.exit('jsonschema is missing: install the Debian package python3-jsonschema')
schema = json.load(open(sys.argv[1]))
jsonschema.Draft202012Validator.check_schema(schema)
validator = jsonschema.Draft202012Validator(schema)
lines = [line for line in sys.stdin.read().splitlines() if line.strip()]
faults = [f'line {k + 1}: {e.json_path}: {e.message[:300]}' for k, line in enumerate(lines) for e in validator.iter_errors(json.loads(line))]
sys.exit('\\n'.join(faults) or (0 if lines else 'no line'))
";

/// Checks the lines of a command's standard output.
pub fn holds(command: &str, output: &[u8]) {
    let schema = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("docs/schema/{command}.schema.json"));
    let mut python = Command::new("python3");
    python.args(["-c", VALIDATOR]).arg(schema).stdin(Stdio::piped()).stderr(Stdio::piped());
    let mut child = python.spawn().expect("python3 is needed");
    child.stdin.take().unwrap().write_all(output).unwrap();
    let done = child.wait_with_output().unwrap();
    assert!(done.status.success(), "{command}: {}", String::from_utf8_lossy(&done.stderr));
}

/// The demonstration's installation, in a folder that may be written to.
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
fn of_frames_and_an_installation() {
    let directory = tempfile::tempdir().unwrap();
    let at = installation(directory.path());
    let (ground, flight) = (frame("ground.jpg"), frame("flight-01.jpg"));
    holds("orient", &run(&["orient", "--json", "--installation", &at, &ground]).stdout);
    let nothing = directory.path().join("nothing.jpg").display().to_string();
    let images = ["--json", "--installation", &at, &flight, &nothing];
    holds("detect", &run(&[&["detect", "--rejected"], &images[..]].concat()).stdout);
    holds("solve", &run(&[&["solve"], &images[..]].concat()).stdout);
    holds("solve", &run(&[&["solve", "--method", "profile"], &images[..]].concat()).stdout);
    holds("plan", &run(&["plan", "--json", "--installation", &at]).stdout);
    holds("check", &run(&["check", "--json", "--installation", &at]).stdout);
    holds("check", &run(&["check", "--json", "--installation", &nothing]).stdout);
    holds("mount-check", &run(&["mount-check", "--json", "--installation", &at, &ground, &ground]).stdout);
}

#[test]
fn of_a_store() {
    let store = store_with(&[&[solved(2.9, 0.006)], &[solved(2.1, 0.006)]]);
    let place = store.path().display().to_string();
    let other = tempfile::tempdir().unwrap();
    let copy = other.path().join("copy").display().to_string();
    holds("verify", &run(&["verify", "--json", &place]).stdout);
    holds("verify", &run(&["copy", "--json", &place, &copy]).stdout);
    let prune = ["prune", "--json", "--dry-run", "--keep", "0", &place, "--verified-copy", &copy];
    holds("prune", &run(&prune).stdout);
}

/// Two pictures of the clock, and one of nothing.
#[test]
fn of_a_clock_on_a_screen() {
    let directory = tempfile::tempdir().unwrap();
    let random = &mut SeededRandom::new(1, 31);
    let display = Display { refresh_s: 1.0 / 60.0, latency_s: 0.03, phase_s: random.unit() };
    for k in 0..2_u32 {
        let shares = display.shares(BEGIN_S + f64::from(k), 0.004);
        let picture = photograph(&shares, &SensorModel::default(), 0.7, random);
        let (width, height) = (picture.width() as u32, picture.height() as u32);
        let file = directory.path().join(format!("{k}.png"));
        image::GrayImage::from_raw(width, height, picture.luma().to_vec()).unwrap().save(file).unwrap();
    }
    image::GrayImage::new(640, 480).save(directory.path().join("2.png")).unwrap();
    let pictures = directory.path().display().to_string();
    let place = directory.path().join("store").display().to_string();
    let begin = jiff::Timestamp::from_second(BEGIN_S as i64).unwrap().to_string();
    let import = ["import", "--json", "--store", &place, "--start", &begin, "--every", "1s", &pictures];
    holds("import", &run(&import).stdout);
    let read = run(&["time-check", "--json", &place]).stdout;
    holds("time-check", &read);
    let read = String::from_utf8(read).unwrap();
    assert!(read.matches("\"ok\"").count() == 2 && read.contains("\"summary\""), "{read}");
    let table = String::from_utf8(run(&["time-check", &place]).stdout).unwrap();
    let rule = table.lines().find(|line| line.starts_with("---")).unwrap();
    assert!(rule.len() <= 80, "{table}");
}

/// `make fleet-test` builds the program with `upload`.
#[cfg(feature = "upload")]
#[test]
fn of_an_upload() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let (place, lake) = (store.path().display().to_string(), tempfile::tempdir().unwrap());
    let to = format!("file://{}", lake.path().display());
    holds("upload", &run(&["upload", "--json", &place, "--to", &to, "--aircraft", "D-ABCD"]).stdout);
}

/// Each command that has `--json` has a schema; three share one.
#[test]
fn none_is_without_a_schema() {
    let help = String::from_utf8(run(&["help"]).stdout).unwrap();
    let commands = help.lines().filter_map(|line| line.strip_prefix("  ")?.split_once(' ')).map(|c| c.0);
    let mut with_json = 0;
    for command in commands.filter(|c| c.starts_with(|first: char| first.is_ascii_lowercase())) {
        let options = String::from_utf8(run(&[command, "--help"]).stdout).unwrap();
        if !options.contains("--json") {
            continue;
        }
        with_json += 1;
        let of = if ["copy", "fetch"].contains(&command) { "verify" } else { command };
        let schema = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("docs/schema/{of}.schema.json"));
        assert!(schema.is_file(), "{command}: {} is missing", schema.display());
    }
    assert!(with_json >= 16, "{with_json}");
}

#[test]
fn a_line_that_does_not_hold_is_a_fault() {
    let broken =
        std::panic::catch_unwind(|| holds("check", b"{\"ok\":\"yes\",\"found\":{},\"faults\":[]}\n"));
    assert!(broken.is_err());
}
