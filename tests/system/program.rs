//! The real binary and its fixtures.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

pub fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fixtures")
        .join(name)
}

pub fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args(arguments)
        .output()
        .unwrap()
}

/// Exit status, and both outputs.
pub fn outcome(arguments: &[&str]) -> (Option<i32>, String) {
    let output = run(arguments);
    let printed = [output.stdout, output.stderr].concat();
    (
        output.status.code(),
        String::from_utf8_lossy(&printed).into_owned(),
    )
}

/// Standard output of a successful run.
pub fn stdout(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(
        output.status.success(),
        "{arguments:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

/// Runs in a folder, without a terminal.
pub fn run_in(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wingd"));
    command
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

/// Both outputs.
pub fn all_output(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

/// Standard output of a successful run in a folder.
pub fn run_in_folder(folder: &Path, arguments: &[&str]) -> String {
    let output = run_in(folder, arguments);
    assert!(
        output.status.success(),
        "{arguments:?}: {}",
        all_output(&output)
    );
    String::from_utf8(output.stdout).unwrap()
}
