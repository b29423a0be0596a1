//! Promise: a download is complete, of one state, and a store; a file that cannot be sent completely is an error.

use std::path::Path;
use std::process::Command;

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use serde_json::Map;
use wingd::store::verify::verify_path;
use wingd::store::{Inputs, RealDisk, Store, StoreConfig, sha256_hex};

use super::http_pages::Server;
use crate::common::report_store::{jpeg, solved, store_with};

const ARCHIVE: &str = "/tar/f0001.tar";
const FRAME: &str = "/files/f0001/s000001/0001.jpg";

fn unpacked(archive: &[u8]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    tar::Archive::new(archive).unpack(dir.path()).unwrap();
    dir
}

#[test]
fn an_archive_has_length_and_digest_and_unpacks_to_a_store() {
    let store = store_with(&[
        &[solved(2.9, 0.006), solved(2.8, 0.006)],
        &[solved(2.1, 0.006)],
    ]);
    let server = Server::start(store.path());
    let head = server.request("HEAD", ARCHIVE, "");
    let whole = server.get(ARCHIVE);
    assert_eq!((head.status, whole.status, head.body.len()), (200, 200, 0));
    for answer in [&head, &whole] {
        assert_eq!(
            answer.header("content-length"),
            Some(whole.body.len().to_string().as_str())
        );
        assert_eq!(answer.header("accept-ranges"), Some("bytes"));
        assert!(
            answer.header("etag").unwrap().starts_with('"'),
            "a strong one"
        );
        assert_eq!(answer.header("etag"), head.header("etag"));
    }
    let copy = unpacked(&whole.body);
    let report = verify_path(&RealDisk, copy.path());
    assert!(report.is_sound(), "{:#?}", report.faults);
    assert_eq!((report.series, report.frames, report.results), (2, 3, 3));
    let page = copy.path().parent().unwrap().join("page.html");
    let done = Command::new(env!("CARGO_BIN_EXE_wingd"))
        .arg("report")
        .arg(copy.path())
        .arg("--output")
        .arg(&page)
        .output()
        .unwrap();
    assert!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    // The daemon's own code can open it and write to it.
    Store::open(std::sync::Arc::new(RealDisk), StoreConfig::new(copy.path())).unwrap();
}

#[test]
fn an_archive_interrupted_thirty_times_arrives_complete() {
    let six = |deflection_m: f64| std::array::from_fn::<_, 6, _>(|_| solved(deflection_m, 0.006));
    let store = store_with(&[&six(2.9), &six(2.1)]);
    let server = Server::start(store.path());
    let whole = server.get(ARCHIVE);
    let etag = whole.header("etag").unwrap().to_owned();
    let mut random = StdRng::seed_from_u64(30);
    let mut breaks: Vec<usize> = (0..30)
        .map(|_| random.random_range(1..whole.body.len()))
        .collect();
    breaks.sort_unstable();
    breaks.push(whole.body.len());
    let mut got = Vec::new();
    for until in breaks {
        let headers = format!("Range: bytes={}-\r\nIf-Range: {etag}\r\n", got.len());
        let part = server.request("GET", ARCHIVE, &headers);
        assert_eq!(part.status, 206);
        // The part received before the connection broke.
        let count = until - got.len();
        got.extend_from_slice(&part.body[..count]);
    }
    assert_eq!(sha256_hex(&got), sha256_hex(&whole.body));
}

#[test]
fn an_archive_of_another_state_is_not_joined_with_this_one() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    let server = Server::start(store.path());
    let before = server.get(ARCHIVE);
    let etag = before.header("etag").unwrap().to_owned();
    assert_eq!(
        server
            .request("GET", ARCHIVE, &format!("If-None-Match: {etag}\r\n"))
            .status,
        304
    );
    add_result(store.path());
    let headers = format!("Range: bytes=100-\r\nIf-Range: {etag}\r\n");
    let after = server.request("GET", ARCHIVE, &headers);
    assert_eq!(after.status, 200, "all of the new one");
    assert_ne!(after.header("etag"), Some(etag.as_str()));
    assert_eq!(
        verify_path(&RealDisk, unpacked(&after.body).path()).results,
        2
    );
    assert_eq!(
        server
            .request("GET", ARCHIVE, &format!("If-None-Match: {etag}\r\n"))
            .status,
        200
    );
}

