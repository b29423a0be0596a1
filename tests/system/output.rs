//! Every result is kept, or its loss is said.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn picture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/jpeg").join(name)
}

fn wingd() -> Command {
    Command::new(env!("CARGO_BIN_EXE_wingd"))
}

fn said(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

#[test]
fn a_full_disk_is_said() {
    let installation = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev/installation");
    let frame = picture("baseline-2x1.jpg");
    let frame = frame.to_str().unwrap();
    let directory = installation.to_str().unwrap();
    let commands: [&[&str]; 3] =
        [&["detect", "--json", frame, frame], &["detect", frame], &["check", "--installation", directory]];
    for arguments in commands {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let output = wingd().args(arguments).stdout(full).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(said(&output).contains("cannot be written to standard output"), "{}", said(&output));
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
    assert_eq!((output.status.code(), said(&output).as_str()), (Some(0), ""));
}

#[test]
fn frames_of_several_folders_are_told_apart() {
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
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let name = |line: &str| serde_json::from_str::<serde_json::Value>(line).unwrap()["image"].clone();
    let names: Vec<serde_json::Value> = text.lines().map(name).collect();
    assert_eq!(names, ["a/1.jpg", "b/1.jpg", "2.jpg"]);
    assert_eq!(std::fs::read_dir(overlays).unwrap().count(), 3);
}

#[test]
fn an_address_may_be_a_name() {
    let run = |address: &str| {
        let output = wingd().args(["serve", "/nowhere/store", "--listen", address]).output().unwrap();
        (output.status.code(), said(&output))
    };
    let (status, text) = run("localhost:8080");
    assert_eq!(status, Some(1), "{text}");
    assert!(text.contains("/nowhere/store"), "{text}");
    let (status, text) = run("8080");
    assert_eq!(status, Some(2), "{text}");
    assert!(text.contains("localhost:8080"), "{text}");
}
