//! `wingd init` writes the files of a new installation, with what is known filled in.

mod answers;

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::{Done, Failure, print};
use answers::Answers;

/// Write a commented configuration, installation and board: what is not known yet is asked for, or left blank.
#[derive(clap::Args)]
pub struct Args {
    /// Where they go; files that are there already stay as they are
    #[arg(value_name = "DIR", default_value = ".")]
    directory: PathBuf,
    #[command(flatten)]
    answers: Answers,
}

const CONFIGURATION: &str = include_str!("../../config/wingd.toml");
const BOARD: &str = include_str!("../../config/new/board.toml");
const INSTALLATION: &str = include_str!("../../config/new/installation.toml");
const SURVEY: &str = include_str!("../../config/new/survey.csv");
const DRAWING: &str = include_str!("../../docs/images/installation.svg");

/// What comes next, in order.
const NEXT: &str = "Next (docs/tutorial.md; installation.svg shows what is measured where):
  board.toml                      describe your board, take pictures of it, then
                                  wingd calibrate --board board.toml --output installation/camera.toml board/*.jpg
  installation/survey.csv         a line for each marker
  installation/installation.toml  what is left blank there, then
                                  wingd check";

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let answers = args.answers.clone().asked();
    // A configuration without an installation records and does not solve; here there is one.
    let configuration = CONFIGURATION
        .replace("# installation = \"/var/lib/wingd/installation\"", "installation = \"installation\"");
    let installation = answers.filled(INSTALLATION);
    let files = [
        ("wingd.toml", configuration.as_str()),
        ("board.toml", BOARD),
        ("installation.svg", DRAWING),
        ("installation/installation.toml", installation.as_str()),
        ("installation/survey.csv", SURVEY),
    ];
    for (name, text) in files {
        let path = args.directory.join(name);
        let said = match write(&path, text) {
            Ok(()) => "written",
            Err(error) if error.kind() == ErrorKind::AlreadyExists => "is there already, left as it is",
            Err(error) => {
                let what = format!("{}: {error}; name a directory that can be written", path.display());
                return Err(Failure::Failed(what));
            }
        };
        print(&format!("{}  {said}", path.display()))?;
    }
    for camera in cameras(Path::new("/dev/v4l/by-id")) {
        print(&format!(
            "found a camera: {}; in wingd.toml: kind = \"v4l\", device = {:?} (docs/reference/wingd-toml-camera.md)",
            camera.display(),
            camera
        ))?;
    }
    print(&format!("\n{NEXT}"))?;
    Ok(Done::All)
}

/// Never over a file that is there.
fn write(path: &Path, text: &str) -> std::io::Result<()> {
    path.parent().map_or(Ok(()), std::fs::create_dir_all)?;
    OpenOptions::new().write(true).create_new(true).open(path)?.write_all(text.as_bytes())
}

/// Cameras that the kernel shows by a name that stays from plug to plug: the pictures, not their metadata.
fn cameras(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut found: Vec<PathBuf> =
        entries.filter(|path| path.to_string_lossy().ends_with("-video-index0")).collect();
    found.sort();
    found
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn cameras_are_found_by_their_lasting_names() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["usb-Maker_Model_123-video-index0", "usb-Maker_Model_123-video-index1", "other"] {
            std::fs::write(dir.path().join(name), "").unwrap();
        }
        assert_eq!(cameras(dir.path()), [dir.path().join("usb-Maker_Model_123-video-index0")]);
        assert!(cameras(Path::new("/nonexistent")).is_empty());
    }
}
