//! Promise: any change of a store or of a copy is reported, and an old store is read and recorded to.

use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;

use crate::common::fake_disk::read_all_files;
use serde_json::{Map, Value, json};
use wingd::store::verify::verify_path;
use wingd::store::{Inputs, RealDisk, Store, StoreConfig, sha256_hex};

use crate::common::report_store::add_two_solved;

pub const FLIGHT: &str = "flights/f0001";

/// Installation of the results.
fn installation() -> Vec<(String, Vec<u8>)> {
    vec![
        ("camera.toml".into(), b"fx = 1\n".to_vec()),
        ("survey.csv".into(), b"id\n".to_vec()),
    ]
}

fn inputs() -> Inputs {
    let mut provenance = Map::from_iter([("program".to_owned(), Value::from("test"))]);
    for (name, bytes) in installation() {
        provenance.insert(format!("{name}.sha256"), sha256_hex(&bytes).into());
    }
    Inputs::new(provenance)
}

pub fn open(root: &Path) -> Store {
    let config = StoreConfig {
        reserve_mb: 0,
        ..StoreConfig::new(root)
    };
    Store::open(Arc::new(RealDisk), config).unwrap().0
}

/// Three series of two frames, all solved.
fn make(root: &Path) {
    fill(&open(root));
}

pub fn fill(store: &Store) {
    store.keep_installation(&installation()).unwrap();
    let begin = store
        .last_moment()
        .map_or(0, |last| 1 + last.since_boot_s as u64 / 100);
    for n in begin..begin + 3 {
        add_two_solved(store, &inputs(), n, |shot| {
            format!("frame {shot} of {n}").into_bytes()
        });
    }
}

pub fn copy_store() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    make(dir.path());
    dir
}

pub fn wingd(arguments: &[&str], store: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args(arguments)
        .arg(store)
        .output()
        .unwrap()
}

/// Exit status 1, and a line that names the position; for a damaged flight also in a copy of the flight alone.
fn assert_named(damage: impl FnOnce(&Path), place: &str, what: &str) {
    let dir = copy_store();
    let before = read_all_files(&RealDisk, &dir.path().join(FLIGHT));
    let sound = wingd(&["verify"], dir.path());
    assert_eq!(
        sound.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&sound.stdout)
    );
    damage(dir.path());
    let output = wingd(&["verify"], dir.path());
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        text.lines()
            .any(|line| line.contains(place) && line.contains(what)),
        "{place}: {what}: {text}"
    );
    let flight = dir.path().join(FLIGHT);
    if !flight.is_symlink() && before != read_all_files(&RealDisk, &flight) {
        let elsewhere = tempfile::tempdir().unwrap();
        let copied = Command::new("cp")
            .arg("-r")
            .arg(dir.path().join(FLIGHT))
            .arg(elsewhere.path())
            .status();
        assert!(copied.unwrap().success());
        let output = wingd(&["verify"], &elsewhere.path().join("f0001"));
        let text = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
        assert_eq!(
            output.status.code(),
            Some(1),
            "a copy of the flight: {text}"
        );
    }
}

fn edit(root: &Path, file: &str, change: impl FnOnce(&mut Vec<u8>)) {
    let path = root.join(file);
    let mut bytes = std::fs::read(&path).unwrap();
    let before = bytes.clone();
    change(&mut bytes);
    assert_ne!(before, bytes, "{file} was not changed");
    std::fs::write(path, bytes).unwrap();
}

pub fn replace(root: &Path, file: &str, from: &str, to: &str) {
    edit(root, file, |bytes| {
        *bytes = String::from_utf8(bytes.clone())
            .unwrap()
            .replacen(from, to, 1)
            .into_bytes();
    });
}

fn cut_last_line(root: &Path, file: &str) {
    edit(root, file, |bytes| {
        let end = bytes[..bytes.len() - 1]
            .iter()
            .rposition(|byte| *byte == b'\n')
            .map_or(0, |at| at + 1);
        bytes.truncate(end);
    });
}

fn flip(root: &Path, file: &str) {
    edit(root, file, |bytes| {
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
    });
}

fn move_out(root: &Path, what: &str) {
    let away = tempfile::tempdir().unwrap().keep();
    let done = Command::new("mv")
        .arg(root.join(what))
        .arg(away)
        .status()
        .unwrap();
    assert!(done.success());
}

#[test]
fn damage_01_a_bit_in_a_frame() {
    assert_named(
        |root| flip(root, "flights/f0001/s000002/0001.jpg"),
        "s000002/0001.jpg",
        "SHA-256",
    );
}

