//! Promise: `wingd stress --live` counts cycles if live results determine them, and reports gaps: skipped frames, a
//! gap of twenty minutes. (Through the recorder, with rendered frames: tests/live/stress.py.)

use std::path::Path;
use std::sync::Arc;

use serde_json::{Value, json};
use wingd::quantities;
use wingd::store::{
    LiveColumn, LiveRow, LiveTable, RealDisk, Store, StoreConfig, ValueKind, catalogue,
};

use crate::common::report_store::stamp;
use crate::program::{run, stdout};

const STRUCTURE: &str = "s_m,ei_n_m2,sigma_ei_n_m2\n3,1e9,0\n8,4e8,0\n";

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn table(provenance: &Value) -> LiveTable {
    let column = |name: &str, unit: &str, kind, width| {
        let (name, unit) = (name.to_owned(), unit.to_owned());
        LiveColumn {
            name,
            unit,
            kind,
            width,
        }
    };
    let columns = vec![
        column(
            quantities::UTC.name,
            wingd::store::columns::UTC,
            ValueKind::U64,
            1,
        ),
        column(quantities::SINCE_BOOT.name, "s", ValueKind::F64, 1),
        column(quantities::NUMBER.name, "", ValueKind::U32, 1),
        column(quantities::CURVATURE.name, "1/m", ValueKind::F64, 2),
        column(
            quantities::CURVATURE_COVARIANCE.name,
            "1/m2",
            ValueKind::F64,
            3,
        ),
    ];
    LiveTable {
        source: json!({"provenance": provenance}),
        columns,
    }
}

/// Oscillating curvature of known size; ten rows per second.
fn row(n: u32, hz: f64) -> LiveRow {
    let s = f64::from(n) / 10.0;
    let oscillation = 1.0 + 0.5 * (std::f64::consts::TAU * hz * s).sin();
    vec![
        1.772e15 + 1e6 * s,
        100.0 + s,
        f64::from(n),
        4e-3 * oscillation,
        -1e-3 * oscillation,
        1e-12,
        0.0,
        1e-12,
    ]
}

fn add_flight(store: &Store, provenance: &Value, rows: &[LiveRow]) {
    store.request_new_flight();
    for block in rows.chunks(20) {
        store
            .append_live_rows(
                &table(provenance),
                block,
                &stamp((block[0][1] - 100.0) as u64),
            )
            .unwrap();
    }
    store.close_live_file().unwrap();
}

/// A demo store with installation and provenance, and a flight of such rows.
struct StoreWithFlight {
    dir: tempfile::TempDir,
    store: Store,
    provenance: Value,
}

impl StoreWithFlight {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        stdout(&["demo", "--output", text(&dir.path().join("demo"))]);
        std::fs::write(dir.path().join("structure.csv"), STRUCTURE).unwrap();
        let root = dir.path().join("demo/store");
        let flight = catalogue::list_flights(&RealDisk, &root).unwrap().remove(0);
        let series = catalogue::list_series(&RealDisk, &flight)
            .unwrap()
            .remove(0);
        let provenance = json!(
            catalogue::read_results(&RealDisk, &series)
                .unwrap()
                .remove(0)
                .provenance
        );
        let config = StoreConfig {
            reserve_mb: 0,
            ..StoreConfig::new(&root)
        };
        let store = Store::open(Arc::new(RealDisk), config).unwrap().0;
        Self {
            dir,
            store,
            provenance,
        }
    }

    fn record_flight(&self, rows: &[LiveRow]) {
        add_flight(&self.store, &self.provenance, rows);
    }

    /// Report of the last flight, and standard error.
    fn stress(&self, hz: &str) -> (Value, String) {
        let (root, structure) = (
            self.dir.path().join("demo/store"),
            self.dir.path().join("structure.csv"),
        );
        let asked = [
            "stress",
            text(&root),
            "--live",
            "--structure",
            text(&structure),
            "--json",
        ];
        let output = run(&[&asked[..], &["--bending-hz", hz]].concat());
        let line = output
            .stdout
            .trim_ascii()
            .rsplit(|byte| *byte == b'\n')
            .next()
            .unwrap();
        crate::json_schemas::assert_valid("stress", line);
        (
            serde_json::from_slice(line).unwrap(),
            String::from_utf8_lossy(&output.stderr).into_owned(),
        )
    }
}

