//! Promise: a store that came from elsewhere changes nothing outside of it, is readable by its owner only, and costs the same
//! however many results it has.
// Moves files as a user would.
#![allow(clippy::disallowed_methods)]

use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Map, json};
use wingd::installation::PendingFile;
use wingd::store::disk::{DirectoryEntry, Disk, Lock};
use wingd::store::manifest::{SeriesCause, SeriesState, Shot};
use wingd::store::verify::verify_path;
use wingd::store::{NewFrame, RealDisk, SeriesPlan, Store, StoreConfig, catalogue, series_frames};

use super::store_evidence::{FLIGHT, copy_store, open, wingd};
use crate::common::fake_disk::read_all_files;
use crate::common::store_work::{inputs, moment};

/// Names at which a link is a danger, those below a series last.
const NAMES: [&str; 30] = [
    "incoming",
    "flights",
    "partial",
    "installations",
    "fetching",
    "pruned",
    "store.toml",
    "store.toml.part",
    "counter.json",
    "counter.json.part",
    "lock",
    "pending.json",
    "solving.json",
    "refused.jsonl",
    "pruned.jsonl",
    "aircraft.jsonl",
    "live.rows",
    "marks.jsonl",
    "incoming/s000077",
    "incoming/s000077/journal.jsonl",
    "fetching/flights",
    "fetching/flights/f0001",
    "fetching/flights/f0001/s000001",
    "pruned/f0009",
    "flights/f0001",
    "flights/f0001/chain.jsonl",
    "flights/f0001/SHA256SUMS.part",
    "flights/f0001/s000001",
    "flights/f0001/s000001/results.jsonl",
    "flights/f0001/s000001/0001.jpg",
];

/// Ends a command that serves instead of refusing.
const PATIENCE: Duration = Duration::from_secs(20);

