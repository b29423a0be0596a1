//! `wingd check` and `wingd run` agree about the place of the store.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

/// A configuration whose store is at `store`, beside one picture to replay.
fn configuration(folder: &Path, store: &str) -> std::path::PathBuf {
    let frames = folder.join("frames");
    std::fs::create_dir_all(&frames).unwrap();
    let frame = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev/frames/ground.jpg");
    std::fs::copy(frame, frames.join("one.jpg")).unwrap();
    let text = format!("[store]\npath = {store:?}\n[camera]\nkind = \"replay\"\nfolder = \"frames\"\n");
    let file = folder.join("wingd.toml");
    std::fs::write(&file, text).unwrap();
    file
}

fn check(mut command: Command, file: &Path) -> (Output, String) {
    let output = command.args(["check", "--config"]).arg(file).output().unwrap();
    let said =
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    (output, said)
}

fn wingd() -> Command {
    Command::new(env!("CARGO_BIN_EXE_wingd"))
}

#[test]
fn an_empty_folder_or_disk_is_a_place_for_a_store() {
    for content in [None, Some("lost+found")] {
        let directory = tempfile::tempdir().unwrap();
        let store = directory.path().join("store");
        std::fs::create_dir(&store).unwrap();
        content.iter().for_each(|name| std::fs::create_dir(store.join(name)).unwrap());
        let (output, said) = check(wingd(), &configuration(directory.path(), "store"));
        assert_eq!(output.status.code(), Some(0), "{said}");
        assert!(said.contains("will be made"), "{said}");
    }
}

#[test]
fn a_folder_of_other_things_is_none() {
    let directory = tempfile::tempdir().unwrap();
    std::fs::create_dir(directory.path().join("store")).unwrap();
    std::fs::write(directory.path().join("store/letter.txt"), "dear").unwrap();
    let (output, said) = check(wingd(), &configuration(directory.path(), "store"));
    assert_eq!(output.status.code(), Some(78), "{said}");
}

#[test]
fn the_home_sign_is_a_fault_before_anything_is_made() {
    let directory = tempfile::tempdir().unwrap();
    let file = configuration(directory.path(), "~/wingstore");
    for command in ["check", "run"] {
        let output = wingd().args([command, "--config"]).arg(&file).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(78), "{said}");
        assert!(said.contains("store.path") && said.contains("whole path"), "{said}");
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
    let (output, said) = check(another_user(directory.path()), &file);
    assert_eq!(output.status.code(), Some(78), "{said}");
    assert!(said.contains("store.path") && said.contains("cannot be written"), "{said}");
}

/// Root may write everywhere: another user looks then, with a copy of the program that it may read.
fn another_user(folder: &Path) -> Command {
    let program = folder.join("wingd");
    std::fs::copy(env!("CARGO_BIN_EXE_wingd"), &program).unwrap();
    if !rustix::process::geteuid().is_root() {
        return Command::new(&program);
    }
    let mut other = Command::new("setpriv");
    other.args(["--reuid=65534", "--regid=65534", "--clear-groups"]).arg(&program);
    other
}

/// As after a first run by hand as root: the folder is the recorder's, what lies in it is not.
#[test]
fn a_store_of_which_only_a_part_can_be_written_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let set = |name: &str, mode: u32| {
        let path = directory.path().join(name);
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
    };
    set(".", 0o755);
    let file = configuration(directory.path(), "store");
    let text = std::fs::read_to_string(&file).unwrap();
    let ends = "[series]\ninterval = \"4s\"\nshots = 1\nuntil = \"1s\"\n[status]\nsocket = \"s.sock\"\n";
    std::fs::write(&file, text + ends).unwrap();
    let run = wingd().args(["run", "--config"]).arg(&file).output().unwrap();
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    set("store", 0o777);
    set("store/incoming", 0o555);
    let (output, said) = check(another_user(directory.path()), &file);
    assert_eq!(output.status.code(), Some(78), "{said}");
    assert!(said.contains("store.path: ") && said.contains("cannot be written"), "{said}");
    let parts = ["incoming", "counter.json", "flights"];
    assert!(parts.iter().any(|part| said.contains(&format!("store/{part} cannot"))), "{said}");
    set("store/incoming", 0o755);
}

#[test]
fn faults_are_one_json_object_where_asked_for() {
    let directory = tempfile::tempdir().unwrap();
    let file = configuration(directory.path(), "~/store");
    let output = wingd().args(["check", "--json", "--config"]).arg(&file).output().unwrap();
    assert_eq!(output.status.code(), Some(78));
    assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let fault = &said["faults"][0];
    assert_eq!((&said["ok"], fault["file"].as_str()), (&false.into(), file.to_str()), "{said}");
    assert!(["place", "problem", "mend"].iter().all(|key| fault[key].as_str().is_some()), "{said}");
}
