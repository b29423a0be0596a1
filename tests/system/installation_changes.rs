//! Promise: the running recorder uses an installation that appears or changes.

use crate::common::store_reading::read_live;
use serde_json::Value;
use wingd::store::{RealDisk, catalogue};

use super::recorder_survives::{FIRST_SERIES, Recorder, assert_sound, configure, fault_of};
use crate::program::fixture;

/// Whatever happens to the installation while the recorder runs is taken up: it appears, is damaged, changes.
#[test]
fn an_installation_that_appears_or_changes_is_taken_up() {
    let dir = tempfile::tempdir().unwrap();
    configure(dir.path(), "[live]\nrate_hz = 2\n");
    let (file, store) = (dir.path().join("wingd.toml"), dir.path().join("store"));
    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::write(&file, format!("installation = \"installation\"\n{text}")).unwrap();
    let mut recorder = Recorder::start(dir.path());
    recorder.records();
    let fault = fault_of(
        &recorder.wait("a fault", FIRST_SERIES, |status| {
            !fault_of(status, "solver").is_empty()
        }),
        "solver",
    );
    assert!(
        fault.contains("not solved until this error is fixed")
            && fault.contains("installation.toml"),
        "{fault}"
    );
    // It is prepared in its place, as by an operator: the orientation comes last.
    let installation = dir.path().join("installation");
    std::fs::create_dir(&installation).unwrap();
    for name in ["installation.toml", "camera.toml", "survey.csv"] {
        std::fs::copy(
            fixture("dev/installation").join(name),
            installation.join(name),
        )
        .unwrap();
    }
    let ground = fixture("dev/frames/ground.jpg");
    let orient = || {
        let asked = [
            "orient",
            "--installation",
            installation.to_str().unwrap(),
            ground.to_str().unwrap(),
        ];
        crate::program::stdout(&asked)
    };
    orient();
    let solves = |status: &Value, more: u64| {
        let (solved, live) = (
            status["counts"]["solved"].as_u64(),
            status["live"]["stored"].as_u64(),
        );
        solved > Some(more) && live > Some(more)
    };
    let status = recorder.wait("results", 2 * FIRST_SERIES, |status| solves(status, 0));
    assert!(fault_of(&status, "solver").is_empty(), "{status}");
    // A damaged file is named; the installation before is used.
    let camera = installation.join("camera.toml");
    let whole = std::fs::read_to_string(&camera).unwrap();
    std::fs::write(&camera, &whole[..whole.len() / 2]).unwrap();
    let status = recorder.wait("a fault", FIRST_SERIES, |status| {
        !fault_of(status, "solver").is_empty()
    });
    let fault = fault_of(&status, "solver");
    assert!(
        fault.contains("solved with the installation before") && fault.contains("camera.toml"),
        "{fault}"
    );
    let results = status["counts"]["solved"].as_u64().unwrap();
    recorder.wait("results", FIRST_SERIES, |status| {
        status["counts"]["solved"].as_u64() > Some(results)
    });
    // Another calibration: further live results and those of further series come from it.
    std::fs::write(&camera, format!("# calibrated again\n{whole}")).unwrap();
    orient();
    recorder.wait("no fault", FIRST_SERIES, |status| {
        fault_of(status, "solver").is_empty()
    });
    let live = || {
        catalogue::list_flights(&RealDisk, &store)
            .unwrap()
            .iter()
            .flat_map(|flight| read_live(&RealDisk, &store, flight).unwrap().0)
            .map(|(head, _)| head.table.source["provenance"]["camera.toml.sha256"].clone())
            .collect::<Vec<_>>()
    };
    recorder.wait("results of both", FIRST_SERIES, |_| {
        live().windows(2).any(|pair| pair[0] != pair[1])
    });
    recorder.end();
    let live = live();
    assert!(
        live.is_sorted_by_key(|camera| camera != &live[0]) && live.iter().all(Value::is_string),
        "{live:?}"
    );
    let kept = std::fs::read_dir(store.join("installations"))
        .unwrap()
        .count();
    assert_eq!(kept, 2, "both are kept with the store");
    assert_sound(&store);
}