#[test]
fn damage_02_a_bit_in_results() {
    assert_named(
        |root| flip(root, "flights/f0001/s000002/results.jsonl"),
        "s000002/results.jsonl",
        "changed",
    );
}

#[test]
fn damage_03_a_bit_in_a_manifest() {
    // A remark that no other check would miss.
    let file = "flights/f0001/s000002/series.json";
    assert_named(
        |root| replace(root, file, "09", "08"),
        "s000002/series.json",
        "changed or replaced",
    );
    assert_named(
        |root| flip(root, "flights/f0001/SHA256SUMS"),
        "f0001/SHA256SUMS",
        "",
    );
    assert_named(
        |root| replace(root, "flights/f0001/flight.json", "first", "worst"),
        "flight.json",
        "SHA-256",
    );
    assert_named(
        |root| replace(root, "flights/f0001/chain.jsonl", "bytes\":", "bytes\":1"),
        "chain.jsonl",
        "",
    );
}

#[test]
fn damage_04_a_file_edited() {
    let file = "flights/f0001/s000001/results.jsonl";
    assert_named(
        |root| replace(root, file, "2.74", "9.74"),
        "s000001/results.jsonl",
        "it was changed",
    );
}

#[test]
fn damage_05_a_file_missing() {
    for file in [
        "s000001/0002.jpg",
        "s000001/series.json",
        "flight.json",
        "SHA256SUMS",
        "chain.jsonl",
    ] {
        assert_named(
            |root| move_out(root, &format!("{FLIGHT}/{file}")),
            file,
            "cannot be read",
        );
    }
}

#[test]
fn damage_06_a_file_cut_at_a_line_end() {
    let results = "flights/f0001/s000003/results.jsonl";
    assert_named(
        |root| cut_last_line(root, results),
        "s000003/results.jsonl",
        "results are missing",
    );
    assert_named(
        |root| cut_last_line(root, "flights/f0001/chain.jsonl"),
        "SHA256SUMS",
        "does not belong to this chain",
    );
    assert_named(
        |root| cut_last_line(root, "flights/f0001/SHA256SUMS"),
        "SHA256SUMS",
        "does not match the files",
    );
}

#[test]
fn damage_07_two_files_swapped() {
    let swap = |one: &'static str, other: &'static str| {
        move |root: &Path| {
            let (a, b) = (
                std::fs::read(root.join(one)).unwrap(),
                std::fs::read(root.join(other)).unwrap(),
            );
            std::fs::write(root.join(one), b).unwrap();
            std::fs::write(root.join(other), a).unwrap();
        }
    };
    let frames = swap(
        "flights/f0001/s000001/0001.jpg",
        "flights/f0001/s000001/0002.jpg",
    );
    assert_named(frames, "s000001/0002.jpg", "SHA-256");
    let results = swap(
        "flights/f0001/s000001/results.jsonl",
        "flights/f0001/s000002/results.jsonl",
    );
    assert_named(results, "s000001/results.jsonl", "changed");
}

#[test]
fn damage_08_a_link() {
    for file in [
        "flights/f0001/s000001/0001.jpg",
        "flights/f0001/chain.jsonl",
        "counter.json",
        "flights/f0001",
    ] {
        let link = |root: &Path| {
            move_out(root, file);
            let elsewhere = copy_store().keep();
            std::os::unix::fs::symlink(elsewhere.join(file), root.join(file)).unwrap();
        };
        assert_named(link, file, "is a link");
    }
}

#[test]
fn damage_09_a_file_added() {
    for file in [
        "flights/f0001/s000001/0003.jpg",
        "flights/f0001/notes.txt",
        "flights/x",
        "notes.txt",
    ] {
        assert_named(
            |root| std::fs::write(root.join(file), "x").unwrap(),
            file,
            "",
        );
    }
    let line = |root: &Path| {
        edit(root, "flights/f0001/s000003/results.jsonl", |bytes| {
            let text = String::from_utf8(bytes.clone()).unwrap();
            let inputs = Inputs::new(Map::new());
            let frame = sha256_hex(b"frame 2 of 2");
            let added = json!({"frame": "0002.jpg", "frame_sha256": frame, "inputs": inputs.key(&frame),
                "provenance": {}, "record": {"deflection_m": 9.74}});
            *bytes = format!("{text}{added}\n").into_bytes();
        });
    };
    assert_named(line, "s000003/results.jsonl", "added manually");
}

#[test]
fn damage_10_a_series_missing_in_the_middle() {
    assert_named(
        |root| move_out(root, "flights/f0001/s000002"),
        "s000002",
        "is missing",
    );
}

