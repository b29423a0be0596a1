//! Promise: an upgrade of the package does not end a recording, and an aborted removal starts the recorder again.

use std::collections::BTreeMap;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

/// Runs a maintainer script with commands that only log.
fn run_script(script: &str, arguments: &[&str], root: &Path, check_status: i32) -> String {
    let (commands, log) = (root.join("bin"), root.join("log"));
    std::fs::create_dir_all(&commands).unwrap();
    std::fs::create_dir_all(root.join("run/systemd/system")).unwrap();
    let _ = std::fs::remove_file(&log);
    let fakes = BTreeMap::from([
        ("adduser", 0),
        ("addgroup", 0),
        ("getent", 0),
        ("systemctl", 0),
        ("wingd", check_status),
    ]);
    for (name, status) in fakes {
        let file = commands.join(name);
        let text = format!(
            "#!/bin/sh\necho {name} \"$@\" >>{}\nexit {status}\n",
            log.display()
        );
        std::fs::write(&file, text).unwrap();
        std::fs::set_permissions(&file, PermissionsExt::from_mode(0o755)).unwrap();
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("packaging/debian")
        .join(script);
    let path = format!("{}:/usr/bin:/bin", commands.display());
    let mut command = Command::new("/bin/sh");
    let command = command.arg(script).args(arguments).env("PATH", path);
    let output = command.env("DPKG_ROOT", root).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    std::fs::read_to_string(log).unwrap_or_default()
}

#[test]
fn an_upgrade_restarts_the_recorder_only_if_the_new_version_would_start() {
    let dir = tempfile::tempdir().unwrap();
    let upgrade = |status| run_script("postinst", &["configure", "0.0.9"], dir.path(), status);
    let sound = upgrade(0);
    assert!(sound.contains("wingd check --config") && sound.contains("systemctl restart"));
    let refused = upgrade(78);
    assert!(
        refused.contains("wingd check") && !refused.contains("restart"),
        "{refused}"
    );
}

#[test]
fn an_aborted_removal_starts_the_recorder_again() {
    let dir = tempfile::tempdir().unwrap();
    let stopped = run_script("prerm", &["remove"], dir.path(), 0);
    assert!(stopped.contains("systemctl stop"), "{stopped}");
    let again = run_script("postinst", &["abort-remove"], dir.path(), 0);
    assert!(again.contains("systemctl start wingd.service"), "{again}");
    // A recorder that was not running stays so.
    let other = run_script("postinst", &["abort-remove"], dir.path(), 0);
    assert!(!other.contains("systemctl start"), "{other}");
}
