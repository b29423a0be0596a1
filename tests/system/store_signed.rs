//! Promise: a signed store is verified with the public key, and a forged one is not.
// Moves files as a user would.
#![allow(clippy::disallowed_methods)]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use serde_json::Value;
use wingd::store::verify::verify_path;
use wingd::store::{RealDisk, Store, StoreConfig, sha256_hex};

use super::store_evidence::{FLIGHT, copy_store, fill, open, replace, wingd};

/// A store with signed flights; the public key.
fn signed() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let key = dir.path().join("recorder.key");
    let root = dir.path().join("store");
    let config = StoreConfig {
        reserve_mb: 0,
        signing_key: Some(key.clone()),
        ..StoreConfig::new(&root)
    };
    let store = Store::open(Arc::new(RealDisk), config).unwrap().0;
    fill(&store);
    let public = PathBuf::from(format!("{}.pub", key.display()));
    (dir, public)
}

fn verify_with(root: &Path, key: &Path) -> (Option<i32>, String) {
    let output = wingd(&["verify", "--key", key.to_str().unwrap()], root);
    let text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8(text).unwrap())
}

/// Rewrites the chain of a flight with all its digests and sums, as an informed attacker could.
fn forge(root: &Path, keep_signatures: bool) {
    let results = root.join(FLIGHT).join("s000001/results.jsonl");
    replace(root, "flights/f0001/s000001/results.jsonl", "2.74", "9.74");
    let bytes = std::fs::read(results).unwrap();
    let ends: Vec<_> = (0..bytes.len())
        .filter(|at| bytes[*at] == b'\n')
        .map(|at| at + 1)
        .collect();
    let chain = std::fs::read_to_string(root.join(FLIGHT).join("chain.jsonl")).unwrap();
    let (mut before, mut forged, mut count) = ("0".repeat(64), String::new(), 0);
    for line in chain.lines() {
        let mut link: Value = serde_json::from_str(line).unwrap();
        if !keep_signatures && link.get("signature").is_some() {
            continue;
        }
        if link["results"]["series"] == "s000001" {
            link["results"]["sha256"] = sha256_hex(&bytes[..ends[count]]).into();
            count += 1;
        }
        link["before"] = before.into();
        let line = link.to_string();
        before = sha256_hex(line.as_bytes());
        forged += &(line + "\n");
    }
    std::fs::write(root.join(FLIGHT).join("chain.jsonl"), forged).unwrap();
    std::fs::remove_file(root.join(FLIGHT).join("SHA256SUMS")).unwrap();
}

#[test]
fn a_signed_store_is_verified_with_its_public_key_and_no_other() {
    use std::os::unix::fs::PermissionsExt;
    let (dir, key) = signed();
    let root = dir.path().join("store");
    let (status, printed) = verify_with(&root, &key);
    assert_eq!(status, Some(0), "{printed}");
    let secret = std::fs::metadata(dir.path().join("recorder.key")).unwrap();
    assert_eq!(
        secret.permissions().mode() & 0o077,
        0,
        "for the recorder alone"
    );
    let (other, foreign) = signed();
    let (status, printed) = verify_with(&root, &foreign);
    assert!(
        status == Some(1) && printed.contains("no signature by this key"),
        "{printed}"
    );
    let (status, printed) = verify_with(&root, &other.path().join("recorder.key"));
    assert!(status == Some(1) && printed.contains(".pub"), "{printed}");
    // Without signatures there is nothing to verify.
    let (status, printed) = verify_with(copy_store().path(), &key);
    assert!(
        status == Some(1) && printed.contains("no signature"),
        "{printed}"
    );
}

#[test]
fn a_store_forged_with_all_its_digests_is_sound_and_lacks_its_signature() {
    for keep_signatures in [true, false] {
        let (dir, key) = signed();
        let root = dir.path().join("store");
        forge(&root, keep_signatures);
        // An opening without the key extends the sums to the forged chain.
        drop(open(&root));
        let report = verify_path(&RealDisk, &root);
        assert!(
            report.is_sound(),
            "a complete rewrite leaves no trace: {:#?}",
            report.faults
        );
        let (status, printed) = verify_with(&root, &key);
        let wanted = if keep_signatures {
            "is not valid"
        } else {
            "no signature by this key"
        };
        assert!(status == Some(1) && printed.contains(wanted), "{printed}");
    }
}

#[test]
fn a_chain_that_is_not_the_signed_one_is_not_signed_again_and_openssl_agrees_about_the_sound_one() {
    let (dir, key) = signed();
    let root = dir.path().join("store");
    let chain = std::fs::read_to_string(root.join(FLIGHT).join("chain.jsonl")).unwrap();
    let link: Value = serde_json::from_str(chain.lines().last().unwrap()).unwrap();
    std::fs::write(
        dir.path().join("message"),
        format!("wingd chain {}", link["before"].as_str().unwrap()),
    )
    .unwrap();
    std::fs::write(
        dir.path().join("signature"),
        hex::decode(link["signature"]["signature"].as_str().unwrap()).unwrap(),
    )
    .unwrap();
    let openssl = Command::new("openssl")
        .args(["pkeyutl", "-verify", "-rawin", "-pubin", "-inkey"])
        .arg(&key)
        .args(["-in", "message", "-sigfile", "signature"])
        .current_dir(dir.path())
        .output()
        .unwrap();
    assert!(
        openssl.status.success(),
        "{}",
        String::from_utf8_lossy(&openssl.stderr)
    );

    forge(&root, true);
    let before = std::fs::read(root.join(FLIGHT).join("chain.jsonl")).unwrap();
    let signing_key = Some(dir.path().join("recorder.key"));
    let config = StoreConfig {
        reserve_mb: 0,
        signing_key,
        ..StoreConfig::new(&root)
    };
    let (_, recovery) = Store::open(Arc::new(RealDisk), config).unwrap();
    assert!(
        recovery
            .remarks
            .iter()
            .any(|remark| remark.contains("not signed")),
        "{:?}",
        recovery.remarks
    );
    assert_eq!(
        std::fs::read(root.join(FLIGHT).join("chain.jsonl")).unwrap(),
        before
    );
}

#[test]
fn a_flight_that_is_missing_without_a_record_is_a_fault() {
    let (dir, key) = signed();
    let root = dir.path().join("store");
    let config = StoreConfig {
        reserve_mb: 0,
        signing_key: Some(dir.path().join("recorder.key")),
        ..StoreConfig::new(&root)
    };
    let (store, _) = Store::open(Arc::new(RealDisk), config).unwrap();
    store.request_new_flight();
    fill(&store);
    drop(store);
    assert_eq!(verify_with(&root, &key).0, Some(0));
    let copy = dir.path().join("copy");
    let copied = wingd(&["copy", root.to_str().unwrap()], &copy);
    assert!(copied.status.success());
    let moved = dir.path().join("moved");
    std::fs::rename(root.join(FLIGHT), &moved).unwrap();
    let (status, text) = verify_with(&root, &key);
    assert!(
        status == Some(1) && text.contains("the first is f0001"),
        "{text}"
    );
    // A copy of single flights is verified by their folders.
    assert_eq!(verify_with(&root.join("flights/f0002"), &key).0, Some(0));
    std::fs::rename(&moved, root.join(FLIGHT)).unwrap();
    let copy = copy.to_str().unwrap();
    let pruned = wingd(&["prune", "--verified-copy", copy], &root);
    assert!(pruned.status.success(), "{pruned:?}");
    let (status, text) = verify_with(&root, &key);
    assert!(
        status == Some(0) && text.contains("f0001 was pruned"),
        "{text}"
    );
}
