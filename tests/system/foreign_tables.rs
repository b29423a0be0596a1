//! Promise: a table of aircraft data is read as its program meant it, or named with the cause; an imported table
//! can be corrected, extended and withdrawn, and the store keeps everything (fixtures/tables; docs/aircraft-data.md).

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
pub fn store(to: &Path) -> String {
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
pub fn import_table(store: &str, file: &str, mapping: &str) -> (Option<i32>, Value, String) {
    let done = run(&[
        "aircraft-data",
        store,
        file,
        "--mapping",
        mapping,
        "--flight",
        "f0001",
        "--json",
    ]);
    let answer = serde_json::from_slice(&done.stdout).unwrap_or_default();
    (
        done.status.code(),
        answer,
        String::from_utf8(done.stderr).unwrap(),
    )
}

pub fn frames(answer: &Value, quantity: &str) -> u64 {
    let all = answer["quantities"].as_array().unwrap();
    all.iter().find(|q| q["quantity"] == quantity).unwrap()["frames"]
        .as_u64()
        .unwrap()
}

/// A quantity at the flight's first frames: value and source.
pub fn joined(store: &str, quantity: &str) -> Option<(f64, u64)> {
    let lines = stdout(&["export", store, "--format", "jsonl"]);
    let first: Value = serde_json::from_str(lines.lines().next().unwrap()).unwrap();
    let joined_value = &first["aircraft"][quantity];
    Some((
        joined_value["value"].as_f64()?,
        joined_value["source"].as_u64()?,
    ))
}

#[test]
fn every_table_that_can_be_read_is_read() {
    for (name, mapping) in [
        ("a-plain.csv", "map.toml"),
        ("b-quoted.csv", "map.toml"),
        ("b2-quoted-values.csv", "map.toml"),
        ("d-tab-blank-first.tsv", "map-tab.toml"),
        ("units-row.csv", "map.toml"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let store = store(dir.path());
        let (status, answer, printed) = import_table(&store, &table(name), &table(mapping));
        assert_eq!(
            (status, &answer["read"], &answer["lines"]),
            (Some(0), &120.into(), &120.into()),
            "{name}: {printed}"
        );
        assert_eq!(
            (
                frames(&answer, "mach"),
                frames(&answer, "pressure_altitude_m")
            ),
            (2, 2),
            "{name}"
        );
        assert_eq!(joined(&store, "mach"), Some((0.78, 1)), "{name}");
        let altitude = joined(&store, "pressure_altitude_m").unwrap().0;
        assert!((altitude - 10_668.0).abs() < 1e-6, "{name}: {altitude}");
        assert!(verify_path(&RealDisk, Path::new(&store)).is_sound());
    }
}

#[test]
fn tables_that_match_no_frame_are_refused_with_the_cause() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path());
    for (name, cause) in [
        (
            "c-decimal-comma.csv",
            "decimal commas (350,0); write decimal = \",\"",
        ),
        (
            "e-excel-serial.csv",
            "a spreadsheet's day numbers (46174.333218)",
        ),
        ("f-epoch-ms.csv", "time_format = \"unix_ms\""),
        (
            "g-seconds-of-day.csv",
            "time_format = \"seconds_of_day\", date = \"2026-06-01\"",
        ),
        ("g2-gps-week-seconds.csv", "time_format = \"gps_seconds\""),
        ("q2-compact-noT.csv", "time_format = \"compact\""),
        ("v-text-values.csv", "texts instead of numbers (NCD)"),
        ("z-otherday.csv", "its times are 2026-06-02T07:59:50Z"),
    ] {
        let (status, answer, printed) = import_table(&store, &table(name), &table("map.toml"));
        assert_eq!(status, Some(1), "{name}: {printed}");
        assert_eq!(
            (frames(&answer, "mach"), &answer["source"]),
            (0, &Value::Null),
            "{name}"
        );
        assert!(
            printed.contains("nothing was stored") && printed.contains(cause),
            "{name}: {printed}"
        );
    }
    assert!(
        stdout(&["aircraft-data", &store, "--flight", "f0001", "--list"]).contains("0 sources")
    );
}

