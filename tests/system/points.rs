//! Promise: points without a decal are surveyed, marked once on the ground, found in flight with honest standard deviations,
//! and used as markers are; a wing without any decal is measured by them.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::program::{outcome, run_in_folder, stdout};

/// A simulated set with points: the folder and the set in it.
fn simulate(seed: &str, markers: &str, deflections: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    let quadrants = if markers == "0" { "0" } else { "4" };
    let wing = [
        "--seed",
        seed,
        "--markers",
        markers,
        "--quadrants",
        quadrants,
        "--points",
        "12",
    ];
    let mut arguments = vec![
        "simulate",
        "--output",
        set.to_str().unwrap(),
        "--tip-deflections",
        deflections,
    ];
    arguments.extend(wing);
    stdout(&arguments);
    (folder, set)
}

fn orient(set: &Path) -> Value {
    let text = run_in_folder(
        set,
        &[
            "orient",
            "--json",
            "--observations",
            "frames/marks.csv",
            "frames/ground.jpg",
        ],
    );
    serde_json::from_str(&text).unwrap()
}

fn solve(set: &Path, frames: &[&str]) -> Vec<Value> {
    let mut arguments = vec!["solve", "--json", "--installation", "installation"];
    arguments.extend(frames);
    run_in_folder(set, &arguments)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

fn true_frames(set: &Path) -> Vec<Value> {
    let truth: Value =
        serde_json::from_str(&std::fs::read_to_string(set.join("truth.json")).unwrap()).unwrap();
    truth["frames"].as_array().unwrap().clone()
}

/// Error of the deflection of the outermost point against the survey, over its standard deviation.
fn normalised_tip(record: &Value, truth: &Value) -> f64 {
    let id = &record["tip"]["marker"];
    let expected = truth["markers"]
        .as_array()
        .unwrap()
        .iter()
        .find(|m| m["id"] == *id)
        .unwrap();
    let number = |value: &Value| value.as_f64().unwrap();
    (number(&record["tip"]["deflection_m"]) - number(&expected["deflection_m"]))
        / number(&record["tip"]["sigma_deflection_m"])
}

#[test]
fn a_wing_without_decals_is_measured_by_its_points() {
    let (_folder, set) = simulate("5", "0", "-0.4,2.4");
    let [installation, ground] = ["installation", "frames/ground.jpg"].map(|name| set.join(name));
    let (status, text) = outcome(&[
        "orient",
        "--installation",
        installation.to_str().unwrap(),
        ground.to_str().unwrap(),
    ]);
    assert_ne!(status, Some(0));
    assert!(
        text.contains(
            "needs 4 decals and marked points together, but there are 0 and 0: mark points"
        ),
        "{text}"
    );
    assert!(!text.contains("aircraft"), "{text}");
    let oriented = orient(&set);
    assert_eq!(
        oriented["unused"].as_array().unwrap().len(),
        0,
        "{}",
        oriented["unused"]
    );
    let frames = ["frames/flight-1.jpg", "frames/flight-2.jpg"];
    for (record, truth) in solve(&set, &frames).iter().zip(&true_frames(&set)[1..]) {
        assert_eq!(
            (&record["status"], &record["global_test"]),
            (&"ok".into(), &"passed".into()),
            "{}",
            record["reason"]
        );
        let points = record["markers"].as_array().unwrap();
        let used = points
            .iter()
            .filter(|m| m["used"] == true && m["shape"] == "point")
            .count();
        assert!(used >= 10, "{used} of 12 points");
        let normalised = normalised_tip(record, truth);
        println!("{used} points, normalised tip {normalised:.2}");
        assert!(normalised.abs() < 3.0, "{normalised}");
    }
    // The templates are part of the installation and of its digest.
    let record = &solve(&set, &frames[..1])[0];
    assert!(
        record["provenance"].to_string().contains("points.png"),
        "{}",
        record["provenance"]
    );
    std::fs::write(set.join("installation/points.png"), b"no image").unwrap();
    let (status, text) = outcome(&["check", "--installation", installation.to_str().unwrap()]);
    assert_ne!(status, Some(0));
    assert!(
        text.contains("points.png: file: is not an image of 12 templates"),
        "{text}"
    );
}

#[test]
fn points_beside_decals_do_not_make_a_result_worse() {
    let (_folder, set) = simulate("6", "14", "2.0");
    orient(&set);
    let truth = &true_frames(&set)[1];
    let with = &solve(&set, &["frames/flight-1.jpg"])[0];
    let survey = set.join("installation/survey.csv");
    let text = std::fs::read_to_string(&survey).unwrap();
    let decals: Vec<&str> = text.lines().filter(|line| !line.starts_with('P')).collect();
    std::fs::write(&survey, decals.join("\n")).unwrap();
    run_in_folder(&set, &["orient", "frames/ground.jpg"]);
    let without = &solve(&set, &["frames/flight-1.jpg"])[0];
    let sigma = |record: &Value| record["tip"]["sigma_deflection_m"].as_f64().unwrap();
    println!(
        "tip {:.4} m with points, {:.4} m without",
        sigma(with),
        sigma(without)
    );
    assert!(sigma(with) <= 1.01 * sigma(without));
    assert!(normalised_tip(with, truth).abs() < 3.0);
    let used = with["markers"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|m| m["shape"] == "point" && m["used"] == true)
        .count();
    assert!(used >= 10, "{used} of 12 points");
}

#[test]
fn a_point_has_no_diameter_and_must_be_marked() {
    let (_folder, set) = simulate("6", "14", "2.0");
    let text = run_in_folder(&set, &["orient", "frames/ground.jpg"]);
    assert!(
        text.contains("not used: P01: it has no decal and was not marked"),
        "{text}"
    );
    let record = &solve(&set, &["frames/flight-1.jpg"])[0];
    let point = record["markers"]
        .as_array()
        .unwrap()
        .iter()
        .find(|m| m["id"] == "P01")
        .unwrap();
    assert!(
        point["reason"]
            .as_str()
            .unwrap()
            .starts_with("the ground frames have no template of it"),
        "{}",
        point["reason"]
    );
    // A place without a standard deviation has that of a corner in a loupe.
    let marks = std::fs::read_to_string(set.join("frames/marks.csv")).unwrap();
    std::fs::write(
        set.join("frames/marks.csv"),
        marks.replace(",0.5,,0.5,", ",,,,"),
    )
    .unwrap();
    assert_eq!(orient(&set)["unused"].as_array().unwrap().len(), 0);

    let survey = set.join("installation/survey.csv");
    let text = std::fs::read_to_string(&survey).unwrap();
    std::fs::write(&survey, text.replacen("P01,point,,", "P01,point,0.2,", 1)).unwrap();
    let installation = set.join("installation");
    let (status, text) = outcome(&["check", "--installation", installation.to_str().unwrap()]);
    assert_ne!(status, Some(0));
    assert!(
        text.contains("is \"0.2\" for a point, which has no decal; leave it empty"),
        "{text}"
    );
}
