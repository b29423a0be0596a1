//! Small stores with synthetic results, for the tests of reports, exports and pages.

use std::sync::Arc;
use std::time::Duration;

use serde_json::{Map, Value, json};
use wingd::clock::Stamp;
use wingd::store::manifest::{SeriesCause, SeriesState, Shot};
use wingd::store::{
    Inputs, NewFrame, RealDisk, SeriesPlan, Store, StoreConfig, catalogue, series_frames,
};

/// A result as the pipeline writes it; four markers, the last one hidden.
pub fn solved(deflection_m: f64, sigma_m: f64) -> Value {
    let markers: Vec<Value> = (1..=4).map(|i| marker(i, deflection_m)).collect();
    let share = |i: i32| (f64::from(i) / 12.0).powi(2);
    let point = |i: i32| {
        json!({"arc_length_m": 3 * i, "span_m": 3 * i, "deflection_m": deflection_m * share(i),
            "sigma_deflection_m": sigma_m * share(i), "twist_deg": 2.7 * share(i), "sigma_twist_deg": 0.2 * share(i)})
    };
    json!({"image": "x.jpg", "status": "ok", "method": "spatial", "variance_factor": 0.97, "redundancy": 33,
        "global_test": "passed", "sigma_kind": "prior",
        "model": {"a_per_m": {"value": 0.00219, "sigma": 5.9e-6}},
        "tip": {"marker": "M03", "deflection_m": deflection_m, "sigma_deflection_m": sigma_m}, "markers": markers,
        "torsion": [{"name": "tip", "angle_deg": 6.3, "sigma_deg": 0.2, "twist_deg": 2.7, "sigma_twist_deg": 0.2}],
        "curve": (0..=12).map(point).collect::<Vec<_>>(),
        "provenance": {"program": "wingd 0.1.0", "survey.csv.sha256": "ab".repeat(32)},
        "timing_ms": {"decode": 31.0, "detect": 24.0, "solve": 0.4}})
}

fn marker(number: i32, deflection_m: f64) -> Value {
    let span_m = 12.0 * f64::from(number);
    let deflection_m = deflection_m * (span_m / 36.0).powi(2);
    if number == 4 {
        return json!({"id": "M04", "shape": "circle", "used": false, "reason": "hidden by glare"});
    }
    json!({"id": format!("M0{number}"), "shape": if number == 1 { "quadrant" } else { "circle" },
        "u_px": 100.0 + span_m, "v_px": 90.0, "sigma_u_px": 0.03, "sigma_v_px": 0.02, "used": true,
        "residual_u_px": 0.01, "residual_v_px": -0.02, "distance_m": span_m + 2.0, "sigma_distance_m": 0.004,
        "position_m": [1.0, span_m, 3.0 + deflection_m], "sigma_position_m": [0.002, 0.004, 0.006],
        "deflection_m": deflection_m, "sigma_deflection_m": 0.006})
}

/// A failed result.
pub fn failed(reason: &str) -> Value {
    json!({"image": "x.jpg", "status": "failed", "reason": reason, "method": "spatial", "model": {},
        "markers": [], "torsion": [], "timing_ms": {}})
}

/// A store with one series per slice, one frame per result.
pub fn store_with(series: &[&[Value]]) -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    let config = StoreConfig {
        reserve_mb: 0,
        ..StoreConfig::new(directory.path())
    };
    let (store, _) = Store::open(Arc::new(RealDisk), config).unwrap();
    for (hour, results) in series.iter().enumerate() {
        add_series(&store, hour as u64, results);
    }
    directory
}

fn add_series(store: &Store, hour: u64, results: &[Value]) {
    let plan = SeriesPlan {
        cause: SeriesCause::Scheduled,
        shots: results.len() as u32,
    };
    let (mut open, _) = store.begin_series(plan, &stamp(3600 * hour)).unwrap();
    let jpeg = jpeg();
    for number in 1..=results.len() as u32 {
        let shot = Shot {
            shot: number,
            stamp: stamp(3600 * hour + 2 * u64::from(number)),
            duration_s: None,
            exposure: None,
            frame: None,
            failures: Vec::new(),
        };
        let format = json!({"kind": "jpeg"});
        let frame = NewFrame {
            bytes: &jpeg,
            extension: "jpg",
            format,
            settings: Map::new(),
        };
        open.add_shot(shot, Some(frame)).unwrap();
    }
    let id = open.id().to_owned();
    store
        .close_series(
            open,
            SeriesState::Complete,
            &stamp(3600 * hour + 60),
            Vec::new(),
        )
        .unwrap();
    add_results(store, &id, results);
}

fn add_results(store: &Store, id: &str, results: &[Value]) {
    let flight = catalogue::list_flights(store.disk(), store.root())
        .unwrap()
        .pop()
        .unwrap();
    let all = catalogue::list_series(store.disk(), &flight).unwrap();
    let series = all.into_iter().find(|s| s.id == id).unwrap();
    let manifest = catalogue::read_series_manifest(store.disk(), &series).unwrap();
    for (frame, record) in series_frames(&series, manifest).iter().zip(results) {
        store
            .add_result(frame, &Inputs::new(Map::new()), record.clone())
            .unwrap();
    }
    store.seal();
}

/// Adds the `n`th series of a store: two frames, solved.
pub fn add_two_solved(store: &Store, inputs: &Inputs, n: u64, bytes: impl Fn(u32) -> Vec<u8>) {
    let plan = SeriesPlan {
        cause: SeriesCause::Scheduled,
        shots: 2,
    };
    let (mut series, _) = store.begin_series(plan, &stamp(100 * n)).unwrap();
    for shot in 1..=2_u32 {
        let bytes = bytes(shot);
        let stamp = stamp(100 * n + u64::from(shot));
        let shot = Shot {
            shot,
            stamp,
            duration_s: None,
            exposure: None,
            frame: None,
            failures: Vec::new(),
        };
        let frame = NewFrame {
            bytes: &bytes,
            extension: "jpg",
            format: json!("jpeg"),
            settings: Map::new(),
        };
        series.add_shot(shot, Some(frame)).unwrap();
    }
    store
        .close_series(
            series,
            SeriesState::Complete,
            &stamp(100 * n + 9),
            Vec::new(),
        )
        .unwrap();
    for frame in store.unsolved_frames(inputs).unwrap() {
        assert!(
            store
                .add_result(&frame, inputs, json!({"deflection_m": 2.74}))
                .unwrap()
        );
    }
    store.seal();
}

/// A time stamp within one boot.
pub fn stamp(second: u64) -> Stamp {
    let begin: jiff::Timestamp = "2026-03-01T08:00:00Z".parse().unwrap();
    Stamp {
        utc: begin + Duration::from_secs(second),
        utc_synchronised: true,
        boot_id: "boot".to_owned(),
        since_boot_s: second as f64,
    }
}

/// A small grey image.
pub fn jpeg() -> Vec<u8> {
    let luma: Vec<u8> = (0..240 * 160_u32).map(|i| (i % 240) as u8).collect();
    let mut bytes = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut bytes, 80);
    encoder
        .encode(&luma, 240, 160, jpeg_encoder::ColorType::Luma)
        .unwrap();
    bytes
}
