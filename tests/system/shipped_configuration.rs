//! Every shipped configuration is accepted by `wingd check`.

use std::path::Path;
use std::process::Command;

#[test]
fn every_shipped_configuration_is_accepted() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("frames")).unwrap();
    let frame = root.join("fixtures/dev/frames/ground.jpg");
    std::fs::copy(frame, folder.path().join("frames/1.jpg")).unwrap();
    let mut seen = 0;
    for entry in std::fs::read_dir(root.join("config")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "toml") {
            continue;
        }
        seen += 1;
        let copy = folder.path().join(path.file_name().unwrap());
        std::fs::copy(&path, &copy).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_wingd"));
        command.args(["check", "--config"]).arg(&copy);
        // Only the default names a camera that exists everywhere.
        if path.file_name().unwrap() != "wingd.toml" {
            command.arg("--no-camera");
        }
        let output = command.output().unwrap();
        let printed = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{}: {printed}", path.display());
    }
    assert!(seen > 0, "no configuration is shipped");
}

#[test]
fn the_comments_of_the_default_are_the_defaults() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("config/wingd.toml")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("wingd.toml");
    std::fs::write(&file, &text).unwrap();
    let plain = wingd::config::load_configuration(&file).unwrap();
    // Options that are unset by default are shown by an example, not by a default.
    let examples = [
        "installation =",
        "until =",
        "curvature_terms =",
        "signing_key =",
        "file =",
        "line =",
    ];
    let shown: Vec<String> = text
        .lines()
        .map(|line| match line.strip_prefix("# ") {
            Some(rest) if rest.contains(" = ") && !examples.iter().any(|e| rest.starts_with(e)) => {
                rest.to_owned()
            }
            _ => line.to_owned(),
        })
        .collect();
    assert!(
        shown.iter().any(|l| l.starts_with("interval")),
        "the defaults are shown"
    );
    std::fs::write(&file, shown.join("\n")).unwrap();
    assert_eq!(wingd::config::load_configuration(&file).unwrap(), plain);
}