#[test]
fn times_and_commas_are_converted_as_the_mapping_specifies() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path());
    let written = std::fs::read_to_string(table("map.toml")).unwrap();
    for (k, (name, more)) in [
        ("c-decimal-comma.csv", "decimal = ','"),
        ("e-excel-serial.csv", "time_format = 'excel_days'"),
        ("f-epoch-ms.csv", "time_format = 'unix_ms'"),
        (
            "g-seconds-of-day.csv",
            "time_format = 'seconds_of_day'\ndate = 2026-06-01",
        ),
        (
            "g-seconds-of-day.csv",
            "time_format = 'seconds_of_day'\ndate = '2026-06-01'",
        ),
        ("g2-gps-week-seconds.csv", "time_format = 'gps_seconds'"),
        ("q2-compact-noT.csv", "time_format = 'compact'"),
    ]
    .into_iter()
    .enumerate()
    {
        let mapping = dir.path().join("map.toml");
        std::fs::write(&mapping, format!("{more}\n{written}")).unwrap();
        let (status, answer, printed) =
            import_table(&store, &table(name), &mapping.to_string_lossy());
        assert_eq!(
            (status, frames(&answer, "mach")),
            (Some(0), 2),
            "{name}: {printed}"
        );
        assert_eq!(joined(&store, "mach"), Some((0.78, k as u64 + 1)), "{name}");
    }
}

#[test]
fn iwg1_is_read_without_a_header_and_glued_records_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path());
    for (name, records) in [("n-iwg1-noheader.txt", 120), ("o-iwg1-glued.txt", 119)] {
        let (status, answer, printed) = import_table(&store, &table(name), &table("iwg1.toml"));
        assert_eq!(
            (status, &answer["read"], frames(&answer, "mach")),
            (Some(0), &records.into(), 2),
            "{name}: {printed}"
        );
        assert_eq!(
            printed.contains("59 lines have several records"),
            name.starts_with('o'),
            "{printed}"
        );
        assert!((joined(&store, "pressure_altitude_m").unwrap().0 - 10_668.0).abs() < 1e-6);
    }
    let (status, _, printed) = import_table(
        &store,
        &table("n-iwg1-noheader.txt"),
        &table("map-iwg1.toml"),
    );
    assert!(
        status == Some(78) && printed.contains("write format = \"iwg1\""),
        "{printed}"
    );
    let (status, _, printed) =
        import_table(&store, &table("o-iwg1-glued.txt"), &table("map-iwg1.toml"));
    assert!(
        status == Some(78) && printed.contains("line 3: has 65 cells under a header of 33"),
        "{printed}"
    );
}

#[test]
fn a_comma_within_quotes_shifts_no_column() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path());
    let text = "UTC,PHASE,WEIGHT,FUEL\n2026-06-01T08:00:00Z,\"climb, flaps up\",71500,12000\n";
    let file = dir.path().join("qar.csv");
    std::fs::write(&file, text).unwrap();
    let (status, answer, printed) =
        import_table(&store, &file.to_string_lossy(), &table("map-wf.toml"));
    assert!(
        status == Some(0) && frames(&answer, "weight_kg") > 0,
        "{printed}"
    );
    assert_eq!(
        (joined(&store, "weight_kg"), joined(&store, "fuel_kg")),
        (Some((71_500.0, 1)), Some((12_000.0, 1)))
    );
    std::fs::write(&file, text.replace('"', "")).unwrap();
    let (status, _, printed) = import_table(&store, &file.to_string_lossy(), &table("map-wf.toml"));
    assert!(
        status == Some(78) && printed.contains("line 2: has 5 cells under a header of 4"),
        "{printed}"
    );
}

#[test]
fn a_corrected_table_counts_more_quantities_join_and_a_source_can_be_withdrawn() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path());
    let altitude =
        || joined(&store, "pressure_altitude_m").map(|(value, source)| (value.round(), source));
    let plain = table("a-plain.csv");
    assert_eq!(
        import_table(&store, &plain, &table("map-flwrong.toml")).0,
        Some(0)
    );
    assert_eq!(
        (altitude(), joined(&store, "mach")),
        (Some((1067.0, 1)), None)
    );
    let (status, answer, _) = import_table(&store, &plain, &table("map-fl.toml"));
    crate::json_schemas::assert_valid("aircraft-data", answer.to_string().as_bytes());
    assert_eq!(
        (status, &answer["quantities"][0]["replaced"]),
        (Some(0), &2.into()),
        "{answer}"
    );
    assert_eq!(altitude(), Some((10_668.0, 2)), "the corrected one counts");
    assert_eq!(import_table(&store, &plain, &table("map.toml")).0, Some(0));
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
        (&"a-plain.csv".into(), &120.into(), &Value::Null)
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

