//! Every result is written, or its loss is reported.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn picture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fixtures/jpeg")
        .join(name)
}

fn wingd() -> Command {
    Command::new(env!("CARGO_BIN_EXE_wingd"))
}

fn stderr(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

#[test]
fn a_full_disk_is_reported() {
    let installation = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev/installation");
    let frame = picture("baseline-2x1.jpg");
    let frame = frame.to_str().unwrap();
    let directory = installation.to_str().unwrap();
    let folder = tempfile::tempdir().unwrap();
    for name in ["installation.toml", "camera.toml", "survey.csv"] {
        std::fs::copy(installation.join(name), folder.path().join(name)).unwrap();
    }
    let any = "camera_from_survey = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]\n";
    std::fs::write(folder.path().join("orientation.toml"), any).unwrap();
    let oriented = folder.path().display().to_string();
    let commands: [&[&str]; 6] = [
        &["detect", "--json", frame, frame],
        &["detect", frame],
        &["check", "--installation", directory],
        &["plan", "--installation", directory],
        &["plan", "--json", "--installation", directory],
        &["solve", "--json", "--installation", &oriented, frame],
    ];
    for arguments in commands {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let output = wingd().args(arguments).stdout(full).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(
            stderr(&output).contains("cannot be written to standard output"),
            "{}",
            stderr(&output)
        );
    }
}

#[test]
fn a_closed_pipe_is_silent() {
    let mut child = wingd()
        .args(["detect", "--json"])
        .arg(picture("baseline-2x1.jpg"))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(
        (output.status.code(), stderr(&output).as_str()),
        (Some(0), "")
    );
}

/// Results finished before Ctrl-C are written, in order, and no more are begun.
#[test]
fn results_are_written_as_they_are_done_and_an_interruption_keeps_them() {
    let folder = tempfile::tempdir().unwrap();
    let frame = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev/frames/flight-1.jpg");
    let files: Vec<PathBuf> = (0..60)
        .map(|k| folder.path().join(format!("{k:02}.jpg")))
        .collect();
    files
        .iter()
        .for_each(|file| std::os::unix::fs::symlink(&frame, file).unwrap());
    let mut child = wingd()
        .args(["detect", "--json", "--jobs", "1"])
        .args(&files)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let name =
        |line: String| serde_json::from_str::<serde_json::Value>(&line).unwrap()["image"].clone();
    assert_eq!(
        name(lines.next().unwrap().unwrap()),
        "00.jpg",
        "the first, while the others are to come"
    );
    rustix::process::kill_process(
        rustix::process::Pid::from_child(&child),
        rustix::process::Signal::INT,
    )
    .unwrap();
    let rest: Vec<serde_json::Value> = lines.map(|l| name(l.unwrap())).collect();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let done = format!("stopped: {} of 60 images were processed", rest.len() + 1);
    assert!(
        stderr(&output).contains(&done),
        "{done}: {}",
        stderr(&output)
    );
    assert!(rest.len() < 59, "all were done");
    assert!(
        rest.iter()
            .enumerate()
            .all(|(k, n)| *n == format!("{:02}.jpg", k + 1)),
        "{rest:?}"
    );
}

#[test]
fn rejected_candidates_are_listed_on_request() {
    let frame = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/pictures/packed.png");
    let answer = |options: &[&str]| {
        let output = wingd()
            .arg("detect")
            .args(options)
            .arg(&frame)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()
    };
    assert!(answer(&["--json"]).get("rejected").is_none());
    let all = answer(&["--json", "--rejected"]);
    let rejected = all["rejected"].as_array().unwrap();
    assert!(!rejected.is_empty());
    assert!(
        rejected
            .iter()
            .all(|r| r["u_px"].is_f64() && r["reason"].is_string()),
        "{rejected:?}"
    );
}

#[test]
fn frames_of_several_folders_are_distinguished() {
    let folder = tempfile::tempdir().unwrap();
    let files = ["a/1.jpg", "b/1.jpg", "b/2.jpg"].map(|name| folder.path().join(name));
    for file in &files {
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::copy(picture("baseline-2x1.jpg"), file).unwrap();
    }
    let overlays = folder.path().join("overlays");
    let output = wingd()
        .args(["detect", "--json", "--jobs", "1000000", "--overlay"])
        .arg(&overlays)
        .args(&files)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let name =
        |line: &str| serde_json::from_str::<serde_json::Value>(line).unwrap()["image"].clone();
    let names: Vec<serde_json::Value> = text.lines().map(name).collect();
    assert_eq!(names, ["a/1.jpg", "b/1.jpg", "2.jpg"]);
    assert_eq!(std::fs::read_dir(overlays).unwrap().count(), 3);
}

#[test]
fn an_address_may_be_a_name() {
    let run = |address: &str| {
        let output = wingd()
            .args(["serve", "/nowhere/store", "--listen", address])
            .output()
            .unwrap();
        (output.status.code(), stderr(&output))
    };
    let (status, text) = run("localhost:8080");
    assert_eq!(status, Some(1), "{text}");
    assert!(text.contains("/nowhere/store"), "{text}");
    let (status, text) = run("8080");
    assert_eq!(status, Some(2), "{text}");
    assert!(text.contains("localhost:8080"), "{text}");
}

/// Results of a test of the camera alone are results too.
#[test]
fn shots_of_a_check_report_the_cause() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("frames")).unwrap();
    std::fs::copy(
        picture("baseline-2x1.jpg"),
        folder.path().join("frames/1.jpg"),
    )
    .unwrap();
    let config = folder.path().join("wingd.toml");
    let run = |text: &str, output: Stdio| {
        std::fs::write(&config, text).unwrap();
        let mut command = wingd();
        command
            .args(["check", "--camera", "1", "--config"])
            .arg(&config)
            .arg("--output")
            .arg(folder.path());
        command.stdout(output).output().unwrap()
    };
    let sound = "[camera]\nkind = \"replay\"\nfolder = \"frames\"\n";
    let output = run(sound, Stdio::piped());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(
        stderr(&output).contains("\"error\":null"),
        "{}",
        stderr(&output)
    );
    let full = File::options().write(true).open("/dev/full").unwrap();
    let output = run(sound, full.into());
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(
        stderr(&output).contains("cannot be written"),
        "{}",
        stderr(&output)
    );
    let output = run(&sound.replace("folder", "folders"), Stdio::piped());
    assert_eq!(output.status.code(), Some(78), "{}", stderr(&output));
    assert!(
        stderr(&output).contains("wingd.toml: line") && stderr(&output).contains("folders"),
        "{}",
        stderr(&output)
    );
}