/// As many cycles as oscillations, of the moment's range.
#[test]
fn stress_counts_the_cycles_of_live_results() {
    let flown = StoreWithFlight::new();
    let mut rows: Vec<LiveRow> = (0..300).map(|n| row(n, 1.0)).collect();
    rows[77][3] = f64::NAN;
    flown.record_flight(&rows);
    let (load, printed) = flown.stress("0.5");
    assert!(
        printed.contains(": 1 live results were not solved"),
        "{printed}"
    );
    assert_eq!(
        (&load["frames"], &load["no_cycles_because"], &load["live"]),
        (&json!(299), &Value::Null, &json!(true))
    );
    let station = &load["stations"][0];
    let cycles: Vec<(f64, f64)> = station["cycles"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| {
            (
                c["range_n_m"].as_f64().unwrap(),
                c["count"].as_f64().unwrap(),
            )
        })
        .collect();
    let (most, least) = (
        &station["greatest"]["moment_n_m"],
        &station["smallest"]["moment_n_m"],
    );
    let oscillation = most.as_f64().unwrap() - least.as_f64().unwrap();
    let oscillations: f64 = cycles
        .iter()
        .filter(|(range, _)| (range - oscillation).abs() < 1e-6 * oscillation)
        .map(|(_, n)| n)
        .sum();
    assert!(
        (28.0..=30.0).contains(&oscillations),
        "{oscillations} of {cycles:?}"
    );
    let ratio = most.as_f64().unwrap() / least.as_f64().unwrap();
    let sampled = 0.5 * (0.3 * std::f64::consts::TAU).sin();
    assert!(
        (ratio - (1.0 + sampled) / (1.0 - sampled)).abs() < 1e-6,
        "{ratio}"
    );
    let slow = flown.stress("3").0;
    let reason = slow["no_cycles_because"].as_str().unwrap();
    assert!(
        reason.contains("frames per second is too low to count cycles"),
        "{slow}"
    );
}

#[test]
fn gaps_of_live_results_are_reported_and_their_damage_is_in_its_sigma() {
    const TWENTY_MINUTES: u32 = 12_000;
    // No frame is always at the same phase of an oscillation.
    const SWINGS_HZ: f64 = 0.97;
    let rows = |numbers: &mut dyn Iterator<Item = u32>| -> Vec<LiveRow> {
        numbers.map(|n| row(n, SWINGS_HZ)).collect()
    };
    // Every 33rd frame is skipped; or the camera is absent for twenty minutes of half an hour.
    let skipped = rows(&mut (0..3000).filter(|n| n % 33 != 7));
    let hole = rows(&mut (0..3000).chain(3000 + TWENTY_MINUTES..6000 + TWENTY_MINUTES));
    // Oscillations from 0.5 to 1.5, the flight from 0 to 1.5 and back: computed manually.
    let damage = |seconds: f64| 1.0 + (seconds * SWINGS_HZ - 1.0) * (1.0_f64 / 1.5).powi(3);
    for (rows, seconds, gaps, longest_s) in [(skipped, 300.0, 91, 0.2), (hole, 1800.0, 1, 1200.1)] {
        let flown = StoreWithFlight::new();
        flown.record_flight(&rows);
        let (load, _) = flown.stress("0.97");
        let printed = &load["gaps"];
        assert_eq!(
            (&load["no_cycles_because"], &printed["count"]),
            (&Value::Null, &json!(gaps)),
            "{printed}"
        );
        assert!(
            (printed["longest_s"].as_f64().unwrap() - longest_s).abs() < 0.01,
            "{printed}"
        );
        let of_slope_3 = &load["stations"][0]["damage"][0];
        let of = |name: &str| of_slope_3[name].as_f64().unwrap();
        let off = (of("relative") - damage(seconds)) / of("sigma_relative");
        // The uncovered time is assumed to be like the rest, which is true here: its damage is one standard deviation.
        let expected = if gaps == 1 { -1.05..-0.95 } else { -1.0..1.0 };
        assert!(
            of("slope") == 3.0 && expected.contains(&off),
            "{off} of {of_slope_3}, {}",
            damage(seconds)
        );
    }
}
