//! Promise: `wingd learn` adds the prior from flights to the installation, each flight once; results name their prior, a
//! flight of the prior gains nothing from itself, and a changed installation is reported.

use std::path::Path;

use serde_json::Value;

use crate::json_schemas::assert_valid;
use crate::program::{fixture, outcome, run, stdout};

fn frames(numbers: &[u8]) -> Vec<String> {
    numbers
        .iter()
        .map(|n| {
            fixture(&format!("demo/frames/flight-{n:02}.jpg"))
                .display()
                .to_string()
        })
        .collect()
}

/// The demo installation with its orientation, and two flights of it in separate stores.
fn prepare_installation(folder: &Path) -> (String, [String; 2]) {
    let at = folder.join("installation");
    std::fs::create_dir(&at).unwrap();
    for name in ["installation.toml", "camera.toml", "survey.csv"] {
        std::fs::copy(fixture("demo/installation").join(name), at.join(name)).unwrap();
    }
    let at = at.display().to_string();
    let ground = fixture("demo/frames/ground.jpg").display().to_string();
    stdout(&["orient", "--installation", &at, &ground]);
    let store = |name: &str, numbers: &[u8]| {
        let store = folder.join(name).display().to_string();
        let taken = frames(numbers);
        let pictures: Vec<&str> = taken.iter().map(String::as_str).collect();
        stdout(
            &[
                &["import", "--store", &store, "--flight", name],
                &pictures[..],
            ]
            .concat(),
        );
        store
    };
    (at, [store("a", &[1, 4, 5, 8]), store("b", &[2, 3, 6, 7])])
}

fn solved(at: &str, frame: u8) -> Value {
    serde_json::from_str(&stdout(&[
        "solve",
        "--json",
        "--installation",
        at,
        &frames(&[frame])[0],
    ]))
    .unwrap()
}

fn sigma(record: &Value) -> f64 {
    record["tip"]["sigma_deflection_root_m"].as_f64().unwrap()
}

fn remarks(record: &Value) -> String {
    record["remarks"].to_string()
}

#[test]
fn the_flight_prior_helps_a_later_frame_and_no_flight_counts_twice() {
    let folder = tempfile::tempdir().unwrap();
    let (at, [a, b]) = prepare_installation(folder.path());
    let alone = solved(&at, 10);
    let learn_output = run(&["learn", "--json", "--installation", &at, &a, &b]);
    assert!(
        learn_output.status.success(),
        "{}",
        String::from_utf8_lossy(&learn_output.stderr)
    );
    assert_valid("learn", &learn_output.stdout);
    let printed: Value = serde_json::from_slice(&learn_output.stdout).unwrap();
    assert_eq!(
        (
            printed["flights_in_prior"].as_u64(),
            printed["flights"][1]["status"].as_str()
        ),
        (Some(2), Some("added"))
    );
    assert_valid(
        "flight_prior",
        &std::fs::read(folder.path().join("installation/flight_prior.json")).unwrap(),
    );

    let beside = solved(&at, 10);
    println!(
        "sigma of the tip: {:.4} m alone, {:.4} m with the prior",
        sigma(&alone),
        sigma(&beside)
    );
    assert!(sigma(&beside) < 0.8 * sigma(&alone));
    assert!(
        remarks(&beside).contains("adjusted with the prior from 2 flights"),
        "{}",
        remarks(&beside)
    );
    assert!(
        beside["provenance"]["flight_prior.json.sha256"].is_string()
            && alone["provenance"]["flight_prior.json.sha256"].is_null()
    );
    assert!(
        outcome(&["check", "--installation", &at])
            .1
            .contains("from 2 flights")
    );

    let planned: Value =
        serde_json::from_str(&stdout(&["plan", "--json", "--installation", &at])).unwrap();
    let tip = |of: &Value| of["sigma_tip_deflection_m"].as_f64().unwrap();
    assert_eq!(planned["flight_prior"]["flights"].as_u64(), Some(2));
    let (without, with) = (
        &planned["prediction"]["expected"],
        &planned["flight_prior"]["expected"],
    );
    println!(
        "planned: {:.4} m alone, {:.4} m with the prior",
        tip(without),
        tip(with)
    );
    assert!(tip(with) < 0.9 * tip(without));
    let text = stdout(&["plan", "--frames", "5", "--installation", &at]);
    assert!(
        text.contains(
            "5 frames, with the prior from 2 flights (flight_prior.json): tip deflection"
        ),
        "{text}"
    );

    // A frame of a contributing flight uses the other flight alone; so does the flight.
    let own = solved(&at, 1);
    assert!(
        remarks(&own).contains("adjusted with the prior from one flight"),
        "{}",
        remarks(&own)
    );
    assert!(remarks(&own).contains("its own contribution is excluded here"));
    let flight = stdout(&["solve", "--json", "--joint", "--installation", &at, &b]);
    assert!(flight.contains("its own contribution is excluded here"));

    let before = std::fs::read(folder.path().join("installation/flight_prior.json")).unwrap();
    let (status, again) = outcome(&["learn", "--installation", &at, &a, &b]);
    assert_eq!(status, Some(0));
    assert!(
        again
            .matches("already included in flight_prior.json")
            .count()
            == 2,
        "{again}"
    );
    assert_eq!(
        before,
        std::fs::read(folder.path().join("installation/flight_prior.json")).unwrap()
    );

    // One digit of a surveyed point changed: the flight prior is no longer valid.
    let survey = folder.path().join("installation/survey.csv");
    let text = std::fs::read_to_string(&survey).unwrap();
    std::fs::write(&survey, text.replacen("0.002", "0.003", 1)).unwrap();
    stdout(&[
        "orient",
        "--installation",
        &at,
        &fixture("demo/frames/ground.jpg").display().to_string(),
    ]);
    let (status, printed) = outcome(&["solve", "--installation", &at, &frames(&[10])[0]]);
    assert_eq!(status, Some(78));
    assert!(
        printed.contains("flight_prior.json: made_with: orientation.toml and survey.csv changed"),
        "{printed}"
    );
    assert!(
        printed.contains("1 error in the configuration or installation"),
        "{printed}"
    );
}

#[test]
fn an_invalid_flight_prior_is_one_fault() {
    let folder = tempfile::tempdir().unwrap();
    let (at, [a, _]) = prepare_installation(folder.path());
    stdout(&["learn", "--installation", &at, &a]);
    let file = folder.path().join("installation/flight_prior.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let half = text[..text.len() / 2].to_owned();
    for spoiled in [
        half,
        "{}".into(),
        text.replacen("\"format\":1", "\"format\":2", 1),
    ] {
        std::fs::write(&file, spoiled).unwrap();
        let (status, printed) = outcome(&["check", "--installation", &at]);
        assert!(
            status == Some(78) && printed.contains("flight_prior.json"),
            "{printed}"
        );
    }
}
