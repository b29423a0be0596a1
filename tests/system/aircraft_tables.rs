//! Promise: the canonical table of aircraft data and lines of IWG1 are read, or refused with the cause; an imported table can
//! be corrected, extended and withdrawn, and the store keeps everything (docs/aircraft-data.md).

use std::path::Path;
use std::sync::OnceLock;

use serde_json::Value;
use wingd::store::RealDisk;
use wingd::store::verify::verify_path;

use crate::program::{fixture, outcome, run, stdout};

/// The demo store, made once: f0001 has ten shots, two of them at 8 o'clock, the time of the tables.
fn demo() -> &'static Path {
    static STORE: OnceLock<tempfile::TempDir> = OnceLock::new();
    STORE
        .get_or_init(|| {
            let dir = tempfile::tempdir().unwrap();
            stdout(&[
                "demo",
                "--output",
                &dir.path().join("demo").to_string_lossy(),
            ]);
            dir
        })
        .path()
}

/// A copy of the demo store.
fn store(to: &Path) -> String {
    let copied = std::process::Command::new("cp")
        .arg("-r")
        .arg(demo().join("demo/store"))
        .arg(to)
        .status();
    assert!(copied.unwrap().success());
    to.join("store").to_string_lossy().into_owned()
}

fn table(name: &str) -> String {
    fixture("tables").join(name).to_string_lossy().into_owned()
}

/// Exit status, standard output, and messages.
fn import_table(store: &str, file: &str) -> (Option<i32>, Value, String) {
    let done = run(&["aircraft-data", store, file, "--flight", "f0001", "--json"]);
    let answer = serde_json::from_slice(&done.stdout).unwrap_or_default();
    (
        done.status.code(),
        answer,
        String::from_utf8(done.stderr).unwrap(),
    )
}

fn frames(answer: &Value, quantity: &str) -> u64 {
    let all = answer["quantities"].as_array().unwrap();
    all.iter().find(|q| q["quantity"] == quantity).unwrap()["frames"]
        .as_u64()
        .unwrap()
}

/// A quantity at the flight's first frames: value and source.
fn joined(store: &str, quantity: &str) -> Option<(f64, u64)> {
    let lines = stdout(&["export", store, "--format", "jsonl"]);
    let first: Value = serde_json::from_str(lines.lines().next().unwrap()).unwrap();
    let joined_value = &first["aircraft"][quantity];
    Some((
        joined_value["value"].as_f64()?,
        joined_value["source"].as_u64()?,
    ))
}

/// Two minutes of a table around the flight's first frames, which are at 8 o'clock.
fn minutes(header: &str, cells: &str) -> String {
    let time = |k: u32| {
        format!(
            "2026-06-01T{:02}:{:02}:{:02}Z",
            7 + (3590 + k) / 3600,
            (3590 + k) / 60 % 60,
            (3590 + k) % 60
        )
    };
    let rows = (0..120).map(|k| format!("{},{cells}\n", time(k)));
    format!("{header}\n{}", rows.collect::<String>())
}

/// A store with a file for its tables.
struct Desk {
    dir: tempfile::TempDir,
    store: String,
}

impl Desk {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let store = store(dir.path());
        Self { dir, store }
    }

    fn import(&self, text: &str) -> (Option<i32>, Value, String) {
        let file = self.dir.path().join("qar.csv");
        std::fs::write(&file, text).unwrap();
        import_table(&self.store, &file.to_string_lossy())
    }
}

#[test]
fn the_canonical_table_is_read_and_its_other_columns_are_named() {
    let desk = Desk::new();
    let text = minutes(
        "utc,phase,pressure_altitude_m,mach",
        "\"climb, flaps\",10668,0.78",
    );
    let (status, answer, printed) = desk.import(&text);
    assert_eq!(
        (status, &answer["read"]),
        (Some(0), &120.into()),
        "{printed}"
    );
    assert_eq!(
        (
            frames(&answer, "mach"),
            frames(&answer, "pressure_altitude_m")
        ),
        (2, 2)
    );
    assert_eq!(joined(&desk.store, "mach"), Some((0.78, 1)));
    assert!(
        printed.contains("columns that are not read: phase"),
        "{printed}"
    );
    assert!(verify_path(&RealDisk, Path::new(&desk.store)).is_sound());
}

