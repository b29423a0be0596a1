//! Promise: a result names the reference of its deflection and the sources of its variance; `orient` reports the bending
//! of the wing since the survey.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::program::{fixture, stdout};

/// The fixture's installation with its survey changed, oriented; and the output of `orient --json`.
fn oriented(change: impl Fn(&mut Vec<String>), more: &str) -> (tempfile::TempDir, Value) {
    let directory = tempfile::tempdir().unwrap();
    for name in ["installation.toml", "camera.toml"] {
        std::fs::copy(
            fixture("dev/installation").join(name),
            directory.path().join(name),
        )
        .unwrap();
    }
    let toml = directory.path().join("installation.toml");
    let text = std::fs::read_to_string(&toml).unwrap();
    // Its sections occur once: the remaining text of the wing section goes into the existing one.
    let still = "[wing]\nroot_rotation_sigma_mrad = 0.0\nroot_translation_sigma_m = 0.0\n";
    let text = if more == HELD {
        text.replace("[wing]\n", still)
    } else {
        text
    };
    std::fs::write(&toml, format!("{text}\n{more}")).unwrap();
    let survey = std::fs::read_to_string(fixture("dev/installation/survey.csv")).unwrap();
    let changed = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if cells[0].starts_with('M') {
            change(&mut cells);
        }
        cells.join(",")
    };
    let lines: Vec<String> = survey.lines().map(changed).collect();
    std::fs::write(directory.path().join("survey.csv"), lines.join("\n")).unwrap();
    let ground = frame("ground.jpg");
    let printed = stdout(&[
        "orient",
        "--json",
        "--installation",
        directory.path().to_str().unwrap(),
        &ground,
    ]);
    (directory, serde_json::from_str(&printed).unwrap())
}

fn frame(name: &str) -> String {
    fixture("dev/frames")
        .join(name)
        .to_str()
        .unwrap()
        .to_owned()
}

fn solved(installation: &Path) -> Value {
    let arguments = [
        "solve",
        "--json",
        "--installation",
        installation.to_str().unwrap(),
        &frame("flight-1.jpg"),
    ];
    serde_json::from_str(&stdout(&arguments)).unwrap()
}

/// Neither the wing nor its root has moved since the survey.
const HELD: &str = "[survey]\nbend_sigma_m = 0.0\nvertical_sigma_deg = 0.0\n";
const PRIORS: &str = "[survey]\nbend_sigma_m = 0.05\n";

/// Distance from the bending root along the span, m, as in the fixture's installation.toml.
fn outboard_m(cells: &[String]) -> f64 {
    let number = |k: usize| cells[k].parse::<f64>().unwrap();
    (number(3) - 35.1985) * 0.390731 + (number(4) - 18.7004) * 0.920505 - 0.55
}

/// A survey of a wing that was lower at the tip by `by_m`.
fn lower_survey(by_m: f64) -> impl Fn(&mut Vec<String>) {
    move |cells: &mut Vec<String>| {
        let e = (outboard_m(cells) / 33.0).clamp(0.0, 1.0);
        let z: f64 = cells[5].parse().unwrap();
        cells[5] = format!("{:.4}", z - by_m * e * e * (3.0 - e) / 2.0);
    }
}

#[test]
fn orient_reports_the_wing_height_relative_to_the_survey() {
    let number = |value: &Value| value.as_f64().unwrap();
    let (_still, as_surveyed) = oriented(|_| (), "");
    let (_bent, printed) = oriented(lower_survey(0.06), "");
    let bend = [&as_surveyed["bend"], &printed["bend"]];
    println!("{} {}", bend[0], bend[1]);
    assert_eq!(
        (&bend[0]["significant"], &bend[1]["significant"]),
        (&false.into(), &true.into())
    );
    let change = number(&bend[1]["height_m"]) - number(&bend[0]["height_m"]);
    assert!(
        (change - 0.06).abs() < 0.01,
        "{change}: both errors of the survey are the same"
    );
    assert!((0.002..0.02).contains(&number(&bend[1]["sigma_height_m"])));
    let remark = printed["remarks"][0].as_str().unwrap();
    assert!(
        remark.contains("in the ground frame the wing tip was")
            && remark.contains("higher than in the survey"),
        "{remark}"
    );
}

#[test]
fn results_have_three_deflections_and_a_budget() {
    let (plain, _) = oriented(|_| (), HELD);
    let record = solved(plain.path());
    assert_eq!(
        record["tip"]["reference"], "survey",
        "all are equally precise: {}",
        record["tip"]
    );
    let (bent, _) = oriented(|_| (), PRIORS);
    let record = solved(bent.path());
    let tip = &record["tip"];
    assert_eq!(tip["reference"], "ground", "{tip}");
    let number = |key: &str| tip[key].as_f64().unwrap();
    assert!(
        number("sigma_deflection_ground_m") < number("sigma_deflection_m"),
        "{tip}"
    );
    let marker = record["markers"]
        .as_array()
        .unwrap()
        .iter()
        .find(|m| m["id"] == tip["marker"])
        .unwrap();
    for key in [
        "deflection_m",
        "deflection_ground_m",
        "deflection_root_m",
        "sigma_deflection_ground_m",
        "sigma_deflection_root_m",
    ] {
        assert_eq!(marker[key], tip[key], "{key}");
    }
    let budget = record["budget"].as_array().unwrap();
    let share = |one: &Value| one["share"].as_f64().unwrap();
    assert!((budget.iter().map(share).sum::<f64>() - 1.0).abs() < 1e-9);
    assert!(
        budget
            .windows(2)
            .all(|pair| share(&pair[0]) >= share(&pair[1])),
        "the largest first"
    );
    assert!(
        budget
            .iter()
            .any(|one| one["source"] == "mounting" && one["sigma_if_known_m"].is_number())
    );
    assert!(
        budget
            .iter()
            .any(|one| one["source"] == "image" && one["sigma_if_known_m"].is_null())
    );

    let table = stdout(&[
        "solve",
        "--installation",
        bent.path().to_str().unwrap(),
        &frame("flight-1.jpg"),
    ]);
    assert!(
        table.contains("against the ground frame") && table.contains("variance comes from"),
        "{table}"
    );
    let plan: PathBuf = bent.path().into();
    let plan = stdout(&["plan", "--json", "--installation", plan.to_str().unwrap()]);
    let plan: Value = serde_json::from_str(&plan).unwrap();
    assert_eq!(plan["prediction"]["tip"]["reference"], "ground");
    let planned: f64 = plan["prediction"]["budget"]
        .as_array()
        .unwrap()
        .iter()
        .map(share)
        .sum();
    assert!((planned - 1.0).abs() < 1e-9);
}

#[test]
fn the_profile_method_has_one_deflection_and_two_sources() {
    let (plain, _) = oriented(|_| (), "");
    let directory = plain.path().to_str().unwrap();
    let line = stdout(&[
        "solve",
        "--json",
        "--method",
        "profile",
        "--installation",
        directory,
        &frame("flight-1.jpg"),
    ]);
    let record: Value = serde_json::from_str(&line).unwrap();
    assert!(
        record["tip"]["deflection_ground_m"].is_null() && record["tip"]["reference"] == "survey"
    );
    let sources: Vec<&str> = record["budget"]
        .as_array()
        .unwrap()
        .iter()
        .map(|one| one["source"].as_str().unwrap())
        .collect();
    assert!(
        sources.contains(&"image") && sources.contains(&"survey") && sources.len() == 2,
        "{sources:?}"
    );
}
