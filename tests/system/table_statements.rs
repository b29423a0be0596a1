//! Promise: units, dates and zones that a table of aircraft data states agree with its mapping, or both are named; other times
//! and distances are named by their cause (docs/aircraft-data.md).

use serde_json::Value;

use crate::foreign_tables::{frames, import_table, joined, store};

/// Times around the flight's first frames, 2 s apart: seconds from midnight, shifted by hours.
fn every_two_seconds(shift_h: i32) -> impl Iterator<Item = i32> {
    (0..30).map(move |k| 7 * 3600 + 59 * 60 + 30 + 2 * k + 3600 * shift_h)
}

fn hms(second: i32) -> String {
    format!(
        "{:02}:{:02}:{:02}",
        second / 3600,
        second / 60 % 60,
        second % 60
    )
}

/// A store with a table and a mapping that are imported into it.
struct Attempt(tempfile::TempDir, String);

impl Attempt {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let store = store(dir.path());
        Self(dir, store)
    }

    fn import(&self, text: &str, mapping: &str) -> (Option<i32>, Value, String) {
        let (file, map) = (
            self.0.path().join("table.csv"),
            self.0.path().join("map.toml"),
        );
        std::fs::write(&file, text).unwrap();
        std::fs::write(&map, mapping).unwrap();
        import_table(&self.1, &file.to_string_lossy(), &map.to_string_lossy())
    }

    /// Imports a table that must be refused with these words.
    fn refused(&self, text: &str, mapping: &str, words: &[&str]) {
        let (status, answer, printed) = self.import(text, mapping);
        assert!(
            matches!(status, Some(1 | 78)) && answer["source"].is_null(),
            "{words:?}: {printed}"
        );
        words
            .iter()
            .for_each(|word| assert!(printed.contains(word), "{word}: {printed}"));
    }

    /// Imports a table that must give the flight's first two frames this value.
    fn gives(&self, text: &str, mapping: &str, (quantity, value): (&str, f64)) {
        let (status, answer, printed) = self.import(text, mapping);
        assert!(
            status == Some(0) && frames(&answer, quantity) == 2,
            "{mapping}: {printed}"
        );
        let (found, _) = joined(&self.1, quantity).unwrap();
        assert!((found - value).abs() < 1e-6, "{mapping}: {found}");
    }
}

const ALTITUDE: &str = "[[column]]\nname = 'ALT'\nquantity = 'pressure_altitude_m'\n";
const OF_DAY: &str = "time = 'T'\ntime_format = 'seconds_of_day'\ndate = 2026-06-01\n";

#[test]
fn units_of_a_table_agree_with_those_of_the_mapping_or_both_are_named() {
    let attempt = Attempt::new();
    let rows: String = every_two_seconds(0)
        .map(|s| format!("{},35000\n", hms(s)))
        .collect();
    let mapping = format!("{OF_DAY}{ALTITUDE}");
    for head in [
        "#hh:mm:ss, ft Baro,\nT,ALT\n",
        "UTC (hh:mm:ss),Pressure altitude (ft.)\nT,ALT\n",
        "Time tag,Pressure altitude\n-,[feet]\nT,ALT\n",
        "ALT,ft,of the standard atmosphere\nT,s,UTC\nT,ALT\n",
        "T,ALT\n-,Pressure altitude\n-,FT\n",
    ] {
        let text = format!("{head}{rows}");
        attempt.refused(
            &text,
            &mapping,
            &[
                "ALT: is in",
                "scale = 1, offset = 0; write scale = 0.3048, offset = 0, or unit =",
            ],
        );
        attempt.refused(
            &text,
            &format!("{mapping}unit = 'm'\n"),
            &["unit = \"m\": scale = 1", "write scale = 0.3048"],
        );
        attempt.gives(
            &text,
            &format!("{mapping}unit = 'ft'\n"),
            ("pressure_altitude_m", 10_668.0),
        );
    }
    let named = |name: &str| {
        (
            format!("T,{name}\n{rows}"),
            mapping.replace("'ALT'", &format!("'{name}'")),
        )
    };
    for name in [
        "ALT_FT",
        "Alt / ft",
        "Alt (ft Baro)",
        "Alt [foot]",
        "Alt (kft)",
    ] {
        let (text, mapping) = named(name);
        attempt.refused(&text, &mapping, &["but the mapping converts it"]);
    }
    let (text, mapping) = named("Alt (furlong)");
    let metres = text.replace("35000", "10668");
    let (status, _, printed) = attempt.import(&metres, &mapping);
    assert!(
        status == Some(0) && printed.contains("the unit furlong of pressure_altitude_m is unknown"),
        "{printed}"
    );
    attempt.refused(
        &text,
        &format!("{mapping}unit = 'furlong'\n"),
        &["column.unit: is furlong, which is not a known unit"],
    );
    attempt.refused(
        &text,
        &format!("{mapping}unit = 'ft'\nscale = 1.0\n"),
        &["is given with scale or offset"],
    );
}