#[test]
fn tables_that_are_not_canonical_are_refused_with_the_cause() {
    let desk = Desk::new();
    for (text, status, cause) in [
        (
            minutes("utc,Mach", "0.78"),
            78,
            "column Mach: is not read, but mach is; write mach",
        ),
        (
            minutes("utc,weight_t", "71.5"),
            78,
            "column weight_t: is not read, but weight_kg is",
        ),
        (
            minutes("utc,sigma_mach", "0.1"),
            78,
            "column sigma_mach: is a standard deviation that is not read",
        ),
        (
            minutes("UTC,mach", "0.78"),
            78,
            "has capital letters in the header",
        ),
        (minutes("time,mach", "0.78"), 78, "column utc: is missing"),
        (minutes("utc,phase", "climb"), 78, "has no quantity"),
        (
            minutes("utc,mach,mach", "0.78,0.78"),
            78,
            "column mach: occurs twice",
        ),
        (
            minutes("utc,mach", "0.78").replace(',', ";"),
            78,
            "is separated by semicolons",
        ),
        (
            minutes("utc,mach,weight_kg", "0,78,71500"),
            78,
            "has 4 cells under a header of 3",
        ),
        ("PK\u{3}\u{4}\u{14}\0".to_owned(), 78, "a spreadsheet file"),
        (minutes("utc,mach", "NCD"), 1, "mach cannot be NCD"),
        (minutes("utc,mach", "780"), 1, "mach cannot be 780"),
        (
            minutes("utc,mach", "0.78").replace("2026-06-01T", "2026-06-02T"),
            1,
            "its times are 2026-06-02T07:59:50Z",
        ),
        (
            minutes("utc,mach", "0.78").replace("2026-06-01T", "01.06. "),
            1,
            "are not UTC",
        ),
        (
            minutes("utc,mach", "0.78").replace("2026-06-01T", "2026-152T"),
            1,
            "its times (\"2026-152T07:59:50Z\") are not UTC; write them as 2026-06-01T07:59:50Z",
        ),
        (
            minutes("utc,mach", "0.78").replace("Z,", "+01:00,"),
            1,
            "no line with a value is within 5 s of a frame: its times are 2026-06-01T06:59:50Z",
        ),
        ("utc,mach\n".to_owned(), 1, "no lines below its header"),
    ] {
        let (found, answer, printed) = desk.import(&text);
        assert!(
            found == Some(status) && answer["source"].is_null() && printed.contains(cause),
            "{cause}: {printed}"
        );
    }
    let list = stdout(&["aircraft-data", &desk.store, "--flight", "f0001", "--list"]);
    assert!(list.contains("0 sources"), "{list}");
}

#[test]
fn lines_of_iwg1_are_read_if_each_is_one_record_of_as_many_fields() {
    let desk = Desk::new();
    let sound = std::fs::read_to_string(table("n-iwg1-noheader.txt")).unwrap();
    let glued = std::fs::read_to_string(table("o-iwg1-glued.txt")).unwrap();
    let two_each = sound.replace("\nIWG1", "IWG1");
    for (text, cause) in [
        (
            sound.replacen(",38.1,", ",", 2),
            "line 3: is not one record of 32 fields",
        ),
        (
            sound.replacen("08:00:00,", "08:00:00,,", 1),
            "line 11: is not one record of 33 fields",
        ),
        (two_each, "line 1: is not one record of"),
        (glued, "line 1: is not one record of 33 fields"),
    ] {
        let (status, answer, printed) = desk.import(&text);
        assert!(
            status == Some(78)
                && answer.is_null()
                && printed.contains(cause)
                && printed.contains("wingd-table"),
            "{cause}: {printed}"
        );
    }
    let (status, answer, printed) = desk.import(&sound);
    assert_eq!(
        (status, &answer["read"], frames(&answer, "mach")),
        (Some(0), &120.into(), 2),
        "{printed}"
    );
    let altitude = joined(&desk.store, "pressure_altitude_m").unwrap().0;
    assert!((altitude - 10_668.0).abs() < 1e-6);
}

