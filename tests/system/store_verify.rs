//! Promise: `wingd verify` reports each broken invariant of docs/store.md by its number.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use crate::common::fake_disk::read_all_files;
use serde_json::{Map, Value, json};
use wingd::clock::Stamp;
use wingd::store::manifest::{SeriesCause, SeriesState, Shot};
use wingd::store::verify::verify_path;
use wingd::store::{Inputs, NewFrame, OpenSeries, RealDisk, SeriesPlan, Store, StoreConfig};

fn stamp(since_boot_s: f64) -> Stamp {
    let utc = jiff::Timestamp::from_second(since_boot_s as i64).unwrap();
    Stamp {
        utc,
        utc_synchronised: false,
        boot_id: "boot".to_owned(),
        since_boot_s,
    }
}

fn add(series: &mut OpenSeries, shot: u32, time: f64) {
    let bytes = format!("frame {shot} {time}");
    let shot = Shot {
        shot,
        stamp: stamp(time),
        duration_s: None,
        exposure: None,
        frame: None,
        failures: Vec::new(),
    };
    let format = json!({"kind": "jpeg"});
    let frame = NewFrame {
        bytes: bytes.as_bytes(),
        extension: "jpg",
        format,
        settings: Map::new(),
    };
    series.add_shot(shot, Some(frame)).unwrap();
}

/// A copy of one store, made once.
fn store() -> tempfile::TempDir {
    static MADE: OnceLock<(PathBuf, BTreeMap<PathBuf, Vec<u8>>)> = OnceLock::new();
    let (root, files) = MADE.get_or_init(|| {
        let made = make_store();
        (
            made.path().to_owned(),
            read_all_files(&RealDisk, made.path()),
        )
    });
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("partial")).unwrap();
    for (path, bytes) in files {
        let path = dir.path().join(path.strip_prefix(root).unwrap());
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    dir
}

/// Two series with results, and an open one.
fn make_store() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let mut config = StoreConfig::new(dir.path());
    config.reserve_mb = 0;
    let (store, _) = Store::open(Arc::new(RealDisk), config).unwrap();
    let plan = SeriesPlan {
        cause: SeriesCause::Scheduled,
        shots: 2,
    };
    for n in 0..2 {
        let time = 100.0 * f64::from(n);
        let (mut series, _) = store.begin_series(plan, &stamp(time)).unwrap();
        add(&mut series, 1, time + 1.0);
        add(&mut series, 2, time + 2.0);
        store
            .close_series(
                series,
                SeriesState::Complete,
                &stamp(time + 3.0),
                Vec::new(),
            )
            .unwrap();
    }
    let inputs = Inputs::new(Map::from_iter([(
        "program".to_owned(),
        Value::from("test"),
    )]));
    loop {
        let frames = store.unsolved_frames(&inputs).unwrap();
        if frames.is_empty() {
            break;
        }
        for frame in frames {
            assert!(
                store
                    .add_result(&frame, &inputs, json!({"deflection_m": 1.0}))
                    .unwrap()
            );
        }
    }
    let (mut open, _) = store.begin_series(plan, &stamp(300.0)).unwrap();
    add(&mut open, 1, 301.0);
    add(&mut open, 2, 302.0);
    dir
}

const SERIES: &str = "flights/f0001/s000001";

fn edit(root: &Path, file: &str, from: &str, to: &str) {
    let path = root.join(file);
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(
        text.contains(from),
        "{file} does not contain {from:?}: {text}"
    );
    std::fs::write(path, text.replacen(from, to, 1)).unwrap();
}

/// Numbers of the invariants found broken after `damage`.
fn broken_invariants(damage: impl FnOnce(&Path)) -> BTreeSet<u8> {
    let dir = store();
    let before = verify_path(&RealDisk, dir.path());
    assert!(before.is_sound(), "{:#?}", before.faults);
    assert_eq!((before.series, before.frames, before.results), (2, 4, 4));
    damage(dir.path());
    let report = verify_path(&RealDisk, dir.path());
    assert!(report.faults.iter().all(|fault| !fault.what.is_empty()));
    // Invariants 14 to 18, the evidence, detect most of it too: tests/system/store_evidence.rs.
    report
        .faults
        .iter()
        .map(|fault| fault.invariant)
        .filter(|invariant| *invariant <= 13)
        .collect()
}

fn only_invariant(invariant: u8) -> BTreeSet<u8> {
    BTreeSet::from([invariant])
}

fn series_file(name: &str) -> PathBuf {
    Path::new(SERIES).join(name)
}

#[test]
fn invariant_1_the_format_file() {
    assert_eq!(
        broken_invariants(|root| edit(root, "store.toml", "format = 2", "format = 3")),
        only_invariant(1)
    );
    assert_eq!(
        broken_invariants(|root| edit(root, "store.toml", "format = 2", "")),
        only_invariant(1)
    );
    assert_eq!(
        broken_invariants(|root| std::fs::remove_file(root.join("store.toml")).unwrap()),
        only_invariant(1)
    );
}

