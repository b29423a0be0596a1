//! Promise: `wingd X` with an unknown `X` runs `wingd-X` from the PATH; `wingd help` lists those found.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

use wingd::cli::external::PACKAGE_COMMANDS;

use crate::program::all_output;

fn put_script(folder: &Path, name: &str, text: &str, mode: u32) {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
}

fn wingd(path: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_wingd"))
        .args(arguments)
        .env("PATH", path)
        .env_remove("WINGD")
        .output()
        .unwrap()
}

const PRINTS: &str = "#!/bin/sh\necho \"$WINGD\"\nprintf '<%s>' \"$@\"\nexit 7\n";

#[test]
fn an_unknown_command_runs_the_program_of_that_name_with_its_arguments() {
    let folder = tempfile::tempdir().unwrap();
    put_script(folder.path(), "wingd-flutter", PRINTS, 0o755);
    let flight = &["flutter", "--flight", "f0001", "a b", ""][..];
    for (arguments, passed) in [
        (flight, "<--flight><f0001><a b><>"),
        (&["help", "flutter"], "<--help>"),
    ] {
        let output = wingd(folder.path(), arguments);
        let text = String::from_utf8(output.stdout).unwrap();
        let own = env!("CARGO_BIN_EXE_wingd");
        assert_eq!(text, format!("{own}\n{passed}"), "{arguments:?}");
        assert_eq!(output.status.code(), Some(7), "{arguments:?}");
    }
}

#[test]
fn a_program_does_not_replace_a_command_of_wingd() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["wingd-verify", "wingd-help"] {
        put_script(folder.path(), name, PRINTS, 0o755);
    }
    let output = wingd(folder.path(), &["verify", "--help"]);
    assert!(all_output(&output).contains("every checksum"));
    let output = wingd(folder.path(), &["help"]);
    let text = all_output(&output);
    assert!(text.contains("Exit status"), "{text}");
    assert!(!text.contains("on the PATH"), "{text}");
}

#[test]
fn help_lists_the_programs_found_once() {
    let folder = tempfile::tempdir().unwrap();
    put_script(folder.path(), "wingd-flutter", PRINTS, 0o755);
    put_script(folder.path(), "wingd-notes", PRINTS, 0o644);
    put_script(folder.path(), "wingd-Old.bak", PRINTS, 0o755);
    let twice = std::env::join_paths([folder.path(), folder.path()]).unwrap();
    for arguments in [&["help"][..], &["--help"], &[]] {
        let output = wingd(Path::new(&twice), arguments);
        let text = all_output(&output);
        let listed = "Commands on the PATH (`wingd X` runs `wingd-X`): flutter\n";
        assert!(text.contains(listed), "{arguments:?}: {text}");
    }
    let output = wingd(Path::new(&twice), &["notes"]);
    assert_eq!(output.status.code(), Some(2), "{}", all_output(&output));
}

#[test]
fn without_the_package_the_message_says_how_to_install_it() {
    let empty = tempfile::tempdir().unwrap();
    let own = ["fleet", "loads", "table"];
    assert!(own.iter().all(|name| PACKAGE_COMMANDS.contains(name)));
    for name in own {
        let output = wingd(empty.path(), &[name, "store", "--json"]);
        let text = all_output(&output);
        assert_eq!(output.status.code(), Some(2), "{text}");
        let remedy = "`pip install ./python`, or install the package wingd-desk";
        assert!(text.contains(remedy) && text.lines().count() == 1, "{text}");
    }
    let output = wingd(empty.path(), &["sovle"]);
    assert!(all_output(&output).contains("'solve'"), "a typing error");
}

#[test]
fn a_program_whose_interpreter_is_gone_is_named() {
    let folder = tempfile::tempdir().unwrap();
    put_script(
        folder.path(),
        "wingd-fleet",
        "#!/nowhere/venv/bin/python\n",
        0o755,
    );
    let output = wingd(folder.path(), &["fleet"]);
    let text = all_output(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        text.contains("wingd-fleet: cannot be run") && text.contains("install it again"),
        "{text}"
    );
}