#[test]
fn units_and_headers_that_differ_from_the_mapping_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path());
    let (file, mapping) = (dir.path().join("qar.csv"), dir.path().join("map.toml"));
    let attempt = |text: &str, map: &str| {
        std::fs::write(&file, text).unwrap();
        std::fs::write(&mapping, map).unwrap();
        import_table(&store, &file.to_string_lossy(), &mapping.to_string_lossy())
    };
    let map = "time = 'UTC'\n[[column]]\nname = 'ALT'\nquantity = 'pressure_altitude_m'\n";
    let row = "2026-06-01T08:00:00Z,10668\n";
    for (text, map, words) in [
        (
            format!("UTC,ALT\n-,ft\n{row}"),
            map.to_owned(),
            "line 2, ALT: is in ft",
        ),
        (
            format!("UTC,ALT\n-,kg\n{row}"),
            map.to_owned(),
            "not a unit of pressure_altitude_m",
        ),
        (
            format!("UTC,ALT (ft)\n{row}"),
            map.replace("ALT", "ALT (ft)"),
            "write scale = 0.3048",
        ),
        (
            format!("UTC,ALT,ALT\n{row}"),
            map.to_owned(),
            "occurs twice in the header",
        ),
        (
            format!("utc,ALT\n{row}"),
            map.to_owned(),
            "no line has the column UTC",
        ),
        (
            format!("UTC;ALT\n{row}"),
            format!("separator = ','\n{map}"),
            "separated by ';', not by ','",
        ),
        (
            format!("UTC,ALT\n\"{row}"),
            map.to_owned(),
            "a quote is not closed",
        ),
        (
            format!("UTC,ALT\n{row}"),
            format!("{map}[[column]]\nname='x'\nquantity='pressure_altitude_m'\n"),
            "twice",
        ),
        (
            format!("UTC,ALT\n{row}"),
            map.replace("'UTC'", "'UTC'\ntime_format = 'seconds_of_day'"),
            "date: is missing",
        ),
        (
            format!("UTC,ALT\n{row}"),
            map.replace("'UTC'", "'UTC'\ndate = 'June'"),
            "is not a date",
        ),
        (
            format!("UTC,ALT\n{row}"),
            map.replace("time = 'UTC'", "format = 'iwg1'"),
            "column.field",
        ),
    ] {
        let (status, _, printed) = attempt(&text, &map);
        assert!(
            status == Some(78) && printed.contains(words),
            "{words}: {printed}"
        );
    }
    for text in [
        format!("sep=;\nUTC;ALT\n{}", row.replace(',', ";")),
        format!("Flight 17\n\nUTC\tALT\n-\tm\n{}", row.replace(',', "\t")),
        format!("UTC,ALT\n{row}2026-06-01T08:00:01Z,,,\n"),
    ] {
        let (status, answer, printed) = attempt(&text, map);
        assert!(
            status == Some(0) && frames(&answer, "pressure_altitude_m") > 0,
            "{text}: {printed}"
        );
    }
    // If one quantity of two reaches no frame the exit status is 1, and the other is kept.
    let two = format!("{map}[[column]]\nname = 'M'\nquantity = 'mach'\n");
    let (status, answer, printed) = attempt("UTC,ALT,M\n2026-06-01T08:00:00Z,10668,NCD\n", &two);
    assert!(
        status == Some(1)
            && printed.contains("texts instead of numbers (NCD)")
            && answer["source"].is_u64(),
        "{printed}"
    );
}

/// Two minutes of flight level 350 around the flight's first frames, with these times and cells.
fn rows(times: impl Fn(u32) -> String, level: &str, mach: &str) -> String {
    (0..120)
        .map(|k| format!("{};{level};{mach}\n", times(k)))
        .collect()
}

/// Seconds of the day of a row.
fn second_of_day(k: u32) -> u32 {
    7 * 3600 + 59 * 60 + 50 + k
}

