//! Promise: live results are read back as recorded, are covered by the chain, and disturb no series.
//! (Power cuts and failures at every step: store_faults.)

use crate::common::store_reading::read_live;
use std::path::Path;
use std::sync::Arc;

use crate::common::fake_disk::{DiskFault, FakeDisk};
use serde_json::{Value, json};
use wingd::store::manifest::{SeriesCause, SeriesState};
use wingd::store::verify::verify_path;
use wingd::store::{
    Disk, FlightRef, LiveColumn, LiveRow, LiveTable, RealDisk, Store, StoreConfig, StoreError,
    ValueKind, catalogue, live,
};

use super::http_pages::Server;
use crate::common::random::{normal, rng};
use crate::common::report_store::stamp;
use crate::common::store_work::{ROOT, Work, live_row, live_table, moment};
use crate::program::{outcome, stdout};

fn open(root: &Path) -> Store {
    let config = StoreConfig {
        reserve_mb: 0,
        ..StoreConfig::new(root)
    };
    Store::open(Arc::new(RealDisk), config).unwrap().0
}

fn flights(root: &Path) -> Vec<FlightRef> {
    catalogue::list_flights(&RealDisk, root).unwrap()
}

fn rows(numbers: std::ops::Range<u32>) -> Vec<LiveRow> {
    numbers.map(live_row).collect()
}

/// Two flights: one with two tables, one still open.
fn made() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    store
        .append_live_rows(&live_table("one"), &rows(0..20), &stamp(10))
        .unwrap();
    store
        .append_live_rows(&live_table("one"), &rows(20..41), &stamp(12))
        .unwrap();
    store
        .append_live_rows(&live_table("two"), &rows(41..50), &stamp(14))
        .unwrap();
    store.request_new_flight();
    store
        .append_live_rows(&live_table("two"), &rows(50..60), &stamp(16))
        .unwrap();
    dir
}

#[test]
fn each_flight_and_table_has_its_own_file_and_the_open_one_is_read_too() {
    let dir = made();
    let [first, second] = &flights(dir.path())[..] else {
        panic!("two flights")
    };
    assert_eq!(
        live::closed_files(&RealDisk, first).unwrap(),
        ["live-000001.rows", "live-000002.rows"]
    );
    assert!(live::closed_files(&RealDisk, second).unwrap().is_empty());
    let sums = std::fs::read_to_string(first.folder.join("SHA256SUMS")).unwrap();
    assert!(
        sums.contains("  live-000001.rows") && sums.contains("  live-000002.rows"),
        "{sums}"
    );
    let of = |flight: &FlightRef| {
        let (files, notes) = read_live(&RealDisk, dir.path(), flight).unwrap();
        assert!(notes.is_empty(), "{notes:?}");
        let numbers = |rows: &[LiveRow]| rows.iter().map(|row| row[1] as u32).collect::<Vec<_>>();
        files
            .iter()
            .map(|(head, rows)| (head.table.clone(), numbers(rows)))
            .collect::<Vec<_>>()
    };
    let (one, two) = (live_table("one"), live_table("two"));
    assert_eq!(
        of(first),
        [(one, (0..41).collect()), (two.clone(), (41..50).collect())]
    );
    assert_eq!(of(second), [(two, (50..60).collect())]);
    let report = verify_path(&RealDisk, dir.path());
    assert!(report.is_sound(), "{report:#?}");
    // The next recorder closes the file that this one left open.
    drop(open(dir.path()));
    assert_eq!(
        live::closed_files(&RealDisk, second).unwrap(),
        ["live-000001.rows"]
    );
    assert!(verify_path(&RealDisk, dir.path()).is_sound());
}

#[test]
fn a_long_file_is_closed_and_the_next_one_begun() {
    let disk = Arc::new(FakeDisk::default());
    let config = StoreConfig {
        reserve_mb: 0,
        ..StoreConfig::new(ROOT)
    };
    let (store, _) = Store::open(disk.clone() as Arc<dyn Disk>, config).unwrap();
    let column = LiveColumn {
        name: "x".to_owned(),
        unit: "m".to_owned(),
        kind: ValueKind::F64,
        width: 1000,
    };
    let table = LiveTable {
        source: json!({}),
        columns: vec![column],
    };
    let mut draw = rng(1);
    let wide: Vec<LiveRow> = (0..300)
        .map(|_| (0..1000).map(|_| normal(&mut draw)).collect())
        .collect();
    for n in 0..9 {
        store
            .append_live_rows(&table, &wide, &moment(f64::from(n)))
            .unwrap();
    }
    store.close_live_file().unwrap();
    let flight = catalogue::list_flights(disk.as_ref(), Path::new(ROOT))
        .unwrap()
        .remove(0);
    let (files, _) = read_live(disk.as_ref(), Path::new(ROOT), &flight).unwrap();
    let lengths: Vec<usize> = files.iter().map(|(_, rows)| rows.len()).collect();
    assert!(
        lengths.len() == 3 && lengths.iter().sum::<usize>() == 2700,
        "{lengths:?}"
    );
    assert!(
        files
            .iter()
            .all(|(_, rows)| rows.chunks(300).all(|rows| rows == wide))
    );
    assert!(verify_path(disk.as_ref(), Path::new(ROOT)).is_sound());
}

