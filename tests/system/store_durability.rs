//! Promise: what the store acknowledged survives a power cut at any moment, and nothing is solved twice.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use serde_json::{Map, Value, json};
use wingd::clock::Stamp;
use wingd::store::fake::{FakeDisk, Fault, files};
use wingd::store::manifest::{Cause, Failure, Shot, State};
use wingd::store::verify::verify;
use wingd::store::{Disk, Inputs, NewFrame, Plan, Store, StoreConfig, StoreError, catalogue, sha256};

const ROOT: &str = "store";

fn stamp(since_boot_s: f64) -> Stamp {
    let utc = jiff::Timestamp::from_millisecond((since_boot_s * 1e3) as i64).unwrap();
    Stamp { utc, utc_synchronised: false, boot_id: "boot".to_owned(), since_boot_s }
}

fn inputs() -> Inputs {
    let mut provenance = Map::new();
    provenance.insert("installation".to_owned(), json!("digest"));
    Inputs::new(provenance)
}

/// What the store said it has.
#[derive(Default, Clone)]
struct Acknowledged {
    frames: BTreeSet<String>,
    results: BTreeSet<String>,
    complete: BTreeSet<String>,
}

fn open(disk: &Arc<FakeDisk>) -> Result<Store, StoreError> {
    let mut config = StoreConfig::at(ROOT);
    config.reserve_mb = 0;
    Store::open(disk.clone() as Arc<dyn Disk>, config).map(|(store, _)| store)
}

/// A day's work: series with frames and failures, results between them.
fn work(store: &Store, time: &mut f64, series: u32, said: &mut Acknowledged) -> Result<(), StoreError> {
    for n in 0..series {
        take_series(store, time, n, said)?;
        solve(store, said)?;
    }
    Ok(())
}

fn take_series(store: &Store, time: &mut f64, n: u32, said: &mut Acknowledged) -> Result<(), StoreError> {
    let plan = Plan { cause: Cause::Scheduled, shots: 3 };
    *time += 60.0;
    let (mut series, _) = store.begin_series(plan, &stamp(*time))?;
    series.note_camera(json!({"name": "fake"}).as_object().cloned().unwrap())?;
    for shot in 1..=3 {
        *time += 1.0;
        let failed = (n + shot).is_multiple_of(5);
        let failures = if failed {
            vec![Failure { kind: "busy".to_owned(), reason: "busy".to_owned(), kept_as: None }]
        } else {
            Vec::new()
        };
        let bytes = format!("frame {n} {shot} {time} ").repeat(20 + n as usize).into_bytes();
        let shot = Shot { shot, stamp: stamp(*time), duration_s: Some(0.1), frame: None, failures };
        let frame = NewFrame { bytes: &bytes, extension: "jpg", format: Value::Null, settings: Map::new() };
        series.add_shot(shot, (!failed).then_some(frame))?;
        if !failed {
            said.frames.insert(sha256(&bytes));
        }
    }
    let id = series.id().to_owned();
    store.close_series(series, State::Complete, &stamp(*time), Vec::new())?;
    said.complete.insert(id);
    Ok(())
}

fn solve(store: &Store, said: &mut Acknowledged) -> Result<(), StoreError> {
    loop {
        let frames = store.unsolved(&inputs())?;
        if frames.is_empty() {
            return Ok(());
        }
        for frame in frames {
            store.read_frame(&frame)?;
            assert!(store.add_result(&frame, &inputs(), json!({"lift_m": 1.25}))?, "solved twice");
            said.results.insert(frame.entry.sha256);
        }
    }
}

/// Frames and numbers of results in the finished series.
fn holdings(disk: &dyn Disk) -> (BTreeSet<String>, BTreeMap<String, usize>, BTreeMap<String, State>) {
    let (mut frames, mut results, mut states) = (BTreeSet::new(), BTreeMap::new(), BTreeMap::new());
    for flight in catalogue::flights(disk, Path::new(ROOT)).unwrap() {
        for series in catalogue::series(disk, &flight).unwrap() {
            let manifest = catalogue::manifest(disk, &series).unwrap();
            states.insert(series.id.clone(), manifest.state);
            for frame in wingd::store::frames(&series, manifest) {
                wingd::store::read_frame(disk, &frame).unwrap();
                assert!(frames.insert(frame.entry.sha256), "a frame is there twice");
            }
            for line in catalogue::results(disk, &series).unwrap() {
                *results.entry(line.frame_sha256).or_insert(0) += 1;
            }
        }
    }
    (frames, results, states)
}