fn status_of(command: &mut Command) -> Option<i32> {
    let quiet = command.stdin(Stdio::null()).stdout(Stdio::null());
    let mut child = quiet.stderr(Stdio::null()).spawn().unwrap();
    let begin = Instant::now();
    while begin.elapsed() < PATIENCE {
        if let Some(status) = child.try_wait().unwrap() {
            return status.code();
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    Some(0)
}

/// Replaces an entry of a store by a link to it, or to another file or folder, in the folder `outside`.
fn plant_link(root: &Path, name: &str, outside: &Path) {
    let (link, target) = (root.join(name), outside.join("target"));
    std::fs::create_dir_all(link.parent().unwrap()).unwrap();
    if link.exists() {
        std::fs::rename(&link, &target).unwrap();
    } else if name.contains('.') {
        std::fs::write(&target, "dear").unwrap();
    } else {
        std::fs::create_dir(&target).unwrap();
        std::fs::write(target.join("letter"), "dear").unwrap();
    }
    symlink(target, link).unwrap();
}

#[test]
fn a_link_at_any_name_is_refused_by_every_command_and_nothing_outside_changes() {
    let frames = crate::program::fixture("dev/frames");
    let image = frames.join("flight-1.jpg").display().to_string();
    let installation = crate::program::fixture("dev/installation");
    let installation = installation.display().to_string();
    for name in NAMES {
        let (store, outside, beside) = (
            copy_store(),
            tempfile::tempdir().unwrap(),
            tempfile::tempdir().unwrap(),
        );
        let text = |name: &str| beside.path().join(name).display().to_string();
        let (root, sound, copy) = (
            store.path().display().to_string(),
            text("sound"),
            text("copy"),
        );
        crate::program::stdout(&["copy", &root, &sound]);
        plant_link(store.path(), name, outside.path());
        let before = read_all_files(&RealDisk, outside.path());
        let (config, table, html) = (text("wingd.toml"), text("table.csv"), text("report.html"));
        let configuration = format!(
            "[store]\npath = {root:?}\nreserve_mb = 0\n[camera]\nkind = \"replay\"\nfolder = {frames:?}\n[status]\nsocket = {:?}\n",
            text("socket")
        );
        std::fs::write(&config, configuration).unwrap();
        std::fs::write(&table, "utc,mach\n2026-03-01T08:00:00Z,0.8\n").unwrap();
        let commands: &[&[&str]] = &[
            &["verify", &root],
            &["solve", &root, "--installation", &installation],
            &["import", &image, "--store", &root],
            &["copy", &root, &copy],
            &["copy", &sound, &root],
            &["aircraft-data", &root, &table],
            &["report", &root, "--output", &html],
            &["export", &root, "--format", "csv"],
            &["mark", &root, "--installation", &installation],
            &["serve", &root, "--listen", "127.0.0.1:0"],
            &["check", "--config", &config, "--no-camera"],
            &["run", "--config", &config],
            &["prune", &root, "--verified-copy", &sound, "--keep", "0"],
        ];
        // Files in the folders of series are refused when they are opened.
        let in_series = name.starts_with("flights") && name.matches('/').count() > 2;
        for command in commands {
            let serves = ["mark", "serve", "run"].contains(&command[0]);
            if in_series && serves {
                continue;
            }
            let mut process = Command::new(env!("CARGO_BIN_EXE_wingd"));
            let status = status_of(process.args(*command));
            if !in_series || command[0] == "verify" {
                assert!(status != Some(0), "{name}: {command:?}");
                assert!(store.path().join(name).is_symlink(), "{name}: {command:?}");
            }
            let after = read_all_files(&RealDisk, outside.path());
            assert!(before == after, "{name}: {command:?} changed {outside:?}");
        }
    }
}

#[test]
fn the_message_of_a_locked_store_names_command_and_process() {
    let dir = copy_store();
    let store = open(dir.path());
    let image = crate::program::fixture("dev/frames/flight-1.jpg");
    let image = image.to_str().unwrap();
    let output = wingd(&["import", image, "--store"], dir.path());
    let text = String::from_utf8(output.stderr).unwrap();
    let process = format!("(process {}) is writing to this store", std::process::id());
    assert!(text.contains(&process), "{text}");
    assert!(!text.contains("systemctl"), "{text}");
    drop(store);
}

#[test]
fn a_store_is_not_for_every_user_of_the_machine() {
    let dir = tempfile::tempdir().unwrap();
    let is_closed = |folder: &Path| {
        let mode = std::fs::metadata(folder).unwrap().permissions().mode();
        mode & 0o007 == 0
    };
    std::fs::set_permissions(dir.path(), PermissionsExt::from_mode(0o755)).unwrap();
    let made = dir.path().join("made/store");
    drop(open(&made));
    assert!(is_closed(&dir.path().join("made")));
    let given = dir.path().join("given");
    std::fs::create_dir(&given).unwrap();
    std::fs::set_permissions(&given, PermissionsExt::from_mode(0o755)).unwrap();
    drop(open(&given));
    for name in ["flights", "incoming", "partial"] {
        assert!(is_closed(&given.join(name)), "{name}");
    }
}

#[test]
fn a_format_file_without_an_id_is_rebuilt() {
    let dir = copy_store();
    let file = dir.path().join("store.toml");
    let id = catalogue::store_id(&RealDisk, dir.path()).unwrap();
    std::fs::write(&file, "format = 2\n").unwrap();
    assert_eq!(wingd(&["verify"], dir.path()).status.code(), Some(1));
    drop(open(dir.path()));
    assert_eq!(catalogue::store_id(&RealDisk, dir.path()), Some(id));
    assert!(verify_path(&RealDisk, dir.path()).is_sound());
}

#[test]
fn a_signing_key_that_every_user_can_read_is_mentioned() {
    let dir = tempfile::tempdir().unwrap();
    let key = dir.path().join("recorder.key");
    let config = StoreConfig {
        signing_key: Some(key.clone()),
        ..StoreConfig::new(dir.path().join("store"))
    };
    let (store, _) = Store::open(Arc::new(RealDisk), config.clone()).unwrap();
    assert_eq!(store.signing_fault(), None);
    drop(store);
    std::fs::set_permissions(&key, PermissionsExt::from_mode(0o644)).unwrap();
    let (store, recovery) = Store::open(Arc::new(RealDisk), config).unwrap();
    let fault = store.signing_fault().unwrap();
    assert!(fault.contains("every user can read"), "{fault}");
    assert!(recovery.remarks.contains(&fault));
}

#[test]
fn a_killed_export_leaves_no_file() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("table.csv");
    std::fs::write(&file, "old").unwrap();
    let mut pending = PendingFile::create_output(&file).unwrap();
    std::io::Write::write_all(&mut pending, b"half").unwrap();
    // As a kill does: nothing is cleaned up.
    std::mem::forget(pending);
    let names = || -> Vec<_> {
        let entries = std::fs::read_dir(dir.path()).unwrap();
        entries.map(|entry| entry.unwrap().file_name()).collect()
    };
    assert_eq!(names(), ["table.csv"]);
    let mut pending = PendingFile::create_output(&file).unwrap();
    std::io::Write::write_all(&mut pending, b"whole").unwrap();
    pending.commit().unwrap();
    assert_eq!(std::fs::read(&file).unwrap(), b"whole");
    assert_eq!(names(), ["table.csv"]);
    let mode = std::fs::metadata(&file).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o644);
}