#[test]
fn changed_bytes_and_missing_or_added_files_are_found() {
    let dir = made();
    let flight = flights(dir.path()).remove(0);
    let file = flight.folder.join("live-000001.rows");
    let whole = std::fs::read(&file).unwrap();
    let faults = |path: &Path| {
        let report = verify_path(&RealDisk, path);
        report
            .faults
            .into_iter()
            .map(|fault| fault.invariant)
            .collect::<Vec<u8>>()
    };
    for at in 0..whole.len() {
        let mut changed = whole.clone();
        changed[at] ^= 1;
        std::fs::write(&file, &changed).unwrap();
        assert_eq!(faults(&flight.folder), [21], "byte {at}");
    }
    let (status, printed) = outcome(&["verify", dir.path().to_str().unwrap()]);
    assert!(
        status == Some(1) && printed.contains("live-000001.rows: does not have the SHA-256"),
        "{printed}"
    );
    std::fs::remove_file(&file).unwrap();
    assert_eq!(faults(dir.path()), [21]);
    std::fs::write(&file, &whole).unwrap();
    std::fs::write(flight.folder.join("live-000003.rows"), &whole).unwrap();
    assert_eq!(faults(dir.path()), [21]);
}

#[test]
fn a_torn_or_zeroed_end_is_set_aside_and_the_intact_blocks_are_kept() {
    for tail in [&b"wingdrow\x05"[..], &[0; 700]] {
        let dir = made();
        let path = dir.path().join("live.rows");
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.extend(tail);
        std::fs::write(&path, bytes).unwrap();
        let flight = flights(dir.path()).remove(1);
        let (files, notes) = read_live(&RealDisk, dir.path(), &flight).unwrap();
        let torn = format!("its last {} bytes are torn", tail.len());
        assert!(
            files[0].1.len() == 10 && notes[0].contains(&torn),
            "{notes:?}"
        );
        drop(open(dir.path()));
        let (files, notes) = read_live(&RealDisk, dir.path(), &flight).unwrap();
        assert!(files[0].1.len() == 10 && notes.is_empty(), "{notes:?}");
        let aside: Vec<_> = RealDisk.list(&dir.path().join("partial")).unwrap();
        assert!(
            aside.len() == 1 && aside[0].length == tail.len() as u64,
            "{aside:?}"
        );
        assert!(verify_path(&RealDisk, dir.path()).is_sound());
    }
}

#[test]
fn a_copy_and_a_fetched_flight_contain_the_live_results() {
    let dir = made();
    drop(open(dir.path()));
    let from = dir.path().to_str().unwrap();
    let (copied, fetched) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (status, printed) = outcome(&["copy", from, copied.path().to_str().unwrap()]);
    assert_eq!(status, Some(0), "{printed}");
    let server = Server::start(dir.path());
    let url = format!("http://{}", server.address);
    for flight in ["f0001", "f0002"] {
        let (status, printed) = outcome(&[
            "copy",
            &url,
            fetched.path().to_str().unwrap(),
            "--flight",
            flight,
        ]);
        assert_eq!(status, Some(0), "{printed}");
    }
    for (place, flight) in [&copied, &fetched]
        .into_iter()
        .flat_map(|to| flights(to.path()).into_iter().map(move |f| (to, f)))
    {
        let here = FlightRef {
            folder: dir.path().join("flights").join(&flight.id),
            id: flight.id.clone(),
        };
        let read = |root: &Path, flight: &FlightRef| {
            format!("{:?}", read_live(&RealDisk, root, flight).unwrap())
        };
        assert_eq!(read(place.path(), &flight), read(dir.path(), &here));
    }
    assert_eq!(
        (flights(copied.path()).len(), flights(fetched.path()).len()),
        (2, 2)
    );
}

