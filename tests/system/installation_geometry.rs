//! Faults that only the geometry of an installation reveals are named by their cause, equally by every command.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fixtures")
        .join(name)
}

fn run(arguments: &[&str]) -> (Option<i32>, String) {
    let output: Output = Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args(arguments)
        .output()
        .unwrap();
    let text = [output.stdout, output.stderr].concat();
    (
        output.status.code(),
        String::from_utf8_lossy(&text).into_owned(),
    )
}

/// A copy of an installation with one file's text changed.
fn changed(of: &str, file: &str, from: &str, to: &str) -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(fixture(of)).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, directory.path().join(path.file_name().unwrap())).unwrap();
    }
    let path = directory.path().join(file);
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{file} does not contain \"{from}\"");
    std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
    directory
}

fn dev(file: &str, from: &str, to: &str) -> tempfile::TempDir {
    changed("dev/installation", file, from, to)
}

#[test]
fn a_sound_installation_alone_is_checked() {
    for name in ["dev/installation", "demo/installation"] {
        let (status, printed) = run(&["check", "--installation", fixture(name).to_str().unwrap()]);
        assert_eq!(status, Some(0), "{printed}");
        assert!(
            printed.contains("markers") && printed.contains("wingd orient"),
            "{printed}"
        );
        assert!(
            printed.contains("in the image") && !printed.contains("of another wing"),
            "{printed}"
        );
    }
    assert_eq!(run(&["check"]).0, Some(2), "something is to be named");
}

/// An installation copied from another type is contradicted line by line, with both numbers.
#[test]
fn values_of_another_wing_contradict_the_survey() {
    for (from, to, key, limit) in [
        (
            "root_offset_m = 0.55",
            "root_offset_m = 9.0",
            "wing.root_offset_m",
            "is 9, but at most 6.62 by the innermost",
        ),
        (
            "offset_m = 0.1\n",
            "offset_m = 6.0\n",
            "wing.axis_chord_offset_m",
            "is 6, but -1.64 to 1.81",
        ),
        (
            "root = 0.4838",
            "root = 1.9",
            "wing.skin_height_m.root",
            "is 1.9, but -0.19 to 1.14",
        ),
        (
            "tip = 0.1382",
            "tip = 1.2",
            "wing.skin_height_m.tip",
            "is 1.2, but -0.54 to 0.79",
        ),
        (
            "tip_span_m = 33.0",
            "tip_span_m = 80.0",
            "wing.skin_height_m.tip_span_m",
            "is 80, but 22.15 to 47.47",
        ),
        (
            "flight_temperature_c = -55",
            "flight_temperature_c = 60",
            "thermal.flight_temperature_c",
            "is 60, but at most 35.00 by ground_temperature_c",
        ),
    ] {
        let directory = dev("installation.toml", from, to);
        let (status, printed) = run(&[
            "check",
            "--installation",
            directory.path().to_str().unwrap(),
        ]);
        assert_eq!(status, Some(0), "a warning: {printed}");
        let lines: Vec<&str> = printed
            .lines()
            .filter(|l| l.contains("of another wing"))
            .collect();
        assert_eq!(lines.len(), 1, "{printed}");
        assert!(
            lines[0].contains(key) && lines[0].contains(limit),
            "{printed}"
        );
    }
}

#[test]
fn a_span_direction_of_the_wrong_sign_is_named_by_every_command() {
    let text = std::fs::read_to_string(fixture("dev/installation/installation.toml")).unwrap();
    let line = text
        .lines()
        .find(|l| l.starts_with("span_direction"))
        .unwrap();
    let numbers = line.split(['[', ']']).nth(1).unwrap();
    let turned: Vec<String> = numbers
        .split(',')
        .map(|v| (-v.trim().parse::<f64>().unwrap()).to_string())
        .collect();
    let directory = dev(
        "installation.toml",
        line,
        &format!("span_direction = [{}]", turned.join(", ")),
    );
    let directory = directory.path().to_str().unwrap();
    let frame = fixture("dev/frames/ground.jpg");
    let frame = frame.to_str().unwrap();
    for arguments in [
        vec!["check", "--installation", directory],
        vec!["orient", "--installation", directory, frame],
        vec!["solve", "--installation", directory, frame],
        vec!["plan", "--installation", directory],
    ] {
        let (status, printed) = run(&arguments);
        assert_eq!(status, Some(78), "{arguments:?}: {printed}");
        assert!(
            printed.contains("wing.span_direction") && printed.contains("1 error "),
            "{printed}"
        );
    }
}

#[test]
fn points_that_can_hardly_be_right_are_named() {
    let typo = dev("survey.csv", "26.4142", "24.6142");
    let (status, printed) = run(&["check", "--installation", typo.path().to_str().unwrap()]);
    // A warning stops nothing; if the image confirms it, the point is excluded.
    assert_eq!(status, Some(0), "{printed}");
    assert!(
        printed.contains("warning: ") && printed.contains("marker \"M02\""),
        "{printed}"
    );
    let survey = std::fs::read_to_string(fixture("dev/installation/survey.csv")).unwrap();
    let first = survey.lines().find(|l| l.starts_with("M01,")).unwrap();
    let twice = dev(
        "survey.csv",
        first,
        &format!("{first}\n{}", first.replacen("M01", "M99", 1)),
    );
    let (status, printed) = run(&["check", "--installation", twice.path().to_str().unwrap()]);
    assert_eq!(status, Some(78), "{printed}");
    assert!(
        printed.contains("marker \"M99\"")
            && printed.contains("M01")
            && printed.contains("overlap"),
        "{printed}"
    );
}

