//! Cost of 8.5 hours of ten results per second. Run it manually, on the medium of TMPDIR:
//! `cargo test --release --test system -- --ignored --nocapture store_live_figures`

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use rand::rngs::StdRng;
use serde_json::{Value, json};
use wingd::quantities;
use wingd::store::columns::UTC;
use wingd::store::verify::verify_path;
use wingd::store::{
    LiveColumn, LiveRow, LiveTable, RealDisk, Store, StoreConfig, StoreError, ValueKind, catalogue,
    live,
};

use crate::common::random::{normal, rng};
use crate::common::report_store::stamp;

const MARKERS: usize = 21;
const STATIONS: usize = 20;
const TERMS: usize = 5;
const RATE_HZ: usize = 10;
const SECONDS: usize = 30_600;
/// Interval between two blocks.
const BLOCK_S: usize = 2;

fn table() -> LiveTable {
    let column = |name: &str, unit: &str, kind, width| {
        let (name, unit) = (name.to_owned(), unit.to_owned());
        LiveColumn {
            name,
            unit,
            kind,
            width,
        }
    };
    let mut columns = vec![
        column(quantities::UTC.name, UTC, ValueKind::U64, 1),
        column(quantities::SINCE_BOOT.name, "s", ValueKind::F64, 1),
        column(quantities::NUMBER.name, "", ValueKind::U32, 1),
        column("status", "", ValueKind::U8, 1),
        column("latency", "ms", ValueKind::F32, 1),
        column("variance_factor", "", ValueKind::F32, 1),
        column("mounting", "mrad", ValueKind::F32, 6),
        column("pairs.twist", "deg", ValueKind::F32, 4),
        column("curvature", "1/m", ValueKind::F32, TERMS),
        column(
            "curvature_covariance",
            "1/m2",
            ValueKind::F32,
            TERMS * (TERMS + 1) / 2,
        ),
    ];
    for (name, unit) in MARKER {
        columns.push(column(
            &format!("markers.{name}"),
            unit,
            ValueKind::F32,
            MARKERS,
        ));
    }
    for (name, unit) in [
        ("deflection", "m"),
        ("sigma_deflection", "m"),
        ("twist", "deg"),
        ("sigma_twist", "deg"),
    ] {
        columns.push(column(
            &format!("stations.{name}"),
            unit,
            ValueKind::F32,
            STATIONS,
        ));
    }
    let names = |letter: &str, count| {
        (0..count)
            .map(|n| format!("{letter}{n:02}"))
            .collect::<Vec<_>>()
    };
    let source = json!({"markers": names("M", MARKERS), "stations": names("S", STATIONS), "pairs": names("P", 4)});
    LiveTable { source, columns }
}

const MARKER: [(&str, &str); 12] = [
    ("image_x", "px"),
    ("image_y", "px"),
    ("sigma_image_x", "px"),
    ("sigma_image_y", "px"),
    ("position_x", "m"),
    ("position_y", "m"),
    ("position_z", "m"),
    ("sigma_position_x", "m"),
    ("sigma_position_y", "m"),
    ("sigma_position_z", "m"),
    ("deflection", "m"),
    ("sigma_deflection", "m"),
];

/// A wing in gusts, with noise as large as that of detection and adjustment.
fn row(number: usize, draw: &mut StdRng) -> LiveRow {
    let t_s = number as f64 / RATE_HZ as f64;
    let tip_m = 2.0 + 0.4 * (t_s / 5000.0).sin() + 0.15 * (1.1 * t_s).sin() * (t_s / 60.0).sin();
    let mut row = vec![
        1.772e15 + 1e6 * t_s + (1e3 * normal(draw)).round(),
        100.0 + t_s,
        number as f64,
        0.0,
    ];
    row.extend([80.0 + 5.0 * normal(draw), 1.0 + 0.1 * normal(draw)]);
    row.extend((0..6).map(|k| 0.1 * f64::from(k) + 0.01 * normal(draw)));
    row.extend((0..4).map(|k| 0.5 * f64::from(k) + 0.02 * normal(draw)));
    row.extend((0..TERMS).map(|k| 1e-3 * tip_m / (1.0 + k as f64) + 1e-5 * normal(draw)));
    row.extend((0..TERMS * (TERMS + 1) / 2).map(|_| 1e-10 * (1.0 + 0.05 * normal(draw))));
    for (name, _) in MARKER {
        for marker in 0..MARKERS {
            let share = (marker as f64 + 1.0) / MARKERS as f64;
            let (deflection_m, scale) = (tip_m * share * share, 1.0 + 0.05 * normal(draw));
            row.push(match name {
                "image_x" => 600.0 + 130.0 * marker as f64 + 0.05 * normal(draw),
                "image_y" => 1500.0 - 60.0 * deflection_m + 0.05 * normal(draw),
                "position_x" | "position_y" => 30.0 * share + 5e-4 * normal(draw),
                "position_z" | "deflection" => deflection_m + 4e-3 * normal(draw),
                name if name.contains("image") => 0.05 * scale,
                _ => 5e-3 * share * scale,
            });
        }
    }
    for name in 0..4 {
        row.extend((0..STATIONS).map(|station| {
            let share = station as f64 / STATIONS as f64;
            if name == 0 {
                tip_m * share * share + 4e-3 * normal(draw)
            } else {
                5e-3 * (1.0 + share) + 2e-4 * normal(draw)
            }
        }));
    }
    row
}