fn clock(k: u32) -> String {
    let s = second_of_day(k);
    format!("{:02}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60)
}

#[test]
fn times_and_numbers_of_other_programs_are_read_or_named_by_their_cause() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path());
    let (file, mapping) = (dir.path().join("qar.csv"), dir.path().join("map.toml"));
    let written = std::fs::read_to_string(table("map.toml")).unwrap();
    let attempt = |text: &str, more: &str| {
        std::fs::write(&file, text).unwrap();
        std::fs::write(&mapping, format!("{more}\n{written}")).unwrap();
        import_table(&store, &file.to_string_lossy(), &mapping.to_string_lossy())
    };
    let days =
        |from: f64| move |k: u32| format!("{:.7}", from + f64::from(second_of_day(k)) / 86_400.0);
    let plain = |k: u32| format!("2026-06-01 {}", clock(k));
    let with =
        |times: &dyn Fn(u32) -> String| format!("UTC;FL;MACH\n{}", rows(times, "350", "0.780"));
    let since_1970 = |k: u32| 1_780_272_000 + u64::from(second_of_day(k));
    for (text, format) in [
        (with(&|k| format!("{}000000", since_1970(k))), "unix_us"),
        (with(&|k| format!("{}000000000", since_1970(k))), "unix_ns"),
        (with(&days(44_712.0)), "excel1904_days"),
        (with(&days(740_134.0)), "matlab_days"),
        (with(&days(2_461_192.5)), "julian_days"),
        (with(&clock), "seconds_of_day\", date = \"2026-06-01"),
    ] {
        let (status, _, printed) = attempt(&text, "");
        assert!(
            status == Some(1) && printed.contains(&format!("time_format = \"{format}\"")),
            "{format}: {printed}"
        );
        let keys = format!("time_format = \"{format}\"").replace(", ", "\n");
        let (status, answer, printed) = attempt(&text, &keys);
        assert_eq!(
            (status, frames(&answer, "mach")),
            (Some(0), 2),
            "{format}: {printed}"
        );
    }
    let numbers = |level: &str, mach: &str| format!("UTC;FL;MACH\n{}", rows(plain, level, mach));
    for (text, more, cause) in [
        (
            with(&|k| format!("01.06.2026 {}", clock(k))),
            "",
            "its times (\"01.06.2026 07:59:50\") have an unsupported format",
        ),
        (
            with(&|k| k.to_string()),
            "",
            "its times, 1 to 119, count from an unknown origin",
        ),
        ("UTC;FL;MACH\n".into(), "", "no lines below its header"),
        (
            numbers("35,000", "0,780"),
            "",
            "separate thousands, or decimals (35,000)",
        ),
        (
            numbers("35,000", "0,780"),
            "",
            "mach has decimal commas (0,780)",
        ),
        (
            numbers("35.000", "0.780"),
            "decimal = ','",
            "points and decimal commas (35.000)",
        ),
        (
            numbers("35.000,5", "0.780,1"),
            "decimal = ','",
            "points and decimal commas (35.000,5)",
        ),
    ] {
        let (status, answer, printed) = attempt(&text, more);
        assert!(
            status == Some(1) && answer["source"].is_null() && printed.contains(cause),
            "{cause}: {printed}"
        );
    }
    for (text, words) in [
        ("PK\u{3}\u{4}\u{14}\0".to_owned(), "a spreadsheet file"),
        (
            with(&plain).replace(';', "  "),
            "line 1: has columns that are separated by blanks",
        ),
    ] {
        let (status, _, printed) = attempt(&text, "");
        assert!(
            status == Some(78) && printed.contains(words),
            "{words}: {printed}"
        );
    }
}

#[test]
fn displaced_fields_of_iwg1_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path());
    let file = dir.path().join("iwg1.txt");
    let sound = std::fs::read_to_string(table("n-iwg1-noheader.txt")).unwrap();
    let attempt = |text: &str| {
        std::fs::write(&file, text).unwrap();
        import_table(&store, &file.to_string_lossy(), &table("iwg1.toml"))
    };
    // One record has lost its latitude, the next has an extra field.
    let moved = sound
        .replacen(",38.1,", ",", 1)
        .replacen("08:00:00,", "08:00:00,,", 1);
    let (status, answer, printed) = attempt(&moved);
    assert_eq!(
        (status, &answer["read"]),
        (Some(0), &118.into()),
        "{printed}"
    );
    assert!(
        printed.contains("omitted: 2 records that do not have 33 fields like most, line 1 first"),
        "{printed}"
    );
    let glued = std::fs::read_to_string(table("o-iwg1-glued.txt")).unwrap();
    let header = glued.lines().next().unwrap().replace(
        "Mach Number,Vertical Velocity",
        "Vertical Velocity,Mach Number",
    );
    let (_, _, printed) = attempt(&format!("{header}\n{sound}"));
    assert!(
        printed.contains("line 1 names field 12 \"Vertical Velocity\", which is read as mach"),
        "{printed}"
    );
    assert_eq!(printed.matches("warning: line").count(), 1, "{printed}");
}