#[test]
fn invariant_2_the_counter_is_above_every_id() {
    assert_eq!(
        broken_invariants(|root| edit(
            root,
            "counter.json",
            "\"next_series\":4",
            "\"next_series\":3"
        )),
        only_invariant(2)
    );
    assert_eq!(
        broken_invariants(|root| edit(
            root,
            "counter.json",
            "\"next_flight\":2",
            "\"next_flight\":1"
        )),
        only_invariant(2)
    );
    assert_eq!(
        broken_invariants(|root| std::fs::write(root.join("counter.json"), "{").unwrap()),
        only_invariant(2)
    );
}

#[test]
fn invariant_3_flights_contain_their_manifest_and_series_only() {
    assert_eq!(
        broken_invariants(
            |root| std::fs::remove_file(root.join("flights/f0001/flight.json")).unwrap()
        ),
        only_invariant(3)
    );
    assert_eq!(
        broken_invariants(|root| edit(root, "flights/f0001/flight.json", "f0001", "f0002")),
        only_invariant(3)
    );
    assert_eq!(
        broken_invariants(
            |root| std::fs::write(root.join("flights/f0001/notes.txt"), "x").unwrap()
        ),
        only_invariant(3)
    );
    assert_eq!(
        broken_invariants(|root| std::fs::create_dir(root.join("flights/spare")).unwrap()),
        only_invariant(3)
    );
}

#[test]
fn invariant_4_a_series_has_its_manifest_and_an_id_of_its_own() {
    assert_eq!(
        broken_invariants(
            |root| std::fs::remove_file(root.join(series_file("series.json"))).unwrap()
        ),
        only_invariant(4)
    );
    let file = format!("{SERIES}/series.json");
    assert_eq!(
        broken_invariants(|root| edit(root, &file, "\"s000001\"", "\"s000002\"")),
        only_invariant(4)
    );
    assert_eq!(
        broken_invariants(|root| edit(root, &file, "\"format\": 1", "\"format\": 9")),
        only_invariant(4)
    );
    assert_eq!(
        broken_invariants(|root| edit(root, &file, "}", "")),
        only_invariant(4)
    );
    let doubled = |root: &Path| {
        std::fs::create_dir(root.join("incoming/s000001")).unwrap();
    };
    assert_eq!(broken_invariants(doubled), only_invariant(4));
}

#[test]
fn invariant_5_every_frame_has_its_size_and_hash() {
    let frame = format!("{SERIES}/0001.jpg");
    assert_eq!(
        broken_invariants(|root| edit(root, &frame, "frame", "flame")),
        only_invariant(5)
    );
    assert_eq!(
        broken_invariants(|root| edit(root, &frame, "frame", "fra")),
        only_invariant(5)
    );
    let gone = broken_invariants(|root| std::fs::remove_file(root.join(&frame)).unwrap());
    assert_eq!(gone, only_invariant(5));
}

#[test]
fn invariant_6_a_series_contains_nothing_else() {
    let write = |name: &'static str| {
        move |root: &Path| std::fs::write(root.join(series_file(name)), "x").unwrap()
    };
    assert_eq!(broken_invariants(write("0003.jpg")), only_invariant(6));
    assert_eq!(broken_invariants(write("0001.jpg.part")), only_invariant(6));
}

#[test]
fn invariant_7_shots_are_in_order_and_accounted_for() {
    let file = format!("{SERIES}/series.json");
    assert_eq!(
        broken_invariants(|root| edit(root, &file, "\"planned_shots\": 2", "\"planned_shots\": 3")),
        only_invariant(7)
    );
    assert_eq!(
        broken_invariants(|root| edit(root, &file, "\"shot\": 1", "\"shot\": 2")),
        only_invariant(7)
    );
}

#[test]
fn invariant_8_time_since_boot_does_not_go_back() {
    let file = format!("{SERIES}/series.json");
    assert_eq!(
        broken_invariants(|root| edit(
            root,
            &file,
            "\"since_boot_s\": 2.0",
            "\"since_boot_s\": 0.5"
        )),
        only_invariant(8)
    );
    assert_eq!(
        broken_invariants(|root| edit(
            root,
            &file,
            "\"since_boot_s\": 3.0",
            "\"since_boot_s\": 150.0"
        )),
        only_invariant(8)
    );
}

#[test]
fn invariant_9_every_line_of_results_is_complete() {
    let file = format!("{SERIES}/results.jsonl");
    assert_eq!(
        broken_invariants(|root| edit(root, &file, "{", "")),
        only_invariant(9)
    );
}

#[test]
fn invariant_10_a_result_belongs_to_a_frame_of_its_series() {
    let file = format!("{SERIES}/results.jsonl");
    assert_eq!(
        broken_invariants(|root| edit(root, &file, "0001.jpg", "0007.jpg")),
        only_invariant(10)
    );
}

#[test]
fn invariant_11_one_result_for_the_same_inputs() {
    let twice = |root: &Path| {
        let path = root.join(series_file("results.jsonl"));
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, format!("{text}{text}")).unwrap();
    };
    assert_eq!(broken_invariants(twice), only_invariant(11));
}