fn status_mb(field: &str) -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with(field)).unwrap();
    line.split_whitespace()
        .nth(1)
        .unwrap()
        .parse::<f64>()
        .unwrap()
        / 1000.0
}

fn open(root: &Path) -> Store {
    let config = StoreConfig {
        reserve_mb: 0,
        ..StoreConfig::new(root)
    };
    Store::open(Arc::new(RealDisk), config).unwrap().0
}

fn timed<T>(what: &str, work: impl FnOnce() -> T) -> T {
    let begin = Instant::now();
    let result = work();
    println!("{what}: {:.2} s", begin.elapsed().as_secs_f64());
    result
}

#[test]
#[ignore = "500 MB, run manually"]
fn eight_and_a_half_hours_at_ten_results_per_second() {
    let dir = tempfile::tempdir().unwrap();
    let (store, table, mut draw) = (open(dir.path()), table(), rng(38));
    let before_mb = status_mb("VmRSS");
    let mut times_ms: Vec<f64> = Vec::new();
    for block in 0..SECONDS / BLOCK_S {
        let first = block * BLOCK_S * RATE_HZ;
        let rows: Vec<LiveRow> = (first..first + BLOCK_S * RATE_HZ)
            .map(|n| row(n, &mut draw))
            .collect();
        let begin = Instant::now();
        store
            .append_live_rows(&table, &rows, &stamp((block * BLOCK_S) as u64))
            .unwrap();
        times_ms.push(1e3 * begin.elapsed().as_secs_f64());
    }
    println!(
        "peak memory of recording: {:.0} MB, {before_mb:.0} MB before",
        status_mb("VmHWM")
    );
    times_ms.sort_by(f64::total_cmp);
    let at = |share: f64| times_ms[(share * (times_ms.len() - 1) as f64) as usize];
    println!(
        "append of {} rows: median {:.1} ms, 99 % {:.1} ms, longest {:.1} ms",
        BLOCK_S * RATE_HZ,
        at(0.5),
        at(0.99),
        at(1.0)
    );
    drop(store);
    let store = timed(
        "opening after a power cut (closes the file under way)",
        || open(dir.path()),
    );
    drop(store);
    drop(timed("opening", || open(dir.path())));
    let flight = catalogue::list_flights(&RealDisk, dir.path())
        .unwrap()
        .remove(0);
    let names = live::closed_files(&RealDisk, &flight).unwrap();
    let bytes: u64 = names
        .iter()
        .map(|name| flight.folder.join(name).metadata().unwrap().len())
        .sum();
    let plain: usize = table
        .columns
        .iter()
        .map(|column| column.width * column.kind.byte_size())
        .sum();
    let rows = SECONDS * RATE_HZ;
    println!(
        "{rows} rows of {plain} bytes, {:.0} MB; {} files, {:.0} MB, ratio {:.2}",
        1e-6 * (rows * plain) as f64,
        names.len(),
        1e-6 * bytes as f64,
        bytes as f64 / (rows * plain) as f64
    );
    assert!(timed("verify", || verify_path(&RealDisk, dir.path())).is_sound());
    let mut names = table.columns.iter().map(|column| column.name.as_str());
    let deflection = names
        .position(|name| name == "stations.deflection")
        .unwrap();
    let mut seen = (0, 0);
    for whole in [false, true] {
        timed(if whole { "every value" } else { "one column" }, || {
            live::for_each_live_file(&RealDisk, dir.path(), &flight, |mut file| {
                while let Some(block) = file.next_block() {
                    match whole {
                        true => seen.1 += block.rows().unwrap().len(),
                        false => {
                            seen.0 += block.column_values(deflection).unwrap().len() / STATIONS
                        }
                    }
                }
                Result::<usize, StoreError>::Ok(file.torn_length())
            })
            .unwrap()
        });
    }
    assert_eq!(seen, (rows, rows));
    println!("peak memory of all: {:.0} MB", status_mb("VmHWM"));
    let _: Value = table.source;
    if let Ok(kept) = std::env::var("WINGD_KEEP") {
        std::fs::write(kept, dir.keep().to_string_lossy().as_bytes()).unwrap();
    }
}
