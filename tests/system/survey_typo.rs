//! Promise: a wrong surveyed point is excluded, also from the wing's ground shape: the result equals that
//! of a survey without it.

use serde_json::Value;

use crate::program::{fixture, stdout};

/// Tip deflection with its standard deviation from the first frame in flight, the survey's text changed.
fn tip(change: impl Fn(String) -> String) -> (f64, f64) {
    let directory = tempfile::tempdir().unwrap();
    for name in ["installation.toml", "camera.toml", "survey.csv"] {
        std::fs::copy(
            fixture("dev/installation").join(name),
            directory.path().join(name),
        )
        .unwrap();
    }
    let survey = directory.path().join("survey.csv");
    std::fs::write(&survey, change(std::fs::read_to_string(&survey).unwrap())).unwrap();
    let installation = directory.path().to_str().unwrap();
    let frame = |name: &str| {
        fixture("dev/frames")
            .join(name)
            .to_str()
            .unwrap()
            .to_owned()
    };
    stdout(&[
        "orient",
        "--installation",
        installation,
        &frame("ground.jpg"),
    ]);
    let line = stdout(&[
        "solve",
        "--json",
        "--installation",
        installation,
        &frame("flight-1.jpg"),
    ]);
    let found: Value = serde_json::from_str(&line).unwrap();
    assert_eq!(found["status"], "ok", "{found}");
    let number = |key: &str| found["tip"][key].as_f64().unwrap();
    (number("deflection_m"), number("sigma_deflection_m"))
}

#[test]
fn a_survey_point_with_two_digits_exchanged_is_excluded() {
    let (typo, _) = tip(|survey| {
        let wrong = survey.replace("26.4142", "24.6142");
        assert_ne!(wrong, survey, "the fixture's M02 has another position");
        wrong
    });
    let without = |survey: String| {
        survey
            .lines()
            .filter(|l| !l.starts_with("M02"))
            .fold(String::new(), |t, l| t + l + "\n")
    };
    let (removed, sigma) = tip(without);
    assert!(
        (typo - removed).abs() < 0.1 * sigma,
        "{typo} {removed} +- {sigma}"
    );
}