#[test]
fn damage_11_the_last_series_missing() {
    assert_named(
        |root| move_out(root, "flights/f0001/s000003"),
        "s000003",
        "is missing",
    );
    let with_the_chain = |root: &Path| {
        move_out(root, "flights/f0001/s000003");
        edit(root, "flights/f0001/chain.jsonl", |bytes| {
            let text = String::from_utf8(bytes.clone()).unwrap();
            let kept = text
                .split_inclusive('\n')
                .filter(|line| !line.contains("s000003"));
            *bytes = kept.collect::<String>().into_bytes();
        });
    };
    assert_named(
        with_the_chain,
        "SHA256SUMS",
        "does not belong to this chain",
    );
}

#[test]
fn damage_12_results_missing() {
    assert_named(
        |root| move_out(root, "flights/f0001/s000002/results.jsonl"),
        "results.jsonl",
        "is missing",
    );
}

#[test]
fn damage_13_the_counter_set_back() {
    let back = |root: &Path| {
        replace(
            root,
            "counter.json",
            "\"next_series\":4",
            "\"next_series\":2",
        )
    };
    assert_named(back, "counter.json", "is not above");
}

#[test]
fn damage_14_the_installation_missing() {
    let kept = |root: &Path| {
        std::fs::read_dir(root.join("installations"))
            .unwrap()
            .next()
            .unwrap()
            .unwrap()
    };
    let all = |root: &Path| {
        move_out(
            root,
            kept(root)
                .path()
                .strip_prefix(root)
                .unwrap()
                .to_str()
                .unwrap(),
        )
    };
    assert_named(all, "installations/", "is missing");
    let edited = |root: &Path| std::fs::write(kept(root).path().join("survey.csv"), "x").unwrap();
    assert_named(edited, "survey.csv", "SHA-256");
}

#[test]
fn a_replaced_series_is_named() {
    let other = |root: &Path| {
        let elsewhere = tempfile::tempdir().unwrap();
        make(elsewhere.path());
        let series = "flights/f0001/s000002";
        for (path, bytes) in read_all_files(&RealDisk, &elsewhere.path().join(series)) {
            let name = path.file_name().unwrap().to_owned();
            let text = String::from_utf8(bytes)
                .unwrap()
                .replace("2.74", "2.75")
                .replace(":01.", ":02.");
            std::fs::write(root.join(series).join(name), text).unwrap();
        }
    };
    assert_named(other, "s000002/results.jsonl", "changed");
}

#[test]
fn sha256sum_reads_the_sums_of_every_file_of_a_flight() {
    let dir = copy_store();
    let flight = dir.path().join(FLIGHT);
    let check = |flight: &Path| {
        let mut command = Command::new("sha256sum");
        command
            .args(["--check", "--strict", "SHA256SUMS"])
            .current_dir(flight)
            .output()
            .unwrap()
    };
    let output = check(&flight);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stdout)
    );
    let listed = String::from_utf8(output.stdout).unwrap().lines().count();
    assert_eq!(
        listed,
        read_all_files(&RealDisk, &flight).len() - 1,
        "every file but SHA256SUMS itself"
    );
    replace(&flight, "s000001/results.jsonl", "2.74", "9.74");
    assert!(!check(&flight).status.success());
}

/// A store of format 1: without id, chains, sums, installations.
fn make_format_1() -> tempfile::TempDir {
    let dir = copy_store();
    for file in [
        "flights/f0001/chain.jsonl",
        "flights/f0001/SHA256SUMS",
        "installations",
        "pending.json",
    ] {
        move_out(dir.path(), file);
    }
    std::fs::write(
        dir.path().join("store.toml"),
        "format = 1\ncreated_by = \"wingd 0.1.0\"\n",
    )
    .unwrap();
    dir
}

#[test]
fn an_old_store_is_read_and_recorded_to_as_before() {
    let dir = make_format_1();
    let report = verify_path(&RealDisk, dir.path());
    assert!(report.is_sound(), "{:#?}", report.faults);
    assert!(report.notes.iter().any(|note| note.contains("no chain")));
    make(dir.path());
    let report = verify_path(&RealDisk, dir.path());
    assert!(
        report.is_sound() && report.series == 6 && report.results == 12,
        "{report:#?}"
    );
    assert!(!dir.path().join("flights/f0001/chain.jsonl").exists());
}

#[test]
fn a_format_file_set_back_does_not_hide_the_chain() {
    let dir = tempfile::tempdir().unwrap();
    make(dir.path());
    std::fs::write(dir.path().join("store.toml"), "format = 1\n").unwrap();
    assert!(!verify_path(&RealDisk, dir.path()).is_sound());
}