#[test]
fn nothing_is_recorded_below_the_reserve_or_if_rows_do_not_fit() {
    let disk = Arc::new(FakeDisk::default());
    let (store, _) = Store::open(disk.clone() as Arc<dyn Disk>, StoreConfig::new(ROOT)).unwrap();
    store
        .append_live_rows(&live_table("one"), &rows(0..2), &moment(1.0))
        .unwrap();
    disk.set_free_bytes(1_000_000);
    let refused = store
        .append_live_rows(&live_table("one"), &rows(2..4), &moment(2.0))
        .unwrap_err();
    assert!(
        refused.is_full() && refused.to_string().contains("1 MB free"),
        "{refused}"
    );
    disk.set_free_bytes(u64::MAX);
    let misfit = store
        .append_live_rows(&live_table("one"), &[vec![1.0]], &moment(3.0))
        .unwrap_err();
    assert!(
        misfit
            .to_string()
            .contains("a row has 1 values, its table 6"),
        "{misfit}"
    );
    store
        .append_live_rows(&live_table("one"), &rows(4..5), &moment(4.0))
        .unwrap();
    let flight = catalogue::list_flights(disk.as_ref(), Path::new(ROOT))
        .unwrap()
        .remove(0);
    let (files, notes) = read_live(disk.as_ref(), Path::new(ROOT), &flight).unwrap();
    let numbers: Vec<u32> = files[0].1.iter().map(|row| row[1] as u32).collect();
    assert_eq!((numbers, files.len(), notes.len()), (vec![0, 1, 4], 1, 0));
}

/// Nine hours with live results alone: they prevent the flight from ending, in the next process too.
#[test]
fn live_results_keep_their_flight_together() {
    let disk = Arc::new(FakeDisk::default());
    let open = || {
        let config = StoreConfig {
            reserve_mb: 0,
            ..StoreConfig::new(ROOT)
        };
        Store::open(disk.clone() as Arc<dyn Disk>, config)
            .unwrap()
            .0
    };
    let mut store = open();
    for hour in 0..9_u32 {
        if hour == 5 {
            store = open();
        }
        let program = if hour % 2 == 0 { "one" } else { "two" };
        store
            .append_live_rows(
                &live_table(program),
                &rows(hour..hour + 1),
                &moment(3600.0 * f64::from(hour)),
            )
            .unwrap();
    }
    assert_eq!(
        catalogue::list_flights(disk.as_ref(), Path::new(ROOT))
            .unwrap()
            .len(),
        1
    );
    store
        .append_live_rows(&live_table("one"), &rows(9..10), &moment(12.0 * 3600.0))
        .unwrap();
    assert_eq!(
        catalogue::list_flights(disk.as_ref(), Path::new(ROOT))
            .unwrap()
            .len(),
        2,
        "four hours later"
    );
}

/// After any failure of a series of an event, the open series has its frames and closes.
#[test]
fn an_event_series_leaves_the_open_series_untouched_whichever_step_fails() {
    let event = |work: &mut Work, store: &Store| -> Result<(), StoreError> {
        let mut series = work.begin(store, SeriesCause::Event, 0)?;
        series.add_remark("a gust")?;
        work.shoot(&mut series, 1)?;
        work.shoot(&mut series, 2)?;
        work.finish(store, series)
    };
    for step in 1.. {
        let mut work = Work::new(FakeDisk::default());
        let store = work.open().unwrap();
        let mut hourly = work.begin(&store, SeriesCause::Scheduled, 3).unwrap();
        work.shoot(&mut hourly, 1).unwrap();
        let at = work.disk.steps() + step;
        work.disk.set_faults(vec![DiskFault::Error(at)]);
        let failed = event(&mut work, &store).is_err();
        let all_steps = work.disk.steps() < at;
        work.disk.set_faults(Vec::new());
        work.shoot(&mut hourly, 2).unwrap();
        // The next series recovers the failed one, and not the open one.
        let live = work.begin(&store, SeriesCause::Live, 0).unwrap();
        work.shoot(&mut hourly, 3).unwrap();
        let id = hourly.id().to_owned();
        work.finish(&store, hourly).unwrap();
        drop(live);
        work.check()
            .unwrap_or_else(|why| panic!("step {step}: {why}"));
        let of = |name: &str| {
            let flight = catalogue::list_flights(work.disk.as_ref(), Path::new(ROOT))
                .unwrap()
                .remove(0);
            let all = catalogue::list_series(work.disk.as_ref(), &flight).unwrap();
            let found = all.into_iter().find(|series| series.id == name);
            found
                .map(|series| catalogue::read_series_manifest(work.disk.as_ref(), &series).unwrap())
        };
        let manifest = of(&id).unwrap();
        assert_eq!(
            (manifest.state, manifest.shots.len(), manifest.remarks.len()),
            (SeriesState::Complete, 3, 0)
        );
        if all_steps {
            let event = of("s000002").unwrap();
            assert!(!failed && step > 20, "{step} steps");
            assert_eq!(
                (event.cause, event.planned_shots, event.remarks),
                (SeriesCause::Event, 2, vec!["a gust".to_owned()])
            );
            return;
        }
    }
}

