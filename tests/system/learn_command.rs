//! Promise: `wingd learn` takes what flights told into the installation, each flight once; results say with what they were made, a
//! flight that taught is not helped by itself, and a changed installation is named.

use std::path::Path;

use serde_json::Value;

use crate::json_schemas::holds;
use crate::program::{fixture, outcome, run, stdout};

fn frames(numbers: &[u8]) -> Vec<String> {
    numbers.iter().map(|n| fixture(&format!("demo/frames/flight-{n:02}.jpg")).display().to_string()).collect()
}

/// The demonstration's installation with its orientation, and two flights of it in stores of their own.
fn prepared(folder: &Path) -> (String, [String; 2]) {
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
        stdout(&[&["import", "--store", &store, "--flight", name], &pictures[..]].concat());
        store
    };
    (at, [store("a", &[1, 4, 5, 8]), store("b", &[2, 3, 6, 7])])
}

fn solved(at: &str, frame: u8) -> Value {
    serde_json::from_str(&stdout(&["solve", "--json", "--installation", at, &frames(&[frame])[0]])).unwrap()
}

fn sigma(record: &Value) -> f64 {
    record["tip"]["sigma_deflection_root_m"].as_f64().unwrap()
}

fn remarks(record: &Value) -> String {
    record["remarks"].to_string()
}

#[test]
fn what_flights_taught_helps_a_later_frame_and_no_flight_counts_twice() {
    let folder = tempfile::tempdir().unwrap();
    let (at, [a, b]) = prepared(folder.path());
    let alone = solved(&at, 10);
    let learnt = run(&["learn", "--json", "--installation", &at, &a, &b]);
    assert!(learnt.status.success(), "{}", String::from_utf8_lossy(&learnt.stderr));
    holds("learn", &learnt.stdout);
    let said: Value = serde_json::from_slice(&learnt.stdout).unwrap();
    assert_eq!(
        (said["flights_in_prior"].as_u64(), said["flights"][1]["status"].as_str()),
        (Some(2), Some("added"))
    );
    holds("flight_prior", &std::fs::read(folder.path().join("installation/flight_prior.json")).unwrap());

    let beside = solved(&at, 10);
    println!("sigma of the tip: {:.4} m alone, {:.4} m beside", sigma(&alone), sigma(&beside));
    assert!(sigma(&beside) < 0.8 * sigma(&alone));
    assert!(remarks(&beside).contains("adjusted with what 2 flights taught"), "{}", remarks(&beside));
    assert!(
        beside["provenance"]["flight_prior.json.sha256"].is_string()
            && alone["provenance"]["flight_prior.json.sha256"].is_null()
    );
    assert!(outcome(&["check", "--installation", &at]).1.contains("with what 2 flights taught"));

    let planned: Value = serde_json::from_str(&stdout(&["plan", "--json", "--installation", &at])).unwrap();
    let tip = |of: &Value| of["sigma_tip_deflection_m"].as_f64().unwrap();
    assert_eq!(planned["flight_prior"]["flights"].as_u64(), Some(2));
    let (without, with) = (&planned["prediction"]["expected"], &planned["flight_prior"]["expected"]);
    println!("planned: {:.4} m alone, {:.4} m beside", tip(without), tip(with));
    assert!(tip(with) < 0.9 * tip(without));
    let text = stdout(&["plan", "--frames", "5", "--installation", &at]);
    assert!(
        text.contains("5 frames beside what 2 flights taught (flight_prior.json): tip deflection"),
        "{text}"
    );

    // A frame of a flight that taught stands beside the other alone; so does the flight.
    let own = solved(&at, 1);
    assert!(remarks(&own).contains("adjusted with what a flight taught"), "{}", remarks(&own));
    assert!(remarks(&own).contains("what it told itself is left out"));
    let flight = stdout(&["solve", "--json", "--together", "--installation", &at, &b]);
    assert!(flight.contains("what it told itself is left out"));

    let before = std::fs::read(folder.path().join("installation/flight_prior.json")).unwrap();
    let (status, again) = outcome(&["learn", "--installation", &at, &a, &b]);
    assert_eq!(status, Some(0));
    assert!(again.matches("it taught already").count() == 2, "{again}");
    assert_eq!(before, std::fs::read(folder.path().join("installation/flight_prior.json")).unwrap());

    // One digit of a surveyed point: what was learnt does not hold for it.
    let survey = folder.path().join("installation/survey.csv");
    let text = std::fs::read_to_string(&survey).unwrap();
    std::fs::write(&survey, text.replacen("0.002", "0.003", 1)).unwrap();
    stdout(&["orient", "--installation", &at, &fixture("demo/frames/ground.jpg").display().to_string()]);
    let (status, said) = outcome(&["solve", "--installation", &at, &frames(&[10])[0]]);
    assert_eq!(status, Some(78));
    assert!(said.contains("flight_prior.json: made_with: orientation.toml and survey.csv changed"), "{said}");
    assert!(said.contains("1 fault to mend"), "{said}");
}

#[test]
fn a_file_that_no_flight_wrote_is_one_fault() {
    let folder = tempfile::tempdir().unwrap();
    let (at, [a, _]) = prepared(folder.path());
    stdout(&["learn", "--installation", &at, &a]);
    let file = folder.path().join("installation/flight_prior.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let half = text[..text.len() / 2].to_owned();
    for spoiled in [half, "{}".into(), text.replacen("\"format\":1", "\"format\":2", 1)] {
        std::fs::write(&file, spoiled).unwrap();
        let (status, said) = outcome(&["check", "--installation", &at]);
        assert!(status == Some(78) && said.contains("flight_prior.json"), "{said}");
    }
}
