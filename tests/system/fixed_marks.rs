//! Promise: fixed targets are rendered, found, identified and used from simulate to solve, have no deflection, and
//! `plan` reports their gain; the user can declare which frames share a mounting.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::program::{run, stdout};

/// A simulated set with two fixed targets, oriented: the folder, the installation, a flight frame.
fn set() -> (tempfile::TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("set");
    let text = output.to_str().unwrap();
    let small = [
        "--size",
        "2000",
        "1500",
        "--focal",
        "3900",
        "--fixed-targets",
        "2",
        "--tip-deflections",
        "2.5",
    ];
    let mut arguments = vec!["simulate", "--output", text, "--seed", "5"];
    arguments.extend(small);
    stdout(&arguments);
    let (installation, frames) = (output.join("installation"), output.join("frames"));
    let ground = frames.join("ground.jpg");
    stdout(&[
        "orient",
        "--installation",
        installation.to_str().unwrap(),
        ground.to_str().unwrap(),
    ]);
    (folder, installation, frames.join("flight-1.jpg"))
}

fn solved(installation: &Path, frame: &Path, more: &[&str]) -> Value {
    let mut arguments = vec![
        "solve",
        "--installation",
        installation.to_str().unwrap(),
        "--json",
    ];
    arguments.extend(more);
    arguments.push(frame.to_str().unwrap());
    serde_json::from_str(&stdout(&arguments)).unwrap()
}

fn sigma_of_the_tip(record: &Value) -> f64 {
    record["tip"]["sigma_deflection_m"].as_f64().unwrap()
}

#[test]
fn fixed_targets_are_used_from_simulate_to_solve() {
    let (folder, installation, frame) = set();
    let with = solved(&installation, &frame, &[]);
    for mark in with["markers"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|m| m["id"].as_str().unwrap().starts_with('F'))
    {
        assert_eq!(mark["used"], true, "{mark}");
        assert!(mark["deflection_m"].is_null(), "{mark}");
    }
    assert_eq!(with["global_test"], "passed", "{}", with["global_test"]);

    let mountings = folder.path().join("mountings.csv");
    std::fs::write(&mountings, "image,mounting\nflight-1.jpg,ground\n").unwrap();
    let stayed = solved(
        &installation,
        &frame,
        &["--mountings", mountings.to_str().unwrap()],
    );
    assert!(sigma_of_the_tip(&stayed) <= sigma_of_the_tip(&with));

    // Targets treated as if on the wing would not constrain the camera: here they are absent.
    let survey = installation.join("survey.csv");
    let text = std::fs::read_to_string(&survey).unwrap();
    assert!(text.starts_with("id,shape,diameter_m,x_m,y_m,z_m,sigma_m,fixed,flight_motion_m\n"));
    let wing: Vec<&str> = text.lines().filter(|l| !l.starts_with('F')).collect();
    std::fs::write(&survey, wing.join("\n")).unwrap();
    let ground = frame.with_file_name("ground.jpg");
    stdout(&[
        "orient",
        "--installation",
        installation.to_str().unwrap(),
        ground.to_str().unwrap(),
    ]);
    let without = solved(&installation, &frame, &[]);
    let (with, without) = (sigma_of_the_tip(&with), sigma_of_the_tip(&without));
    assert!(
        with < 0.8 * without,
        "{with} m with two fixed targets, {without} m without"
    );
}

fn dev() -> String {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fixtures/dev/installation")
        .to_str()
        .unwrap()
        .to_owned()
}

#[test]
fn the_plan_reports_the_gain_from_fixed_targets_and_the_contribution_of_each_unknown() {
    let dev = dev();
    let wanted = ["plan", "--installation", &dev, "--want", "5mm"];
    let plan: Value = serde_json::from_str(&stdout(&[&wanted[..], &["--json"]].concat())).unwrap();
    let prediction = &plan["prediction"];
    let now = prediction["expected"]["sigma_tip_deflection_m"]
        .as_f64()
        .unwrap();
    let remedies = plan["remedies"].as_array().unwrap();
    let with_targets: Vec<&Value> = remedies
        .iter()
        .filter(|one| one["remedy"].as_str().unwrap().contains("fixed targets"))
        .collect();
    assert!(!with_targets.is_empty(), "{remedies:?}");
    for one in with_targets {
        let then = one["sigma_taken_m"]
            .as_f64()
            .or(one["sigma_alone_m"].as_f64());
        assert!(then.is_some_and(|m| m < now), "{one} after {now} m");
    }
    let budget = prediction["budget"].as_array().unwrap();
    assert!(budget.len() >= 5, "{budget:?}");
    let shares: f64 = budget
        .iter()
        .map(|one| one["share"].as_f64().unwrap())
        .sum();
    assert!((shares - 1.0).abs() < 1e-9, "{shares}");
    let text = stdout(&wanted);
    assert!(
        text.contains("2 fixed targets") && text.contains("root flexibility"),
        "{text}"
    );
}

#[test]
fn a_frame_without_a_mounting_is_reported_before_solving() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mountings.csv");
    std::fs::write(&file, "image,mounting\nother.jpg,a\n").unwrap();
    let output = run(&[
        "solve",
        "--installation",
        &dev(),
        "--joint",
        "--mountings",
        file.to_str().unwrap(),
        "one.jpg",
        "other.jpg",
    ]);
    let printed = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(78), "{printed}");
    assert!(
        printed.contains("one.jpg") && printed.contains("mountings.csv"),
        "{printed}"
    );
}