/// Frames from before the event, with frames of the hourly series before and after.
#[test]
fn frames_of_a_ring_are_older_than_their_series_and_that_is_no_fault() {
    let mut work = Work::new(FakeDisk::default());
    let store = work.open().unwrap();
    let mut hourly = work.begin(&store, SeriesCause::Scheduled, 2).unwrap();
    work.shoot(&mut hourly, 1).unwrap();
    let mut event = work.begin(&store, SeriesCause::Event, 0).unwrap();
    work.time_s -= 70.0;
    work.shoot(&mut event, 1).unwrap();
    work.time_s += 90.0;
    work.shoot(&mut hourly, 2).unwrap();
    work.finish(&store, hourly).unwrap();
    work.time_s += 5.0;
    work.finish(&store, event).unwrap();
    work.check().unwrap();
    assert_eq!(store.last_moment().unwrap().since_boot_s, work.time_s);
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn live_results_are_exported_with_units_zones_and_names() {
    let dir = made();
    let csv = stdout(&[
        "export",
        text(dir.path()),
        "--format",
        "csv",
        "--table",
        "live",
    ]);
    let mut lines = csv.lines();
    let columns = lines.next().unwrap();
    let heading =
        "recorder_id,flight,result_id,boot_id,utc,utc_synchronised,since_boot_s,exposure_sigma_s,";
    assert!(
        columns.starts_with(heading) && columns.contains(",weight_kg,sigma_weight_kg,"),
        "{columns}"
    );
    assert!(
        columns.ends_with(",program,installation_sha256,parameters,inputs,schema_version"),
        "{columns}"
    );
    let row: Vec<&str> = lines.nth(3).unwrap().split(',').collect();
    let of = |name: &str| {
        row[columns
            .split(',')
            .position(|column| column == name)
            .unwrap()]
    };
    let names = [
        "flight",
        "boot_id",
        "utc",
        "number",
        "deflection_M1_m",
        "deflection_M2_m",
        "deflection_M3_m",
        "latency_ms",
    ];
    let printed = [
        "f0001",
        "boot",
        "2001-09-09T01:46:40.300000Z",
        "3",
        "0.503",
        "",
        "1.5",
        "80.25",
    ];
    assert_eq!(names.map(of), printed);
    assert_eq!(
        (of("exposure_time"), of("schema_version")),
        (of("utc"), "3")
    );
    assert!(of("result_id").starts_with("boot/"), "{}", of("result_id"));
    assert_eq!(csv.lines().count(), 61);
    let one = [
        "export",
        text(dir.path()),
        "--format",
        "jsonl",
        "--table",
        "live",
        "--flight",
        "f0002",
    ];
    let objects: Vec<Value> = stdout(&one)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(
        (
            objects.len(),
            &objects[0]["number"],
            &objects[0]["deflection_M2_m"]
        ),
        (10, &json!(50), &Value::Null)
    );
    assert_eq!(
        (&objects[0]["utc"], &objects[1]["deflection_M1_m"]),
        (&json!("2001-09-09T01:46:45.000000Z"), &json!(0.502))
    );
    let ids = |lines: &str| {
        let of = |line: &str| line.split(',').nth(2).unwrap().to_owned();
        lines
            .lines()
            .skip(1)
            .map(of)
            .collect::<std::collections::BTreeSet<_>>()
            .len()
    };
    assert_eq!(ids(&csv), 60, "each result has a key of its own");
    let file = dir.path().with_extension("parquet");
    stdout(&[
        "export",
        text(dir.path()),
        "--format",
        "parquet",
        "--table",
        "live",
        "-o",
        text(&file),
    ]);
    let bytes = std::fs::read(&file).unwrap();
    assert!(bytes.starts_with(b"PAR1") && bytes.ends_with(b"PAR1"));
    std::fs::remove_file(file).unwrap();
    let (status, printed) = outcome(&[
        "export",
        text(dir.path()),
        "--format",
        "csv",
        "--table",
        "live",
        "--inputs",
        "0",
    ]);
    assert!(
        status == Some(2) && printed.contains("never solved again"),
        "{status:?} {printed}"
    );
    let empty = tempfile::tempdir().unwrap();
    drop(open(empty.path()));
    let (status, printed) = outcome(&[
        "export",
        text(empty.path()),
        "--format",
        "csv",
        "--table",
        "live",
    ]);
    assert!(
        status == Some(1) && printed.contains("no live results"),
        "{printed}"
    );
}
