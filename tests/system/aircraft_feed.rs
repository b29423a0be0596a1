//! Promise: late and jumping aircraft data recorded during a flight are joined within their time tags, and the air outside the
//! window is taken from them; a bending line gives moments.

use std::path::Path;
use std::sync::Arc;

use serde_json::{Value, json};
use wingd::aircraft::{Layout, Quantity, QuantityColumn};
use wingd::clock::Stamp;
use wingd::store::aircraft::AircraftLine;
use wingd::store::verify::verify_path;
use wingd::store::{RealDisk, Store, StoreConfig, catalogue};

use crate::program::{outcome, stdout};

/// Hours since the flight's first shot.
fn hours(first: &Stamp, at: jiff::Timestamp) -> f64 {
    at.duration_since(first.utc).as_secs_f64() / 3600.0
}

fn mach(hour: f64) -> f64 {
    0.70 + 0.01 * hour
}

fn weight_kg(hour: f64) -> f64 {
    70_000.0 - 2000.0 * hour
}

/// A line of the feed of an aircraft at flight level 340.
fn iwg1(first: &Stamp, at: jiff::Timestamp) -> String {
    let hour = hours(first, at);
    let mut fields = vec![String::new(); 33];
    fields[0] = "IWG1".to_owned();
    fields[1] = at.to_string().trim_end_matches('Z').to_owned();
    fields[6] = "34000".to_owned();
    fields[11] = format!("{:.5}", mach(hour));
    fields[20] = "-52.4".to_owned();
    fields[23] = "250.0".to_owned();
    fields[25] = format!("{:.2}", 800.0 - 2.0 * hour);
    fields.push(format!("{:.1}", weight_kg(hour)));
    fields.push("1.02".to_owned());
    fields.join(",")
}

fn layout() -> Layout {
    let own = [(34, Quantity::WeightKg), (35, Quantity::LoadFactor)];
    Layout::iwg1(&own.map(|(field, quantity)| QuantityColumn {
        field,
        quantity,
        scale: 1.0,
        offset: 0.0,
    }))
}

fn stamp_after(stamp: &Stamp, seconds: f64) -> Stamp {
    let apart = jiff::SignedDuration::from_secs_f64(seconds);
    Stamp {
        utc: stamp.utc + apart,
        since_boot_s: stamp.since_boot_s + seconds,
        ..stamp.clone()
    }
}

/// Ten seconds of a 2 Hz feed around a shot: three to six seconds late, one line twice, one tag jumping by an hour.
fn feed_around(first: &Stamp, shot: &Stamp) -> Vec<AircraftLine> {
    let mut lines = Vec::new();
    for k in -10..10 {
        let tagged = stamp_after(shot, 0.5 * f64::from(k) + 0.21);
        let at = Some(stamp_after(&tagged, 3.0 + f64::from((k + 10) % 4)));
        let line = iwg1(first, tagged.utc);
        if k == 3 {
            lines.push(AircraftLine {
                at: at.clone(),
                line: line.clone(),
            });
            let jumped = iwg1(first, stamp_after(&tagged, -3600.0).utc).replace("250.0", "999.0");
            lines.push(AircraftLine {
                at: at.clone(),
                line: jumped,
            });
        }
        lines.push(AircraftLine { at, line });
    }
    lines
}

fn demo(dir: &Path) -> std::path::PathBuf {
    let output = dir.join("demo");
    stdout(&["demo", "--output", &output.to_string_lossy()]);
    output.join("store")
}

fn shots(root: &Path) -> Vec<Stamp> {
    let flight = catalogue::list_flights(&RealDisk, root).unwrap().remove(0);
    let series = catalogue::list_series(&RealDisk, &flight).unwrap();
    let manifests = series
        .iter()
        .map(|s| catalogue::read_series_manifest(&RealDisk, s).unwrap());
    manifests
        .flat_map(|m| m.shots)
        .map(|shot| shot.stamp)
        .collect()
}