#[test]
fn recorded_aircraft_data_are_counted_as_written_and_after_a_restart() {
    let dir = copy_store();
    let store = open(dir.path());
    assert_eq!(store.aircraft_bytes().unwrap(), 0);
    let line = wingd::store::aircraft::AircraftLine {
        at: Some(moment(7.0)),
        line: "a1".into(),
    };
    let lines = vec![line; 100];
    assert!(store.add_aircraft_lines(&json!("x"), &lines).unwrap());
    let written = || -> u64 {
        let all = read_all_files(&RealDisk, dir.path());
        let is_ours = |path: &Path| path.display().to_string().contains("aircraft");
        let ours = all.iter().filter(|(path, _)| is_ours(path));
        ours.map(|(_, bytes)| bytes.len() as u64).sum()
    };
    assert!(store.aircraft_bytes().unwrap() == written() && written() > 10_000);
    drop(store);
    let store = open(dir.path());
    assert!(store.aircraft_bytes().unwrap() == written() && written() > 10_000);
}

/// Disk that counts the bytes that are read.
struct CountingDisk(RealDisk, AtomicU64);

impl CountingDisk {
    fn count(&self, read: std::io::Result<Vec<u8>>) -> std::io::Result<Vec<u8>> {
        let length = read.as_ref().map_or(0, Vec::len);
        self.1.fetch_add(length as u64, Ordering::Relaxed);
        read
    }
}

impl Disk for CountingDisk {
    fn read(&self, path: &Path) -> std::io::Result<Vec<u8>> {
        self.count(self.0.read(path))
    }
    fn read_range(&self, path: &Path, from: u64, length: usize) -> std::io::Result<Vec<u8>> {
        self.count(self.0.read_range(path, from, length))
    }
    fn length(&self, path: &Path) -> std::io::Result<u64> {
        self.0.length(path)
    }
    fn list(&self, directory: &Path) -> std::io::Result<Vec<DirectoryEntry>> {
        self.0.list(directory)
    }
    fn exists(&self, path: &Path) -> bool {
        self.0.exists(path)
    }
    fn create_dir(&self, path: &Path) -> std::io::Result<()> {
        self.0.create_dir(path)
    }
    fn write(&self, path: &Path, bytes: &[u8]) -> std::io::Result<()> {
        self.0.write(path, bytes)
    }
    fn append(&self, path: &Path, bytes: &[u8]) -> std::io::Result<()> {
        self.0.append(path, bytes)
    }
    fn truncate(&self, path: &Path, length: u64) -> std::io::Result<()> {
        self.0.truncate(path, length)
    }
    fn rename(&self, from: &Path, to: &Path) -> std::io::Result<()> {
        self.0.rename(from, to)
    }
    fn remove_file(&self, path: &Path) -> std::io::Result<()> {
        self.0.remove_file(path)
    }
    fn remove_dir(&self, path: &Path) -> std::io::Result<()> {
        self.0.remove_dir(path)
    }
    fn sync_dir(&self, directory: &Path) -> std::io::Result<()> {
        self.0.sync_dir(directory)
    }
    fn free_bytes(&self, path: &Path) -> std::io::Result<u64> {
        self.0.free_bytes(path)
    }
    fn lock(&self, path: &Path) -> std::io::Result<Option<Lock>> {
        self.0.lock(path)
    }
}

/// Peak of the resident memory of this process, MB.
fn peak_mb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.unwrap().trim().trim_end_matches(" kB");
    kib.parse::<u64>().unwrap() / 1000
}

/// Adds results of `record_bytes` to one series; returns the bytes read for the first, the middle and the last tenth.
fn add_results(root: &Path, frames: u32, record_bytes: usize) -> [u64; 3] {
    let disk = Arc::new(CountingDisk(RealDisk, AtomicU64::new(0)));
    let config = StoreConfig {
        reserve_mb: 0,
        ..StoreConfig::new(root)
    };
    let (store, _) = Store::open(disk.clone(), config).unwrap();
    let plan = SeriesPlan {
        cause: SeriesCause::Scheduled,
        shots: frames,
    };
    let (mut series, _) = store.begin_series(plan, &moment(1.0)).unwrap();
    for number in 1..=frames {
        let shot = Shot {
            shot: number,
            stamp: moment(f64::from(number)),
            duration_s: None,
            exposure: None,
            frame: None,
            failures: Vec::new(),
        };
        let frame = NewFrame {
            bytes: &number.to_le_bytes(),
            extension: "jpg",
            format: json!({"kind": "jpeg"}),
            settings: Map::new(),
        };
        series.add_shot(shot, Some(frame)).unwrap();
    }
    store
        .close_series(series, SeriesState::Complete, &moment(2e4), vec![])
        .unwrap();
    let flight = catalogue::list_flights(&RealDisk, root).unwrap().remove(0);
    let series = catalogue::list_series(&RealDisk, &flight)
        .unwrap()
        .remove(0);
    let manifest = catalogue::read_series_manifest(&RealDisk, &series).unwrap();
    let frames = series_frames(&series, manifest);
    let tenth = frames.len() / 10;
    let mut read = [0; 3];
    let record = json!({"status": "ok", "text": "x".repeat(record_bytes)});
    for (number, frame) in frames.iter().enumerate() {
        let before = disk.1.load(Ordering::Relaxed);
        assert!(store.add_result(frame, &inputs(), record.clone()).unwrap());
        let cost = disk.1.load(Ordering::Relaxed) - before;
        match number / tenth {
            0 => read[0] += cost,
            5 => read[1] += cost,
            9 => read[2] += cost,
            _ => {}
        }
    }
    assert!(!store.add_result(&frames[3], &inputs(), record).unwrap());
    assert!(store.unsolved_frames(&inputs()).unwrap().is_empty());
    store.seal();
    read
}

