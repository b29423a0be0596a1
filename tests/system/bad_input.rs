//! The real binary with bad input: the documented exit status, and a message that names what to fix.

use std::path::{Path, PathBuf};
use std::process::Output;

use crate::program::run;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fixtures/dev")
        .join(name)
}

/// A copy of the installation with one file's text changed.
fn installation(file: &str, from: &str, to: &str) -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(fixture("installation")).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, directory.path().join(path.file_name().unwrap())).unwrap();
    }
    // Any rotation will do if nothing is identified.
    let orientation = "camera_from_survey = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]\n";
    std::fs::write(directory.path().join("orientation.toml"), orientation).unwrap();
    let path = directory.path().join(file);
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{file} does not contain \"{from}\"");
    std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
    directory
}

#[track_caller]
fn expect(output: &Output, status: i32, words: &[&str]) {
    let printed = format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    assert_eq!(output.status.code(), Some(status), "{printed}");
    assert!(!printed.contains("panicked"), "{printed}");
    for word in words {
        assert!(printed.contains(word), "\"{word}\" is not in: {printed}");
    }
}

#[test]
fn damaged_frames_fail_alone_and_state_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path.display().to_string()
    };
    let whole = std::fs::read(fixture("frames/ground.jpg")).unwrap();
    let cut = write("cut.jpg", &whole[..whole.len() / 2]);
    let empty = write("empty.jpg", b"");
    let text = write("text.jpg", b"this is no image");
    let mut small = vec![];
    jpeg_encoder::Encoder::new(&mut small, 90)
        .encode(
            &vec![128; 640 * 480],
            640,
            480,
            jpeg_encoder::ColorType::Luma,
        )
        .unwrap();
    let small = write("small.jpg", &small);
    let directory = installation("installation.toml", "name", "name");
    let directory = directory.path().to_str().unwrap();
    let images = [cut.as_str(), &empty, &text, &small, "/nowhere/missing.jpg"];
    for method in ["profile", "spatial"] {
        let mut arguments = vec![
            "solve",
            "--json",
            "--method",
            method,
            "--installation",
            directory,
        ];
        arguments.extend(images);
        let output = run(&arguments);
        let words = [
            "cut short",
            "empty",
            "cannot be read",
            "640 x 480",
            "4000 x 3000",
            "missing.jpg",
        ];
        expect(&output, 1, &words);
        let lines: Vec<serde_json::Value> = String::from_utf8_lossy(&output.stdout)
            .lines()
            .map(|line| serde_json::from_str(line).expect("a JSON object per line"))
            .collect();
        assert_eq!(lines.len(), images.len(), "each image gets its line");
        let names: Vec<&str> = lines.iter().filter_map(|l| l["image"].as_str()).collect();
        assert_eq!(
            names,
            [
                "cut.jpg",
                "empty.jpg",
                "text.jpg",
                "small.jpg",
                "missing.jpg"
            ],
            "in the order given"
        );
        for line in &lines {
            assert_eq!(line["status"], "failed");
            assert!(
                line["reason"].as_str().is_some_and(|r| r.len() > 20),
                "{line}"
            );
        }
    }
    expect(
        &run(&["detect", "--json", &cut, &empty]),
        1,
        &["cut short", "empty"],
    );
    expect(
        &run(&["orient", "--installation", directory, &small]),
        1,
        &["640 x 480"],
    );
}

