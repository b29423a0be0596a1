//! Promise: a store can be solved again years later, next to its old results, and the two are never mixed.

use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;

use serde_json::{Map, Value};
use wingd::store::verify::verify_path;
use wingd::store::{Inputs, RealDisk, Store, StoreConfig, catalogue};
use wingd_evaluation::results::source;
use wingd_evaluation::results::source::ResultChoice;

use crate::common::report_store::{solved, store_with};

fn wingd(arguments: &[&str], dir: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args(arguments)
        .current_dir(dir)
        .output()
        .unwrap()
}

fn text(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

#[test]
fn the_demo_store_is_solved_again_and_its_result_sets_are_distinguished_and_compared() {
    let dir = tempfile::tempdir().unwrap();
    let demo = wingd(&["demo", "--output", "demo"], dir.path());
    assert!(demo.status.success(), "{}", text(&demo));
    // Only the store is available: the installation is the one stored in it.
    let alone = Command::new("sh")
        .args(["-c", "mv demo/store store && rm -r demo"])
        .current_dir(dir.path())
        .status();
    assert!(alone.unwrap().success());
    let same = wingd(&["solve", "store", "--single"], dir.path());
    assert!(
        same.status.success() && text(&same).contains("already has a result from these inputs"),
        "{}",
        text(&same)
    );
    let again = wingd(
        &[
            "solve", "store", "--flight", "f0001", "--method", "profile", "--json",
        ],
        dir.path(),
    );
    assert!(again.status.success(), "{}", text(&again));
    let lines: Vec<Value> = String::from_utf8_lossy(&again.stdout)
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    assert_eq!(
        (lines.len(), &lines[0]["image"]),
        (10, &"s000001/0001.jpg".into())
    );
    let report = verify_path(&RealDisk, &dir.path().join("store"));
    assert!(report.is_sound() && report.results == 20, "{report:#?}");
    assert!(
        report
            .notes
            .iter()
            .any(|n| n.contains("results of 2 inputs")),
        "{:?}",
        report.notes
    );
    let together = wingd(&["solve", "store"], dir.path());
    assert!(
        together.status.success() && text(&together).contains("results of 3 inputs"),
        "{}",
        text(&together)
    );
    // Only the newest complete solve is shown.
    let data =
        source::read_flight(&dir.path().join("store"), ResultChoice::default(), None).unwrap();
    let records = || data.series.iter().flat_map(|s| &s.records);
    assert!(records().count() == 10 && records().all(|r| r.flight));
    // One camera, opened once: the recorder knows that it was not dismounted.
    let remarks: Vec<&String> = records().flat_map(|r| &r.remarks).collect();
    assert!(
        remarks
            .iter()
            .any(|r| r.contains("in 1 mounting(s) (as specified)")),
        "{remarks:?}"
    );
    assert!(data.warnings[0].contains("results of 3 inputs"));
    let page = wingd(&["report", "store"], dir.path());
    assert!(
        page.status.success() && text(&page).contains("results of 3 inputs"),
        "{}",
        text(&page)
    );
    let html = std::fs::read_to_string(dir.path().join("report.html")).unwrap();
    assert!(html.contains("results of 3 inputs"));
    let table = wingd(
        &["export", "store", "--format", "csv", "--table", "markers"],
        dir.path(),
    );
    assert!(
        table.status.success() && text(&table).contains("results of 3 inputs"),
        "{}",
        text(&table)
    );
    let mut csv = csv::Reader::from_reader(&table.stdout[..]);
    let inputs = csv
        .headers()
        .unwrap()
        .iter()
        .position(|h| h == "inputs")
        .unwrap();
    let keys: std::collections::BTreeSet<String> = csv
        .records()
        .map(|r| r.unwrap()[inputs].to_owned())
        .collect();
    assert_eq!(keys.len(), 1, "one solve in one table");
    let compared = wingd(&["compare", "store"], dir.path());
    assert!(
        compared.status.success() && text(&compared).contains("10 frames with a tip deflection"),
        "{}",
        text(&compared)
    );
    let lines = wingd(&["compare", "store", "--json"], dir.path());
    crate::json_schemas::assert_valid("compare", &lines.stdout);
    let first: Value = serde_json::from_str(
        String::from_utf8_lossy(&lines.stdout)
            .lines()
            .next()
            .unwrap(),
    )
    .unwrap();
    assert!(
        first["change_m"].as_f64().unwrap().abs() < 0.5 && first["sigma_m"].is_f64(),
        "{first}"
    );
    let missing = wingd(&["solve", "store", "--flight", "f0009"], dir.path());
    assert!(
        missing.status.code() == Some(1) && text(&missing).contains("no flight f0009"),
        "{}",
        text(&missing)
    );
}

/// Interrupts a solve after `done` of the frames.
fn interrupt_solve(root: &Path, done: usize) {
    let config = StoreConfig {
        reserve_mb: 0,
        ..StoreConfig::new(root)
    };
    let (store, _) = Store::open(Arc::new(RealDisk), config).unwrap();
    let inputs = Inputs::new(Map::from_iter([("program".to_owned(), "another".into())]));
    let flight = catalogue::list_flights(&RealDisk, root).unwrap().remove(0);
    for frame in store
        .unsolved_in_flight(&flight, &inputs)
        .unwrap()
        .iter()
        .take(done)
    {
        assert!(
            store
                .add_result(frame, &inputs, solved(9.9, 0.006))
                .unwrap()
        );
    }
    store.seal();
}

#[test]
fn an_interrupted_solve_changes_no_figure() {
    let store = store_with(&[
        &[solved(2.9, 0.006), solved(2.8, 0.006)],
        &[solved(2.1, 0.006)],
    ]);
    interrupt_solve(store.path(), 2);
    let deflections = |choice: ResultChoice| {
        let data = source::read_flight(store.path(), choice, None).unwrap();
        let tips = data
            .series
            .iter()
            .flat_map(|s| &s.records)
            .filter_map(|r| r.tip.as_ref())
            .map(|t| t.deflection_m);
        (tips.collect::<Vec<f64>>(), data.warnings)
    };
    let (shown, warnings) = deflections(ResultChoice::default());
    assert_eq!(shown, [2.9, 2.8, 2.1]);
    assert!(warnings[0].contains("results of 2 inputs"), "{warnings:?}");
    interrupt_solve(store.path(), 1);
    let (shown, warnings) = deflections(ResultChoice::default());
    assert_eq!(shown, [9.9; 3], "now it is complete");
    let key = warnings[0]
        .split("inputs, ")
        .nth(1)
        .unwrap()
        .split(' ')
        .next()
        .unwrap();
    assert_eq!(
        deflections(ResultChoice {
            flight: None,
            inputs: Some(key)
        })
        .0,
        [2.9, 2.8, 2.1],
        "and the old one is there still"
    );
    assert!(
        source::read_flight(
            store.path(),
            ResultChoice {
                flight: None,
                inputs: Some("zz")
            },
            None
        )
        .is_err()
    );
}
