//! Promise: a copy is complete or is no store, after any interruption; only verified copies permit deletion.

use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;

use crate::common::fake_disk::{DiskFault, FakeDisk, Survival, read_all_files};
use serde_json::{Map, json};
use wingd::store::bundle::{self, BundleContent};
use wingd::store::prune::CopyProof;
use wingd::store::receive::{Listing, Receiver};
use wingd::store::verify::verify_path;
use wingd::store::{Disk, Inputs, RealDisk, Store, StoreConfig, StoreError, catalogue};

use crate::common::report_store::{add_two_solved, stamp};
use crate::common::store_work::{live_row, live_table};

use crate::program::run;

const FROM: &str = "from";
const TO: &str = "to";

fn open(disk: Arc<dyn Disk>, root: &Path) -> Result<Store, StoreError> {
    Store::open(
        disk,
        StoreConfig {
            reserve_mb: 0,
            ..StoreConfig::new(root)
        },
    )
    .map(|(store, _)| store)
}

/// `wanted` flights of two series of two frames each, solved.
fn fill(store: &Store, wanted: u64) {
    let inputs = Inputs::new(Map::from_iter([("program".to_owned(), "test".into())]));
    let done = catalogue::list_flights(store.disk(), store.root())
        .unwrap()
        .len() as u64;
    for n in 2 * done..2 * wanted {
        if n.is_multiple_of(2) {
            store.request_new_flight();
        }
        add_two_solved(store, &inputs, n, |shot| {
            format!("frame {shot} of {n} ").repeat(9).into_bytes()
        });
        if !n.is_multiple_of(2) {
            let now = stamp(100 * n + 20);
            store
                .append_live_rows(&live_table("test"), &[live_row(n as u32)], &now)
                .unwrap();
            store.close_live_file().unwrap();
        }
    }
}

/// Copies as `wingd copy` does.
fn copy(disk: &dyn Disk) -> Result<bool, StoreError> {
    let receiver = Receiver::open(disk, Path::new(TO))?;
    for flight in catalogue::list_flights(disk, Path::new(FROM))? {
        let bundle = bundle::bundle_flight(disk, Path::new(FROM), &flight)?;
        let listing = Listing::from_bundle(&flight.id, &bundle);
        receiver.prepare_flight(&listing)?;
        let missing = receiver.missing_files(&listing, false);
        for (item, listed) in bundle
            .items
            .iter()
            .zip(&listing.items)
            .filter(|(_, l)| missing.contains(l))
        {
            let bytes = match &item.content {
                BundleContent::Bytes(bytes) => bytes.clone(),
                BundleContent::File(path) => disk.read(path).map_err(|source| StoreError::Io {
                    path: path.clone(),
                    doing: "read",
                    source,
                })?,
            };
            receiver.accept_file(listed, &bytes)?;
        }
        receiver.commit_flight(&listing)?;
    }
    Ok(receiver.finish()?.is_sound())
}

fn assert_no_partial_store(disk: &dyn Disk, when: &str) {
    if disk.exists(&Path::new(TO).join("store.toml")) {
        let report = verify_path(disk, Path::new(TO));
        assert!(report.is_sound(), "{when}: {:#?}", report.faults);
    }
}

/// A fault at every step of a copy; then the power comes back and the copy is made again.
fn copy_with_faults(before: impl Fn(&Arc<FakeDisk>), fault: fn(u64) -> DiskFault) {
    for step in 1.. {
        let disk = Arc::new(FakeDisk::new(Vec::new()));
        before(&disk);
        let from = disk.steps();
        disk.set_faults(vec![fault(from + step)]);
        let outcome = copy(disk.as_ref());
        let whole = disk.steps() < from + step;
        let disk = disk.power_up(Survival::random(step));
        assert_no_partial_store(&disk, &format!("step {step}"));
        assert!(copy(&disk).unwrap(), "step {step}: repeated");
        let report = verify_path(&disk, Path::new(TO));
        assert!(
            report.is_sound() && report.frames == 8 && report.results == 8,
            "step {step}: {report:#?}"
        );
        if whole {
            assert!(
                outcome.unwrap() && step > 60,
                "the last step of a copy that met no fault: {step}"
            );
            return;
        }
    }
}

#[test]
fn a_copy_survives_a_power_cut_at_every_step() {
    copy_with_faults(
        |disk| fill(&open(disk.clone(), Path::new(FROM)).unwrap(), 2),
        DiskFault::PowerCut,
    );
}

