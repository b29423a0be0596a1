//! `wingd check` and `wingd run` agree about the folder of the store.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

/// A configuration with its store at `store`, next to one image to replay.
fn configuration(folder: &Path, store: &str) -> std::path::PathBuf {
    let frames = folder.join("frames");
    std::fs::create_dir_all(&frames).unwrap();
    let frame = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev/frames/ground.jpg");
    std::fs::copy(frame, frames.join("one.jpg")).unwrap();
    let text =
        format!("[store]\npath = {store:?}\n[camera]\nkind = \"replay\"\nfolder = \"frames\"\n");
    let file = folder.join("wingd.toml");
    std::fs::write(&file, text).unwrap();
    file
}

fn check(mut command: Command, file: &Path) -> (Output, String) {
    let output = command
        .args(["check", "--config"])
        .arg(file)
        .output()
        .unwrap();
    let printed = format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    (output, printed)
}

fn wingd() -> Command {
    Command::new(env!("CARGO_BIN_EXE_wingd"))
}

#[test]
fn an_empty_folder_or_disk_is_accepted_for_a_store() {
    for content in [None, Some("lost+found")] {
        let directory = tempfile::tempdir().unwrap();
        let store = directory.path().join("store");
        std::fs::create_dir(&store).unwrap();
        content
            .iter()
            .for_each(|name| std::fs::create_dir(store.join(name)).unwrap());
        let (output, printed) = check(wingd(), &configuration(directory.path(), "store"));
        assert_eq!(output.status.code(), Some(0), "{printed}");
        assert!(printed.contains("will be created"), "{printed}");
    }
}

#[test]
fn a_folder_with_other_files_is_refused_for_a_store() {
    let directory = tempfile::tempdir().unwrap();
    std::fs::create_dir(directory.path().join("store")).unwrap();
    std::fs::write(directory.path().join("store/letter.txt"), "dear").unwrap();
    let (output, printed) = check(wingd(), &configuration(directory.path(), "store"));
    assert_eq!(output.status.code(), Some(78), "{printed}");
}

#[test]
fn a_tilde_in_a_path_is_a_fault_before_anything_is_created() {
    let directory = tempfile::tempdir().unwrap();
    let file = configuration(directory.path(), "~/wingstore");
    for command in ["check", "run"] {
        let output = wingd()
            .args([command, "--config"])
            .arg(&file)
            .output()
            .unwrap();
        let printed = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(78), "{printed}");
        assert!(
            printed.contains("store.path") && printed.contains("full path"),
            "{printed}"
        );
    }
    assert!(!directory.path().join("~").exists());
}

#[test]
fn a_store_that_cannot_be_written_is_named() {
    let directory = tempfile::tempdir().unwrap();
    std::fs::set_permissions(directory.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
    let file = configuration(directory.path(), "store");
    let store = directory.path().join("store");
    std::fs::create_dir(&store).unwrap();
    std::fs::set_permissions(&store, std::fs::Permissions::from_mode(0o555)).unwrap();
    let (output, printed) = check(another_user(directory.path()), &file);
    assert_eq!(output.status.code(), Some(78), "{printed}");
    assert!(
        printed.contains("store.path") && printed.contains("cannot be written"),
        "{printed}"
    );
}

/// Root may write everywhere, so another user checks, with a copy of the program that it may read.
fn another_user(folder: &Path) -> Command {
    let program = folder.join("wingd");
    std::fs::copy(env!("CARGO_BIN_EXE_wingd"), &program).unwrap();
    if !rustix::process::geteuid().is_root() {
        return Command::new(&program);
    }
    let mut other = Command::new("setpriv");
    other
        .args(["--reuid=65534", "--regid=65534", "--clear-groups"])
        .arg(&program);
    other
}

/// As after a first manual run as root: the recorder owns the folder, but not its contents.
#[test]
fn a_partly_writable_store_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let set = |name: &str, mode: u32| {
        let path = directory.path().join(name);
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
    };
    set(".", 0o755);
    let file = configuration(directory.path(), "store");
    let text = std::fs::read_to_string(&file).unwrap();
    let ends =
        "[series]\ninterval = \"4s\"\nshots = 1\nuntil = \"1s\"\n[status]\nsocket = \"s.sock\"\n";
    std::fs::write(&file, text + ends).unwrap();
    let run = wingd()
        .args(["run", "--config"])
        .arg(&file)
        .output()
        .unwrap();
    assert_eq!(
        run.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    set("store", 0o777);
    set("store/incoming", 0o555);
    let (output, printed) = check(another_user(directory.path()), &file);
    assert_eq!(output.status.code(), Some(78), "{printed}");
    assert!(
        printed.contains("store.path: ") && printed.contains("cannot be written"),
        "{printed}"
    );
    let parts = ["incoming", "counter.json", "flights"];
    assert!(
        parts
            .iter()
            .any(|part| printed.contains(&format!("store/{part} cannot"))),
        "{printed}"
    );
    set("store/incoming", 0o755);
}

#[test]
fn faults_are_one_json_object_on_request() {
    let directory = tempfile::tempdir().unwrap();
    let file = configuration(directory.path(), "~/store");
    let output = wingd()
        .args(["check", "--json", "--config"])
        .arg(&file)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(78));
    assert!(
        output.stderr.is_empty(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let printed: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let fault = &printed["faults"][0];
    assert_eq!(
        (&printed["ok"], fault["file"].as_str()),
        (&false.into(), file.to_str()),
        "{printed}"
    );
    assert!(
        ["place", "problem", "remedy"]
            .iter()
            .all(|key| fault[key].as_str().is_some()),
        "{printed}"
    );
}