fn check(disk: &dyn Disk, said: &Acknowledged, when: &str) {
    let report = verify(disk, Path::new(ROOT));
    assert!(report.is_sound(), "{when}: {:#?}", report.faults);
    let (frames, results, states) = holdings(disk);
    let missing: Vec<_> = said.frames.difference(&frames).collect();
    assert!(missing.is_empty(), "{when}: acknowledged frames are missing: {missing:?}");
    for result in &said.results {
        assert_eq!(results.get(result), Some(&1), "{when}: an acknowledged result");
    }
    assert!(results.values().all(|count| *count == 1), "{when}: solved twice");
    for id in &said.complete {
        assert_eq!(states.get(id), Some(&State::Complete), "{when}: {id}");
    }
}

fn steps_of_the_work() -> u64 {
    let disk = Arc::new(FakeDisk::new(1, Vec::new()));
    let mut said = Acknowledged::default();
    work(&open(&disk).unwrap(), &mut 0.0, 3, &mut said).unwrap();
    check(disk.as_ref(), &said, "undisturbed");
    assert_eq!((said.frames.len(), said.results.len(), said.complete.len()), (8, 8, 3));
    disk.steps()
}

#[test]
fn a_power_cut_at_any_step_loses_nothing_acknowledged() {
    let steps = steps_of_the_work();
    assert!(steps > 100, "{steps}");
    for seed in 0..12 {
        for cut in 1..=steps {
            let when = format!("seed {seed}, cut at step {cut}");
            let disk = Arc::new(FakeDisk::new(seed * 1000 + cut, vec![Fault::PowerCut(cut)]));
            let (mut said, mut time) = (Acknowledged::default(), 0.0);
            let outcome = open(&disk).and_then(|store| work(&store, &mut time, 3, &mut said));
            assert!(outcome.is_err(), "{when}");
            recover_and_go_on(disk.power_up(Vec::new()), said, time, &when);
        }
    }
}

fn recover_and_go_on(disk: FakeDisk, mut said: Acknowledged, mut time: f64, when: &str) {
    let disk = Arc::new(disk);
    let store = open(&disk).unwrap_or_else(|error| panic!("{when}: {error}"));
    check(disk.as_ref(), &said, when);
    work(&store, &mut time, 1, &mut said).unwrap_or_else(|error| panic!("{when}: {error}"));
    check(disk.as_ref(), &said, when);
    let incoming = Path::new(ROOT).join("incoming");
    let left: Vec<_> = files(disk.as_ref(), &incoming).into_keys().collect();
    assert!(disk.list(&incoming).unwrap().is_empty(), "{when}: left in incoming: {left:?}");
}

/// The power goes again and again while the store recovers from the last time.
#[test]
fn power_cuts_during_recovery_lose_nothing_acknowledged() {
    let steps = steps_of_the_work();
    for cut in (20..=steps).step_by(3) {
        let disk = Arc::new(FakeDisk::new(cut, vec![Fault::PowerCut(cut)]));
        let (mut said, mut time) = (Acknowledged::default(), 0.0);
        let _ = open(&disk).and_then(|store| work(&store, &mut time, 3, &mut said));
        let mut disk = disk;
        for again in 1..=14 {
            let next = disk.power_up(vec![Fault::PowerCut(again)]);
            disk = Arc::new(next);
            let _ = open(&disk);
        }
        recover_and_go_on(disk.power_up(Vec::new()), said, time, &format!("cut at {cut}, then in recovery"));
    }
}

/// One step fails, the daemon goes on with the next series.
#[test]
fn a_failing_step_costs_one_series_at_most() {
    let steps = steps_of_the_work();
    for fail in 1..=steps {
        let when = format!("error at step {fail}");
        let disk = Arc::new(FakeDisk::new(fail, vec![Fault::Error(fail)]));
        let (mut said, mut time) = (Acknowledged::default(), 0.0);
        let store = match open(&disk) {
            Ok(store) => store,
            Err(_) => open(&disk).unwrap_or_else(|error| panic!("{when}: {error}")),
        };
        let mut failed = 0;
        for n in 0..4 {
            failed += u32::from(take_series(&store, &mut time, n, &mut said).is_err());
            failed += u32::from(solve(&store, &mut said).is_err());
        }
        assert!(failed <= 1, "{when}: {failed} failures");
        let _ = solve(&store, &mut said);
        drop(store);
        let _reopened = open(&disk).unwrap();
        check(disk.as_ref(), &said, &when);
    }
}