#[test]
fn a_copy_survives_a_failed_call_at_every_step() {
    copy_with_faults(
        |disk| fill(&open(disk.clone(), Path::new(FROM)).unwrap(), 2),
        DiskFault::Error,
    );
}

/// The first flight was copied before it was solved again; the second is newer.
#[test]
fn an_updated_copy_survives_a_power_cut_at_every_step() {
    let before = |disk: &Arc<FakeDisk>| {
        let store = open(disk.clone(), Path::new(FROM)).unwrap();
        fill(&store, 1);
        assert!(copy(disk.as_ref()).unwrap());
        fill(&store, 2);
    };
    copy_with_faults(before, DiskFault::PowerCut);
}

fn prune_with_faults(fault: fn(u64) -> DiskFault) {
    for step in 1.. {
        let disk = Arc::new(FakeDisk::new(Vec::new()));
        fill(&open(disk.clone(), Path::new(FROM)).unwrap(), 2);
        assert!(copy(disk.as_ref()).unwrap());
        let store = open(disk.clone(), Path::new(FROM)).unwrap();
        let flight = catalogue::list_flights(disk.as_ref(), Path::new(FROM))
            .unwrap()
            .remove(0);
        let from = disk.steps();
        disk.set_faults(vec![fault(from + step)]);
        let pruned = store.prune_flight(&flight, Path::new(TO));
        drop(store);
        let whole = disk.steps() < from + step;
        let disk = Arc::new(disk.power_up(Survival::random(step)));
        assert!(verify_path(disk.as_ref(), Path::new(TO)).is_sound());
        let store = open(disk.clone(), Path::new(FROM)).unwrap();
        let report = verify_path(disk.as_ref(), Path::new(FROM));
        assert!(report.is_sound(), "step {step}: {:#?}", report.faults);
        assert!(
            [4, 8].contains(&report.frames),
            "a flight is there completely or not at all"
        );
        if disk.exists(&flight.folder) {
            assert!(matches!(
                store.prune_flight(&flight, Path::new(TO)).unwrap(),
                CopyProof::Verified { .. }
            ));
        }
        store.remove_pruned().unwrap();
        assert_eq!(
            read_all_files(disk.as_ref(), &Path::new(FROM).join("pruned")).len(),
            0
        );
        assert_eq!(verify_path(disk.as_ref(), Path::new(FROM)).frames, 4);
        if whole {
            assert!(
                matches!(pruned.unwrap(), CopyProof::Verified { .. }) && step > 10,
                "{step}"
            );
            return;
        }
    }
}

#[test]
fn a_flight_is_pruned_completely_or_kept_at_any_power_cut() {
    prune_with_faults(DiskFault::PowerCut);
}

#[test]
fn a_flight_is_pruned_completely_or_kept_if_any_call_fails() {
    prune_with_faults(DiskFault::Error);
}

#[test]
fn a_flight_is_pruned_completely_or_kept_if_any_call_succeeds_but_reports_failure() {
    prune_with_faults(DiskFault::FailedAfterwards);
}

#[test]
fn a_copy_survives_a_call_that_succeeds_but_reports_failure_at_every_step() {
    copy_with_faults(
        |disk| fill(&open(disk.clone(), Path::new(FROM)).unwrap(), 2),
        DiskFault::FailedAfterwards,
    );
}