#[test]
fn adding_a_result_costs_the_same_for_the_first_and_the_last() {
    let dir = tempfile::tempdir().unwrap();
    let [_, middle, last] = add_results(dir.path(), 400, 2000);
    assert!(last < middle * 11 / 10, "{middle} and {last} bytes");
    let report = verify_path(&RealDisk, dir.path());
    assert!(report.is_sound() && report.results == 400, "{report:?}");
}

/// Ten thousand results of 44 kB, 440 MB, in one series. Run it alone: the peak is that of this process.
/// `cargo test --release --test system -- --ignored --nocapture ten_thousand_results`
#[test]
#[ignore = "440 MB and 40,000 syncs"]
fn ten_thousand_results_need_little_memory() {
    let dir = tempfile::tempdir().unwrap();
    let begin = Instant::now();
    let [first, _, last] = add_results(dir.path(), 10_000, 44_000);
    let length = std::fs::metadata(dir.path().join(FLIGHT).join("s000001/results.jsonl")).unwrap();
    println!(
        "{} MB of results in {:.0} s, peak {} MB; read for the first and the last 1,000 results: {first} and {last} bytes",
        length.len() / 1_000_000,
        begin.elapsed().as_secs_f64(),
        peak_mb()
    );
    assert!(peak_mb() < 150);
}

/// Waits until a file exists below `root/incoming` whose name ends so.
fn wait_for_frame(root: &Path) -> PathBuf {
    let begin = Instant::now();
    while begin.elapsed() < PATIENCE {
        let all = read_all_files(&RealDisk, &root.join("incoming"));
        if let Some(path) = all.into_keys().find(|path| path.ends_with("0001.jpg")) {
            return path;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("no frame in {root:?}");
}

#[test]
fn a_signal_that_ends_the_recorder_closes_the_series() {
    use rustix::process::{Pid, Signal, kill_process};
    for signal in [Signal::HUP, Signal::USR1, Signal::USR2] {
        let dir = tempfile::tempdir().unwrap();
        let (root, config) = (dir.path().join("store"), dir.path().join("wingd.toml"));
        let text = format!(
            "[store]\npath = \"store\"\nreserve_mb = 0\n[camera]\nkind = \"replay\"\nfolder = {:?}\n[status]\nsocket = \"s\"\n\
             [series]\nshots = 50\ngap = \"1s\"\n",
            crate::program::fixture("dev/frames")
        );
        std::fs::write(&config, text).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_wingd"));
        let command = command.args(["run", "--config"]).arg(&config);
        let mut child = command.stderr(Stdio::null()).spawn().unwrap();
        wait_for_frame(&root);
        kill_process(Pid::from_child(&child), signal).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(0), "{signal:?}");
        let left = std::fs::read_dir(root.join("incoming")).unwrap().count();
        let closed = root.join(FLIGHT).join("s000001/series.json").exists();
        assert!(closed && left == 0, "{signal:?}: {left} series are open");
    }
}

#[test]
fn check_refuses_frames_in_memory_that_no_service_holds() {
    let dir = tempfile::tempdir().unwrap();
    let config = dir.path().join("wingd.toml");
    let text = |ring_mb: u32| {
        format!(
            "[store]\npath = \"store\"\n[camera]\nkind = \"replay\"\nfolder = {:?}\n[live]\nrate_hz = 5\n[live.keep]\nring_mb = {ring_mb}\n",
            crate::program::fixture("dev/frames")
        )
    };
    for (ring_mb, expected) in [(100, 0), (4000, 78)] {
        std::fs::write(&config, text(ring_mb)).unwrap();
        let arguments = ["check", "--no-camera", "--config", config.to_str().unwrap()];
        let (status, printed) = crate::program::outcome(&arguments);
        assert_eq!(status, Some(expected), "{printed}");
    }
}