#[test]
fn local_times_and_dates_of_a_table_are_read_or_named() {
    let attempt = Attempt::new();
    let with = |line: &dyn Fn(i32) -> String, head: &str| {
        let rows: String = every_two_seconds(-5)
            .map(|s| format!("{}\n", line(s)))
            .collect();
        format!("{head}\n{rows}")
    };
    let columns = with(
        &|s| format!("2026-06-01,{},-05:00,10668", hms(s)),
        "DATE,T,UTCOFST,ALT",
    );
    attempt.refused(
        &columns,
        &format!("{OF_DAY}{ALTITUDE}"),
        &[
            "UTCOFST: states the zone -05:00, but",
            "write zone = \"UTCOFST\"",
        ],
    );
    let read = "time = 'T'\ntime_format = 'seconds_of_day'\ndate = 'DATE'\nzone = 'UTCOFST'\n";
    attempt.gives(
        &columns,
        &format!("{read}{ALTITUDE}"),
        ("pressure_altitude_m", 10_668.0),
    );
    let other = OF_DAY.replace("06-01", "06-02");
    attempt.refused(
        &columns,
        &format!("{other}zone = '-05:00'\n{ALTITUDE}"),
        &["states the date 2026-06-01", "date = \"DATE\""],
    );
    attempt.refused(
        &columns,
        &format!("{}{ALTITUDE}", read.replace("'DATE'", "'DAY'")),
        &["\"DAY\" is not a date and not a column"],
    );
    // Without a column, whole hours are named, and the zone is applied.
    let plain = with(&|s| format!("{},10668", hms(s)), "T,ALT");
    attempt.refused(
        &plain,
        &format!("{OF_DAY}{ALTITUDE}"),
        &[
            "exactly 5h before those of 2 frames",
            "write zone = \"-05:00\"",
        ],
    );
    attempt.gives(
        &plain,
        &format!("{OF_DAY}zone = '-05:00'\n{ALTITUDE}"),
        ("pressure_altitude_m", 10_668.0),
    );
    let iso = with(&|s| format!("2026-06-01T{},10668", hms(s)), "T,ALT");
    attempt.gives(
        &iso,
        &format!("time = 'T'\nzone = '-05:00'\n{ALTITUDE}"),
        ("pressure_altitude_m", 10_668.0),
    );
}

#[test]
fn days_of_the_year_are_read_with_their_year() {
    let attempt = Attempt::new();
    let table = |time: &dyn Fn(i32) -> String| {
        let rows: String = every_two_seconds(0)
            .map(|s| format!("{},10668\n", time(s)))
            .collect();
        format!("T,ALT\n{rows}")
    };
    let irig = table(&|s| format!("152:{}.000000", hms(s)));
    let mapping = |more: &str| format!("time = 'T'\n{more}{ALTITUDE}");
    attempt.refused(
        &irig,
        &mapping(""),
        &["time_format = \"irig\", year = 2026"],
    );
    attempt.refused(
        &irig,
        &mapping("time_format = 'irig'\n"),
        &["not with a year", "year = 2026"],
    );
    attempt.gives(
        &irig,
        &mapping("time_format = 'irig'\nyear = 2026\n"),
        ("pressure_altitude_m", 10_668.0),
    );
    for time in [
        |s| format!("2026:152:{}.0", hms(s)),
        |s| format!("2026-152T{}Z", hms(s)),
    ] {
        attempt.gives(
            &table(&time),
            &mapping(""),
            ("pressure_altitude_m", 10_668.0),
        );
    }
}