fn text(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

/// A store of three flights and the folder of its copy.
fn copied_store() -> (tempfile::TempDir, String, String) {
    let dir = tempfile::tempdir().unwrap();
    let (from, to) = (dir.path().join(FROM), dir.path().join(TO));
    fill(&open(Arc::new(RealDisk), &from).unwrap(), 3);
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    let (from, to) = (text(&from), text(&to));
    (dir, from, to)
}

#[test]
fn the_commands_copy_and_prune_and_report_the_space_freed() {
    let (_dir, from, to) = copied_store();
    let copied = run(&["copy", &from, &to]);
    assert_eq!(copied.status.code(), Some(0), "{}", text(&copied));
    assert!(text(&copied).contains("complete and sound") && text(&copied).contains("3 flights"));
    let dry = run(&["prune", &from, "--verified-copy", &to, "--dry-run"]);
    assert_eq!(dry.status.code(), Some(0), "{}", text(&dry));
    assert!(
        text(&dry).contains("f0001  would be deleted") && !text(&dry).contains("f0003"),
        "{}",
        text(&dry)
    );
    assert_eq!(
        verify_path(&RealDisk, Path::new(&from)).flights,
        3,
        "a dry run deletes nothing"
    );
    let pruned = run(&["prune", &from, "--verified-copy", &to]);
    assert_eq!(pruned.status.code(), Some(0), "{}", text(&pruned));
    assert!(
        text(&pruned).contains("f0002  deleted"),
        "{}",
        text(&pruned)
    );
    let report = verify_path(&RealDisk, Path::new(&from));
    assert!(report.is_sound() && report.flights == 1, "{report:#?}");
    assert!(
        report
            .notes
            .iter()
            .any(|note| note.contains("f0001 was pruned")),
        "{:?}",
        report.notes
    );
    assert!(
        !report.notes.iter().any(|note| note.contains("lost")),
        "{:?}",
        report.notes
    );
    // The copy keeps everything, also if it is made again from the pruned store.
    assert_eq!(run(&["copy", &from, &to]).status.code(), Some(0));
    assert_eq!(verify_path(&RealDisk, Path::new(&to)).flights, 3);
}

#[test]
fn flights_without_a_verified_copy_are_kept() {
    type Damage = (&'static str, fn(&Path));
    let damage: [Damage; 5] = [
        ("missing, older", |to| {
            assert!(
                Command::new("rm")
                    .arg("-r")
                    .arg(to.join("flights/f0001"))
                    .status()
                    .unwrap()
                    .success()
            );
        }),
        ("not sound", |to| {
            std::fs::write(to.join("flights/f0001/s000001/0001.jpg"), "x").unwrap()
        }),
        ("not sound", |to| {
            std::fs::remove_file(to.join("flights/f0001/s000002/0002.jpg")).unwrap()
        }),
        ("missing, older", |to| {
            std::fs::write(to.join("flights/f0001/SHA256SUMS"), "x").unwrap()
        }),
        ("belongs to another store", |to| {
            let path = to.join("store.toml");
            let text = std::fs::read_to_string(&path).unwrap();
            std::fs::write(path, text.replace("id = \"", "id = \"00")).unwrap();
        }),
    ];
    for (why, damage) in damage {
        let (_dir, from, to) = copied_store();
        assert_eq!(run(&["copy", &from, &to]).status.code(), Some(0));
        damage(Path::new(&to));
        let pruned = run(&["prune", &from, "--verified-copy", &to, "--flight", "f0001"]);
        assert_eq!(pruned.status.code(), Some(1), "{}", text(&pruned));
        assert!(
            text(&pruned).contains("kept: ") && text(&pruned).contains(why),
            "{why}: {}",
            text(&pruned)
        );
        assert_eq!(verify_path(&RealDisk, Path::new(&from)).flights, 3);
    }
    let (_dir, from, _) = copied_store();
    let own = run(&["prune", &from, "--verified-copy", &from]);
    assert_eq!(own.status.code(), Some(1), "{}", text(&own));
    assert!(text(&own).contains("the store itself"), "{}", text(&own));
}

#[test]
fn a_damaged_copy_is_repaired_and_a_foreign_or_changed_one_refused() {
    let (_dir, from, to) = copied_store();
    assert_eq!(run(&["copy", &from, &to]).status.code(), Some(0));
    let frame = Path::new(&to).join("flights/f0001/s000001/0001.jpg");
    let mut bytes = std::fs::read(&frame).unwrap();
    bytes[3] ^= 1;
    std::fs::write(&frame, bytes).unwrap();
    let mended = run(&["copy", &from, &to]);
    assert_eq!(mended.status.code(), Some(0), "{}", text(&mended));
    let (_other_dir, other, _) = copied_store();
    let foreign = run(&["copy", &other, &to]);
    assert_eq!(foreign.status.code(), Some(1));
    assert!(
        text(&foreign).contains("a store other than"),
        "{}",
        text(&foreign)
    );
    let copy = open(Arc::new(RealDisk), Path::new(&to)).unwrap();
    let inputs = Inputs::new(Map::from_iter([("program".to_owned(), "mine".into())]));
    let flight = catalogue::list_flights(&RealDisk, Path::new(&to))
        .unwrap()
        .remove(0);
    for frame in copy.unsolved_in_flight(&flight, &inputs).unwrap() {
        copy.add_result(&frame, &inputs, json!({})).unwrap();
    }
    drop(copy);
    let changed = run(&["copy", &from, &to]);
    assert_eq!(changed.status.code(), Some(1));
    assert!(
        text(&changed).contains("not overwritten"),
        "{}",
        text(&changed)
    );
    let not_empty = tempfile::tempdir().unwrap();
    std::fs::write(not_empty.path().join("thesis.txt"), "x").unwrap();
    assert_eq!(
        run(&["copy", &from, not_empty.path().to_str().unwrap()])
            .status
            .code(),
        Some(1)
    );
}