/// The store's installation with a window whose normal is along the span.
fn copy_with_window(root: &Path, to: &Path) -> String {
    let kept = std::fs::read_dir(root.join("installations"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    std::fs::create_dir(to).unwrap();
    for file in std::fs::read_dir(kept)
        .unwrap()
        .map(|entry| entry.unwrap().path())
    {
        std::fs::copy(&file, to.join(file.file_name().unwrap())).unwrap();
    }
    let main = to.join("installation.toml");
    let text = std::fs::read_to_string(&main).unwrap();
    let direction = text
        .lines()
        .find_map(|l| l.strip_prefix("span_direction = ["))
        .unwrap();
    let normal = direction.trim_end_matches(']');
    std::fs::write(
        &main,
        format!("{text}\n[window]\nnormal = [{normal}, 0.0]\n"),
    )
    .unwrap();
    to.to_string_lossy().into_owned()
}

#[test]
fn a_late_and_jumping_feed_is_joined_and_its_air_is_used() {
    let dir = tempfile::tempdir().unwrap();
    let root = demo(dir.path());
    let shots = shots(&root);
    let config = StoreConfig {
        reserve_mb: 0,
        ..StoreConfig::new(&root)
    };
    let (store, _) = Store::open(Arc::new(RealDisk), config).unwrap();
    let source = json!({"udp": "127.0.0.1:7071", "layout": layout()});
    // Shots of a series are seconds apart, so their feed lines come twice.
    let mut tags = std::collections::BTreeSet::new();
    let mut lines = 0;
    for shot in &shots {
        let about = feed_around(&shots[0], shot);
        let true_ones = about.iter().filter(|line| !line.line.contains("999.0"));
        tags.extend(true_ones.map(|line| layout().read(&line.line).unwrap().time_s.to_bits()));
        lines += about.len() - 1;
        assert!(store.add_aircraft_lines(&source, &about).unwrap());
    }
    store.close_aircraft_file().unwrap();
    drop(store);
    assert!(verify_path(&RealDisk, &root).is_sound());
    let place = root.to_string_lossy().into_owned();

    let table = stdout(&["export", &place, "--format", "csv", "--table", "shots"]);
    let mut reader = csv::Reader::from_reader(table.as_bytes());
    let heading = reader.headers().unwrap().clone();
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), shots.len());
    for (row, shot) in rows.iter().zip(&shots) {
        let of = |name: &str| {
            row[heading.iter().position(|h| h == name).unwrap()]
                .parse::<f64>()
                .unwrap()
        };
        let hour = hours(&shots[0], shot.utc);
        assert!(
            (of("mach") - mach(hour)).abs() < 2e-5,
            "{hour}: {}",
            of("mach")
        );
        assert!((of("weight_kg") - weight_kg(hour)).abs() < 1.0 && of("sigma_weight_kg") > 100.0);
        assert_eq!(
            (of("static_pressure_hpa"), of("load_factor")),
            (250.0, 1.02)
        );
        assert!(of("exposure_sigma_s") >= 0.0);
    }

    let window = copy_with_window(&root, &dir.path().join("window"));
    let solve = ["solve", &place, "--installation", &window];
    let (status, printed) = outcome(&solve);
    assert!(
        status == Some(0) && printed.contains("aircraft samples"),
        "{printed}"
    );
    let records = stdout(&["export", &place, "--format", "jsonl"]);
    let solved: Vec<Value> = records
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    for line in &solved {
        let quality = &line["record"]["quality"];
        assert_eq!(
            quality["aircraft"]["static_pressure_hpa"]["value"], 250.0,
            "{quality}"
        );
        // Dry air of 250.0 hPa at -52.4 C, Ciddor: 1 + 89.6e-6; the installation's constants have 79e-6.
        let refraction = |field: &str| quality["refraction"][field].as_f64().unwrap();
        assert!(
            (refraction("index_outside") - 1.0 - 89.6e-6).abs() < 0.5e-6,
            "{quality}"
        );
        let (shift, sigma) = (refraction("max_shift_px"), refraction("sigma_max_shift_px"));
        assert!(quality["refraction"]["applied"] == true && (0.1..3.0).contains(&shift));
        assert!((0.002..0.03).contains(&(sigma / shift)), "{shift} {sigma}");
    }
    let (status, printed) = outcome(&solve);
    assert!(
        status == Some(0) && printed.contains("already has a result from these inputs"),
        "{printed}"
    );

    let page = dir.path().join("report.html");
    stdout(&["report", &place, "--output", &page.to_string_lossy()]);
    let html = std::fs::read_to_string(&page).unwrap();
    let (repeated, jumped) = (lines - tags.len(), shots.len());
    let unused = format!("{repeated} repeated, {jumped} with an implausible time");
    for text in ["Exposure times", &unused] {
        assert!(html.contains(text), "{text}");
    }
}

#[test]
fn a_table_after_the_flight_is_imported() {
    let dir = tempfile::tempdir().unwrap();
    let root = demo(dir.path());
    let shots = shots(&root);
    let mut table = "utc,pressure_altitude_m,total_temperature_c,weight_kg\n".to_owned();
    for shot in &shots {
        for k in -2..=2 {
            table.push_str(&format!(
                "{},11277.6,-24,71500\n",
                stamp_after(shot, f64::from(k)).utc
            ));
        }
    }
    let table_file = dir.path().join("qar.csv");
    std::fs::write(&table_file, table).unwrap();
    let (place, table) = (root.to_string_lossy(), table_file.to_string_lossy());
    let take = ["aircraft-data", &place, &table, "--flight", "f0001"];
    let printed = stdout(&take);
    assert!(
        printed.contains(&format!("{} lines stored", 5 * shots.len())),
        "{printed}"
    );
    assert!(verify_path(&RealDisk, &root).is_sound());
    let lines = stdout(&["export", &place, "--format", "jsonl"]);
    let first: Value = serde_json::from_str(lines.lines().next().unwrap()).unwrap();
    let total_c = first["aircraft"]["total_temperature_c"]["value"]
        .as_f64()
        .unwrap();
    assert!((total_c + 24.0).abs() < 1e-9, "{first}");
    assert!(
        (first["aircraft"]["pressure_altitude_m"]["value"]
            .as_f64()
            .unwrap()
            - 11_277.6)
            .abs()
            < 1e-6
    );
}