#[test]
fn faults_of_an_installation_name_their_file_and_line() {
    let frame = fixture("frames/ground.jpg").display().to_string();
    let cases: [(&str, &str, &str, &[&str]); 9] = [
        (
            "survey.csv",
            "24.4459",
            "NaN",
            &["survey.csv", "line 2", "y_m", "NaN"],
        ),
        (
            "survey.csv",
            ",sigma_m",
            "",
            &["survey.csv", "sigma_m", "missing"],
        ),
        (
            "survey.csv",
            "M02,",
            "M01,",
            &["survey.csv", "line 3", "M01", "line 2"],
        ),
        (
            "survey.csv",
            "M11,circle",
            "M11,ring",
            &["survey.csv", "line 12", "ring", "quadrant, circle or point"],
        ),
        (
            "camera.toml",
            "width = 4000",
            "width = 0",
            &["camera.toml", "width"],
        ),
        (
            "camera.toml",
            "k1 = -0.05",
            "k1 = inf",
            &["camera.toml", "k1", "inf"],
        ),
        (
            "installation.toml",
            "\"M20\"",
            "\"M77\"",
            &["installation.toml", "torsion[0].leading", "M77"],
        ),
        (
            "installation.toml",
            "root_offset_m",
            "rot_offset_m",
            &["installation.toml", "rot_offset_m"],
        ),
        (
            "orientation.toml",
            "[1, 0, 0]",
            "[1, 1, 0]",
            &["orientation.toml", "not a rotation", "wingd orient"],
        ),
    ];
    for (file, from, to, words) in cases {
        let directory = installation(file, from, to);
        expect(
            &run(&[
                "solve",
                "--installation",
                directory.path().to_str().unwrap(),
                &frame,
            ]),
            78,
            words,
        );
    }
    expect(
        &run(&["solve", "--installation", "/nowhere", &frame]),
        78,
        &["/nowhere/installation.toml"],
    );
}

#[test]
fn faults_of_manual_observations_name_their_line() {
    let directory = installation("installation.toml", "name", "name");
    let path = directory.path().join("hand.csv");
    let solve = |text: &str| {
        std::fs::write(&path, text).unwrap();
        let (directory, file) = (directory.path().to_str().unwrap(), path.to_str().unwrap());
        run(&["solve", "--installation", directory, "--observations", file])
    };
    expect(
        &solve("id,u_px,v_px\nM01,1,2\n"),
        78,
        &["hand.csv", "sigma_px", "missing"],
    );
    expect(
        &solve("id,u_px,v_px,sigma_px\nM77,1,2,5\n"),
        78,
        &["line 2", "M77"],
    );
    expect(
        &solve("id,u_px,v_px,sigma_px\nM01,1,2,0\n"),
        78,
        &["line 2", "sigma_px"],
    );
    expect(
        &solve("id,u_px,v_px,sigma_px\nM01,1,2,5\nM01,1,2,5\n"),
        78,
        &["line 3", "M01"],
    );
}

#[test]
fn faults_of_a_configuration_name_their_key() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wingd.toml");
    let check = |text: &str| {
        std::fs::write(&path, text).unwrap();
        run(&["check", "--config", path.to_str().unwrap()])
    };
    let sound = "[camera]\nkind = \"replay\"\nfolder = \"f\"\n[store]\npath = \"s\"\n";
    expect(
        &check(&format!("{sound}[series]\nshoots = 10\n")),
        78,
        &["wingd.toml", "line 7", "shoots"],
    );
    expect(
        &check(&format!("{sound}[series]\nshots = 0\n")),
        78,
        &["series.shots"],
    );
    expect(&check("[store]\npath = \"s\"\n"), 78, &["camera"]);
    expect(
        &check(&sound.replace("replay", "polaroid")),
        78,
        &["polaroid"],
    );
    expect(
        &run(&["check", "--config", "/nowhere/wingd.toml"]),
        78,
        &["/nowhere/wingd.toml"],
    );
}

#[test]
fn wrong_usage_is_refused() {
    expect(&run(&["solve"]), 2, &["IMAGE|FOLDER|STORE"]);
    expect(&run(&["fly"]), 2, &["fly"]);
    expect(
        &run(&[
            "solve",
            "--joint",
            "--method",
            "profile",
            "--installation",
            "d",
            "a.jpg",
        ]),
        2,
        &["spatial"],
    );
    expect(&run(&["--help"]), 0, &["Exit status"]);
}