/// An ICARTT file of altitudes in feet with a scale factor of 10.
fn icartt(comments: usize, date: &str, first_s: i32) -> String {
    let head = format!(
        "{}, 1001\nDOE, JANE\nINSTITUTE\naircraft state\nCAMPAIGN\n1, 1\n{date}, 2026, 06, 02\n1\nTime_Start, seconds, UTC\n1\n10\n9999\n\
         ALT, ft\n0\n{}\n",
        16 + comments,
        comments + 1
    );
    let rows: String = (0..30)
        .map(|k| {
            format!(
                "{}, {}\n",
                first_s + 2 * k,
                if k == 3 { 9999 } else { 3500 }
            )
        })
        .collect();
    head + &"COMMENT: none\n".repeat(comments) + "Time_Start, ALT\n" + &rows
}

#[test]
fn an_icartt_file_defines_date_time_units_factors_and_missing_values() {
    let attempt = Attempt::new();
    let begin_s = 7 * 3600 + 59 * 60 + 30;
    for text in [
        icartt(2, "2026, 06, 01", begin_s),
        icartt(70, "2026, 05, 31", begin_s + 86_400),
    ] {
        attempt.gives(
            &text,
            &format!("format = 'icartt'\n{ALTITUDE}"),
            ("pressure_altitude_m", 10_668.0),
        );
        let (_, answer, printed) = attempt.import(&text, &format!("format = 'icartt'\n{ALTITUDE}"));
        assert_eq!(answer["quantities"][0]["blank"], 1, "{answer} {printed}");
    }
    let text = icartt(70, "2026, 06, 01", begin_s);
    let own = OF_DAY.replace("'T'", "'Time_Start'");
    attempt.refused(
        &text,
        &format!("{own}{ALTITUDE}"),
        &["line 13, ALT: is in ft"],
    );
    attempt.gives(
        &text,
        &format!("{own}{ALTITUDE}unit = 'ft'\n"),
        ("pressure_altitude_m", 10_668.0),
    );
    attempt.refused(
        &text,
        &format!("{}{ALTITUDE}", own.replace("06-01", "06-02")),
        &["line 7: states the date 2026-06-01"],
    );
    attempt.refused(
        "T,ALT\n1,2\n",
        &format!("format = 'icartt'\n{ALTITUDE}"),
        &["line 1: is not the first line of an ICARTT file"],
    );
}

#[test]
fn lines_too_far_apart_are_named() {
    let attempt = Attempt::new();
    let every = |step_s: i32, first_s: i32| {
        let rows: String = (0..(9 * 3600 / step_s).max(2))
            .map(|k| format!("{},10668\n", hms(first_s + k * step_s)))
            .collect();
        format!("T,ALT\n{rows}")
    };
    let mapping = format!("{OF_DAY}{ALTITUDE}");
    let words = [
        "no line with a value lies within 5 s of a frame",
        "are 60 s apart, and come as near as 18 s",
    ];
    attempt.refused(&every(60, 7 * 3600 + 50 * 60 + 20), &mapping, &words);
    let (status, answer, printed) = attempt.import(&every(30_000, 8 * 3600), &mapping);
    assert!(
        status == Some(0) && frames(&answer, "pressure_altitude_m") > 0,
        "{printed}"
    );
    let lost = "frames within the table's times are more than 5 s from a line with a value: its lines are 30000 s apart";
    assert!(printed.contains(lost), "{printed}");
}
