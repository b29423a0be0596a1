//! Promise: a store refuses what it must refuse, and a flight begins when it should. (Faults: store_faults.)

use std::path::Path;
use std::sync::Arc;

use crate::common::fake_disk::{DiskFault, FakeDisk, Survival};
use wingd::store::manifest::SeriesCause;
use wingd::store::verify::verify_path;
use wingd::store::{Disk, SeriesPlan, Store, StoreConfig, StoreError};

use crate::common::store_work::{ROOT, Work, moment};

#[test]
fn below_the_reserve_a_series_is_refused_and_the_refusal_recorded() {
    let disk = Arc::new(FakeDisk::default());
    let mut config = StoreConfig::new(ROOT);
    config.reserve_mb = 100;
    let (store, _) = Store::open(disk.clone() as Arc<dyn Disk>, config).unwrap();
    disk.set_free_bytes(99_000_000);
    let plan = SeriesPlan {
        cause: SeriesCause::Scheduled,
        shots: 3,
    };
    let refused = store
        .begin_series(plan, &moment(1.0))
        .err()
        .expect("refused");
    assert!(
        refused
            .to_string()
            .contains("99 MB free, less than the reserve of 100 MB"),
        "{refused}"
    );
    let record = disk.read(&Path::new(ROOT).join("refused.jsonl")).unwrap();
    assert!(String::from_utf8(record).unwrap().contains("99 MB free"));
    assert!(
        verify_path(disk.as_ref(), Path::new(ROOT))
            .notes
            .iter()
            .any(|note| note.contains("refused"))
    );
    disk.set_free_bytes(100_000_000);
    assert!(store.begin_series(plan, &moment(2.0)).is_ok());
}

/// The test disk is useful only if it punishes a missing sync.
#[test]
fn the_disk_forgets_unsynced_data() {
    let (mut lost_name, mut torn) = (0, 0);
    for seed in 0..64 {
        let disk = FakeDisk::new(vec![DiskFault::Error(3)]);
        disk.write(Path::new("a"), b"whole").unwrap();
        let _ = disk.write(Path::new("b"), b"never synced");
        disk.set_faults(vec![DiskFault::PowerCut(4)]);
        let after = disk.power_up(Survival::random(seed));
        match after.read(Path::new("a")) {
            Ok(bytes) => assert_eq!(bytes, b"whole"),
            Err(_) => lost_name += 1,
        }
        torn += u32::from(
            after
                .read(Path::new("b"))
                .is_ok_and(|bytes| bytes != b"never "),
        );
    }
    assert!(
        lost_name > 10 && torn > 5,
        "{lost_name} names lost, {torn} files torn"
    );
}

#[test]
fn two_daemons_cannot_write_one_store() {
    let dir = tempfile::tempdir().unwrap();
    let config = StoreConfig::new(dir.path().join("store"));
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
    let error = Store::open(real(), StoreConfig::new(dir.path()))
        .err()
        .expect("refused");
    assert!(error.to_string().contains("thesis.doc"), "{error}");
    std::fs::write(dir.path().join("store.toml"), "format = 7\n").unwrap();
    let error = Store::open(real(), StoreConfig::new(dir.path()))
        .err()
        .expect("refused");
    assert!(matches!(error, StoreError::Version { .. }), "{error}");
    assert!(error.to_string().contains("format 7"), "{error}");
}

#[test]
fn a_flight_continues_or_begins_as_the_rule_says() {
    let mut work = Work::new(FakeDisk::default());
    let store = work.open().unwrap();
    work.take_days(&store, 1).unwrap();
    drop(store);
    work.time_s += 3600.0;
    let store = work.open().unwrap();
    work.take_days(&store, 1).unwrap();
    assert_eq!(store.current_flight().as_deref(), Some("f0001"));
    work.time_s += 4.0 * 3600.0;
    work.take_days(&store, 1).unwrap();
    assert_eq!(store.current_flight().as_deref(), Some("f0002"));
    store.request_new_flight();
    work.take_days(&store, 2).unwrap();
    assert_eq!(store.current_flight().as_deref(), Some("f0003"));
    work.check().unwrap();
}