/// Adds a result of the same frame with other inputs.
fn add_result(root: &Path) {
    let config = StoreConfig {
        reserve_mb: 0,
        ..StoreConfig::new(root)
    };
    let (store, _) = Store::open(std::sync::Arc::new(RealDisk), config).unwrap();
    let inputs = Inputs::new(Map::from_iter([("program".to_owned(), "another".into())]));
    for frame in store.unsolved_frames(&inputs).unwrap() {
        assert!(
            store
                .add_result(&frame, &inputs, solved(2.8, 0.006))
                .unwrap()
        );
    }
    store.seal();
}

#[test]
fn a_file_that_cannot_be_sent_completely_is_an_error_that_names_it() {
    type Damage = fn(&Path);
    let damages: [(&str, Damage); 4] = [
        ("0001.jpg", |series| {
            std::fs::remove_file(series.join("0001.jpg")).unwrap()
        }),
        ("0001.jpg", |series| {
            std::fs::write(series.join("0001.jpg"), "short").unwrap()
        }),
        ("results.jsonl", |series| {
            std::fs::write(series.join("results.jsonl"), "").unwrap()
        }),
        ("0001.jpg", |series| {
            std::fs::remove_file(series.join("0001.jpg")).unwrap();
            std::os::unix::fs::symlink("/etc/hostname", series.join("0001.jpg")).unwrap();
        }),
    ];
    for (named, damage) in damages {
        let store = store_with(&[&[solved(2.9, 0.006)]]);
        let server = Server::start(store.path());
        damage(&store.path().join("flights/f0001/s000001"));
        let answer = server.get(ARCHIVE);
        assert_eq!(answer.status, 500, "{named}");
        assert!(answer.text().contains(named), "{}", answer.text());
    }
}

#[test]
fn two_stores_on_one_address_do_not_show_each_others_frames() {
    let (one, other) = (
        store_with(&[&[solved(2.9, 0.006)]]),
        store_with(&[&[solved(2.1, 0.006)]]),
    );
    let series = other.path().join("flights/f0001/s000001");
    let manifest = std::fs::read_to_string(series.join("series.json")).unwrap();
    let another = b"another frame".to_vec();
    std::fs::write(series.join("0001.jpg"), &another).unwrap();
    let manifest = manifest.replace(&sha256_hex(&jpeg()), &sha256_hex(&another));
    let manifest = manifest.replace(
        &format!("\"bytes\": {}", jpeg().len()),
        &format!("\"bytes\": {}", another.len()),
    );
    std::fs::write(series.join("series.json"), manifest).unwrap();
    let first = Server::start(one.path()).get(FRAME);
    let kept = first.header("cache-control").unwrap();
    assert!(
        kept.contains("no-cache") && !kept.contains("immutable"),
        "{kept}"
    );
    assert_eq!(
        first.header("last-modified"),
        None,
        "files of two stores may be equally old"
    );
    let etag = first.header("etag").unwrap();
    let ask =
        format!("If-None-Match: {etag}\r\nIf-Modified-Since: Fri, 01 Jan 2100 00:00:00 GMT\r\n");
    let second = Server::start(other.path()).request("GET", FRAME, &ask);
    assert_eq!((second.status, second.body), (200, another));
    assert_eq!(
        Server::start(one.path()).request("GET", FRAME, &ask).status,
        304
    );
}

#[test]
fn an_old_store_gives_an_archive_too() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    for file in ["chain.jsonl", "SHA256SUMS"] {
        std::fs::remove_file(store.path().join("flights/f0001").join(file)).unwrap();
    }
    std::fs::write(store.path().join("store.toml"), "format = 1\n").unwrap();
    let answer = Server::start(store.path()).get(ARCHIVE);
    assert_eq!(answer.status, 200);
    let report = verify_path(&RealDisk, unpacked(&answer.body).path());
    assert!(report.is_sound() && report.results == 1, "{report:#?}");
}