#[test]
fn a_full_disk_loses_nothing_acknowledged_and_recovers_when_there_is_room() {
    let steps = steps_of_the_work();
    for full in (20..=steps).step_by(2) {
        let when = format!("full at step {full}");
        let disk = Arc::new(FakeDisk::new(full, Vec::new()));
        let (mut said, mut time) = (Acknowledged::default(), 0.0);
        let store = open(&disk).unwrap();
        disk.set_faults(vec![Fault::Full(full)]);
        let error = work(&store, &mut time, 3, &mut said).expect_err(&when);
        assert!(error.is_full(), "{when}: {error}");
        let before = files(disk.as_ref(), Path::new(ROOT));
        assert!(before.len() > 1);
        disk.set_faults(Vec::new());
        work(&store, &mut time, 1, &mut said).unwrap_or_else(|error| panic!("{when}: {error}"));
        check(disk.as_ref(), &said, &when);
    }
}

#[test]
fn below_the_reserve_a_series_is_refused_and_the_refusal_recorded() {
    let disk = Arc::new(FakeDisk::new(1, Vec::new()));
    let mut config = StoreConfig::at(ROOT);
    config.reserve_mb = 100;
    let (store, _) = Store::open(disk.clone() as Arc<dyn Disk>, config).unwrap();
    disk.set_free(99_000_000);
    let plan = Plan { cause: Cause::Scheduled, shots: 3 };
    let refused = store.begin_series(plan, &stamp(1.0)).err().expect("refused");
    assert!(refused.to_string().contains("99 MB free, less than the reserve of 100 MB"), "{refused}");
    let record = disk.read(&Path::new(ROOT).join("refused.jsonl")).unwrap();
    assert!(String::from_utf8(record).unwrap().contains("99 MB free"));
    assert!(verify(disk.as_ref(), Path::new(ROOT)).notes.iter().any(|note| note.contains("refused")));
    disk.set_free(100_000_000);
    assert!(store.begin_series(plan, &stamp(2.0)).is_ok());
}

/// The test disk is worth something only if it punishes a missing sync.
#[test]
fn the_disk_forgets_what_was_not_synced() {
    let (mut lost_name, mut torn) = (0, 0);
    for seed in 0..64 {
        let disk = FakeDisk::new(seed, vec![Fault::Error(3)]);
        disk.write(Path::new("a"), b"whole").unwrap();
        let _ = disk.write(Path::new("b"), b"never synced");
        disk.set_faults(vec![Fault::PowerCut(4)]);
        let after = disk.power_up(Vec::new());
        match after.read(Path::new("a")) {
            Ok(bytes) => assert_eq!(bytes, b"whole"),
            Err(_) => lost_name += 1,
        }
        torn += u32::from(after.read(Path::new("b")).is_ok_and(|bytes| bytes != b"never "));
    }
    assert!(lost_name > 10 && torn > 5, "{lost_name} names lost, {torn} files torn");
}

#[test]
fn two_daemons_cannot_write_one_store() {
    let dir = tempfile::tempdir().unwrap();
    let config = StoreConfig::at(dir.path().join("store"));
    let real = || Arc::new(wingd::store::RealDisk) as Arc<dyn Disk>;
    let first = Store::open(real(), config.clone()).unwrap();
    let second = Store::open(real(), config.clone()).err().expect("refused");
    assert!(matches!(second, StoreError::Locked { .. }), "{second}");
    drop(first);
    assert!(Store::open(real(), config).is_ok());
}

#[test]
fn a_store_of_another_version_and_a_foreign_folder_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let real = || Arc::new(wingd::store::RealDisk) as Arc<dyn Disk>;
    std::fs::write(dir.path().join("thesis.doc"), "x").unwrap();
    let error = Store::open(real(), StoreConfig::at(dir.path())).err().expect("refused");
    assert!(error.to_string().contains("thesis.doc"), "{error}");
    std::fs::write(dir.path().join("store.toml"), "format = 7\n").unwrap();
    let error = Store::open(real(), StoreConfig::at(dir.path())).err().expect("refused");
    assert!(matches!(error, StoreError::Version { .. }), "{error}");
    assert!(error.to_string().contains("format 7"), "{error}");
}

#[test]
fn a_flight_continues_or_begins_as_the_rule_says() {
    let disk = Arc::new(FakeDisk::new(1, Vec::new()));
    let (mut said, mut time) = (Acknowledged::default(), 0.0);
    let store = open(&disk).unwrap();
    work(&store, &mut time, 1, &mut said).unwrap();
    drop(store);
    time += 3600.0;
    let store = open(&disk).unwrap();
    work(&store, &mut time, 1, &mut said).unwrap();
    assert_eq!(store.current_flight().as_deref(), Some("f0001"));
    time += 4.0 * 3600.0;
    work(&store, &mut time, 1, &mut said).unwrap();
    assert_eq!(store.current_flight().as_deref(), Some("f0002"));
    store.want_new_flight();
    work(&store, &mut time, 2, &mut said).unwrap();
    assert_eq!(store.current_flight().as_deref(), Some("f0003"));
    check(disk.as_ref(), &said, "three flights");
}