#[test]
fn an_observation_outside_the_image_is_named() {
    let directory = dev("installation.toml", "name", "name");
    let orientation = "camera_from_survey = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]\n";
    std::fs::write(directory.path().join("orientation.toml"), orientation).unwrap();
    let file = directory.path().join("by-hand.csv");
    std::fs::write(
        &file,
        "id,u_px,v_px,sigma_px\nM01,100,200,1\nM02,-500,99999,1\n",
    )
    .unwrap();
    let (status, printed) = run(&[
        "solve",
        "--installation",
        directory.path().to_str().unwrap(),
        "--observations",
        file.to_str().unwrap(),
    ]);
    assert_eq!(status, Some(78), "{printed}");
    assert!(
        printed.contains("line 3") && printed.contains("M02") && printed.contains("4000 x 3000"),
        "{printed}"
    );
}

#[test]
fn a_flight_frame_among_ground_frames_is_named_and_unused_markers_are() {
    let directory = dev("installation.toml", "name", "name");
    let path = directory.path().to_str().unwrap();
    let ground = fixture("dev/frames/ground.jpg");
    let flight = fixture("dev/frames/flight-5.jpg");
    let (ground, flight) = (ground.to_str().unwrap(), flight.to_str().unwrap());
    for frames in [[ground, flight], [flight, ground]] {
        let (status, printed) = run(&["orient", "--installation", path, frames[0], frames[1]]);
        assert_eq!(status, Some(1), "{printed}");
        assert!(
            printed.contains("flight-5.jpg: only") && printed.contains("exclude this frame"),
            "{printed}"
        );
        assert!(!directory.path().join("orientation.toml").exists());
    }
    let (status, printed) = run(&["orient", "--json", "--installation", path, ground, ground]);
    assert_eq!(status, Some(0), "{printed}");
    let fit: serde_json::Value = serde_json::from_str(&printed).unwrap();
    let written = std::fs::read_to_string(directory.path().join("orientation.toml")).unwrap();
    let written: toml::Table = toml::from_str(&written).unwrap();
    let listed = written
        .get("unused")
        .map_or(0, |u| u.as_array().unwrap().len());
    let unused = fit["unused"].as_array().unwrap();
    assert_eq!(unused.len(), listed);
    // Two observations of each used marker.
    assert_eq!(
        fit["markers"].as_u64().unwrap(),
        2 * (21 - listed as u64),
        "{printed}"
    );
    assert!(
        unused
            .iter()
            .all(|u| u["reason"].as_str().unwrap().len() > 5),
        "{printed}"
    );
}

/// Nose up is positive on a left wing, defined by a torsion pair or by the user; otherwise no twist is given.
#[test]
fn the_twist_of_a_left_wing_has_one_sign_or_none() {
    let pair = "[[torsion]]";
    let text = std::fs::read_to_string(fixture("demo/installation/installation.toml")).unwrap();
    let torsion = &text[text.find(pair).unwrap()..];
    let without = text.replace(torsion, "");
    let stated = without.replace("span_direction", "side = \"left\"\nspan_direction");
    let right = text.replace("span_direction", "side = \"right\"\nspan_direction");
    let frames: Vec<PathBuf> = std::fs::read_dir(fixture("demo/frames"))
        .unwrap()
        .map(|f| f.unwrap().path())
        .collect();
    let find = |part: &str| {
        let mut found: Vec<_> = frames
            .iter()
            .filter(|f| f.to_str().unwrap().contains(part))
            .collect();
        found.sort();
        found[0].to_str().unwrap().to_owned()
    };
    let (ground, flight) = (find("ground"), find("flight"));
    let twist = |installation: &str| {
        let directory = changed(
            "demo/installation",
            "installation.toml",
            &text,
            installation,
        );
        let path = directory.path().to_str().unwrap();
        let (status, printed) = run(&["orient", "--installation", path, &ground]);
        assert_eq!(status, Some(0), "{printed}");
        let (status, printed) = run(&["solve", "--json", "--installation", path, &flight]);
        assert_eq!(status, Some(0), "{printed}");
        serde_json::from_str::<serde_json::Value>(printed.lines().next().unwrap()).unwrap()
    };
    let tip = |record: &serde_json::Value| {
        record["curve"].as_array().unwrap().last().unwrap()["twist_deg"].clone()
    };
    let (paired, stated, unknown) = (twist(&text), twist(&stated), twist(&without));
    let (a, b) = (
        tip(&paired).as_f64().unwrap(),
        tip(&stated).as_f64().unwrap(),
    );
    assert!((a - b).abs() < 0.01 * a.abs() && a.abs() > 0.1, "{a} {b}");
    assert!(tip(&unknown).is_null() && unknown["model"]["twist_deg"].is_null());
    assert!(
        unknown["remarks"].to_string().contains("wing.side"),
        "{}",
        unknown["remarks"]
    );
    assert_eq!(
        unknown["tip"], stated["tip"],
        "deflection does not hang on it"
    );
    let contrary = changed("demo/installation", "installation.toml", &text, &right);
    let (status, printed) = run(&["check", "--installation", contrary.path().to_str().unwrap()]);
    assert_eq!(status, Some(78), "{printed}");
    assert!(
        printed.contains("torsion[0]") && printed.contains("right wing"),
        "{printed}"
    );
}