#[test]
fn invariant_12_the_key_is_the_hash_of_the_inputs() {
    let file = format!("{SERIES}/results.jsonl");
    assert_eq!(
        broken_invariants(|root| edit(
            root,
            &file,
            "\"program\":\"test\"",
            "\"program\":\"other\""
        )),
        only_invariant(12)
    );
}

#[test]
fn invariant_13_acknowledged_frames_in_incoming_are_complete() {
    assert_eq!(
        broken_invariants(|root| edit(root, "incoming/s000003/0001.jpg", "frame", "flame")),
        only_invariant(13)
    );
}

#[test]
fn a_torn_last_line_is_a_note_and_is_repaired() {
    let file = series_file("results.jsonl");
    // As a power cut leaves it during the write: the line is announced and partly there.
    let torn = |root: &Path| {
        let text = std::fs::read(root.join(&file)).unwrap();
        let half = [text.as_slice(), &text[..20]].concat();
        let announced =
            json!({"flight": "f0001", "series": "s000001", "bytes": 2 * text.len(), "sha256": ""});
        std::fs::write(root.join("pending.json"), announced.to_string()).unwrap();
        std::fs::write(root.join(&file), half).unwrap();
    };
    let dir = store();
    torn(dir.path());
    let report = verify_path(&RealDisk, dir.path());
    assert!(report.is_sound(), "{:#?}", report.faults);
    assert_eq!(broken_invariants(torn), BTreeSet::new());
    let dir = store();
    torn(dir.path());
    let (store, _) = Store::open(Arc::new(RealDisk), StoreConfig::new(dir.path())).unwrap();
    let inputs = Inputs::new(Map::from_iter([(
        "program".to_owned(),
        Value::from("another"),
    )]));
    let newest = store.unsolved_frames(&inputs).unwrap();
    assert_eq!(newest.len(), 2, "the recovered series comes first");
    let mut solved = 0;
    loop {
        let frames = store.unsolved_frames(&inputs).unwrap();
        if frames.is_empty() {
            break;
        }
        for frame in frames {
            assert!(
                store
                    .add_result(&frame, &inputs, json!({"deflection_m": 2.0}))
                    .unwrap()
            );
            solved += 1;
        }
    }
    assert_eq!(solved, 6);
    let report = verify_path(&RealDisk, dir.path());
    assert!(report.is_sound() && report.results == 10, "{report:#?}");
    let partial: Vec<_> = std::fs::read_dir(dir.path().join("partial"))
        .unwrap()
        .collect();
    assert_eq!(partial.len(), 1, "the torn bytes are kept");
}

#[test]
fn a_copied_flight_or_series_is_verified_too() {
    let dir = store();
    for (part, series) in [("flights/f0001", 2), (SERIES, 1)] {
        let report = verify_path(&RealDisk, &dir.path().join(part));
        assert!(report.is_sound(), "{part}: {:#?}", report.faults);
        assert_eq!(report.series, series);
    }
    edit(dir.path(), &format!("{SERIES}/0002.jpg"), "frame", "flame");
    assert!(!verify_path(&RealDisk, &dir.path().join("flights/f0001")).is_sound());
    assert!(
        !verify_path(&RealDisk, &dir.path().join("incoming")).is_sound(),
        "not a store"
    );
}

proptest::proptest! {
    #![proptest_config(proptest::test_runner::Config { cases: 100, failure_persistence: None, ..Default::default() })]

    /// Bytes replaced anywhere in any file: a verdict, never a panic, and opening survives it too.
    #[test]
    fn damaged_files_are_survived(which in 0usize..32, at in 0.0f64..1.0, bytes in proptest::collection::vec(proptest::num::u8::ANY, 1..24)) {
        let dir = store();
        let before = read_all_files(&RealDisk, dir.path());
        let small: Vec<_> = before.iter().filter(|(path, _)| !path.ends_with("lock")).collect();
        let (path, old) = small[which % small.len()];
        let mut new = old.clone();
        let start = (at * new.len() as f64) as usize;
        for (i, byte) in bytes.iter().enumerate() {
            match new.get_mut(start + i) {
                Some(place) => *place = *byte,
                None => new.push(*byte),
            }
        }
        std::fs::write(path, &new).unwrap();
        let report = verify_path(&RealDisk, dir.path());
        let whole_frames = 6 - usize::from(path.extension().is_some_and(|ending| ending == "jpg") && new != *old);
        if let Ok((store, _)) = Store::open(Arc::new(RealDisk), StoreConfig::new(dir.path())) {
            let inputs = Inputs::new(Map::new());
            let _ = store.unsolved_frames(&inputs);
            drop(store);
            let after = read_all_files(&RealDisk, dir.path());
            let frames = after.keys().filter(|path| path.extension().is_some_and(|ending| ending == "jpg"));
            proptest::prop_assert!(frames.count() >= whole_frames.min(5), "a frame went missing: {report:#?}");
        }
    }
}