#[test]
fn a_corrected_table_counts_more_quantities_join_and_a_source_can_be_withdrawn() {
    let desk = Desk::new();
    let (dir, store) = (&desk.dir, desk.store.clone());
    let altitude =
        || joined(&store, "pressure_altitude_m").map(|(value, source)| (value.round(), source));
    let wrong = minutes("utc,pressure_altitude_m", "1066.8");
    assert_eq!(desk.import(&wrong).0, Some(0));
    assert_eq!(
        (altitude(), joined(&store, "mach")),
        (Some((1067.0, 1)), None)
    );
    let (status, answer, _) = desk.import(&minutes("utc,pressure_altitude_m", "10668"));
    crate::json_schemas::assert_valid("aircraft-data", answer.to_string().as_bytes());
    assert_eq!(
        (status, &answer["quantities"][0]["frames"]),
        (Some(0), &2.into()),
        "{answer}"
    );
    assert_eq!(altitude(), Some((10_668.0, 2)), "the corrected one counts");
    let both = minutes("utc,pressure_altitude_m,mach", "10668,0.78");
    assert_eq!(desk.import(&both).0, Some(0));
    assert_eq!(
        (altitude(), joined(&store, "mach")),
        (Some((10_668.0, 3)), Some((0.78, 3)))
    );

    let withdraw = |source: &str| {
        outcome(&[
            "aircraft-data",
            &store,
            "--flight",
            "f0001",
            "--withdraw",
            source,
        ])
    };
    for source in ["3", "2"] {
        let (status, printed) = withdraw(source);
        assert!(
            status == Some(0) && printed.contains("is no longer used"),
            "{printed}"
        );
    }
    assert_eq!(
        (altitude(), joined(&store, "mach")),
        (Some((1067.0, 1)), None),
        "the first is there still"
    );
    assert!(
        withdraw("2").1.contains("already withdrawn") && withdraw("9").1.contains("has 3 sources")
    );
    let list = stdout(&[
        "aircraft-data",
        &store,
        "--flight",
        "f0001",
        "--list",
        "--json",
    ]);
    crate::json_schemas::assert_valid("aircraft-data", list.as_bytes());
    let list: Value = serde_json::from_str(&list).unwrap();
    let of = |k: usize| &list["sources"][k];
    assert_eq!(
        (&of(0)["name"], &of(0)["lines"], &of(0)["withdrawn"]),
        (&"qar.csv".into(), &120.into(), &Value::Null)
    );
    assert!(
        of(1)["withdrawn"].is_string() && of(2)["quantities"].as_array().unwrap().is_empty(),
        "{list}"
    );

    // Evidence: every file is in the chain, a changed withdrawal is found, and a copy contains everything.
    assert!(verify_path(&RealDisk, Path::new(&store)).is_sound());
    let copy = dir.path().join("copy").to_string_lossy().into_owned();
    stdout(&["copy", &store, &copy]);
    let listed = |root: &str| {
        stdout(&[
            "aircraft-data",
            root,
            "--flight",
            "f0001",
            "--list",
            "--json",
        ])
    };
    assert_eq!(listed(&copy), listed(&store));
    let flight = Path::new(&copy).join("flights/f0001");
    let file = flight.join("aircraft-000004.jsonl");
    let text = std::fs::read_to_string(&file).unwrap();
    let sums = std::fs::read_to_string(flight.join("SHA256SUMS")).unwrap();
    assert!(
        text.contains("\"withdraws\":3") && sums.contains("aircraft-000004.jsonl"),
        "{text}{sums}"
    );
    std::fs::write(&file, text.replace("\"withdraws\":3", "\"withdraws\":1")).unwrap();
    assert!(!verify_path(&RealDisk, Path::new(&copy)).is_sound());
}
