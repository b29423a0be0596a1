//! `wingd init` writes the files of a new installation, with the known values filled in.

mod answers;

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use answers::InitAnswers;
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::print_line;

/// Write a commented configuration, installation and board; unknown values are asked for, or left blank.
#[derive(clap::Args)]
pub struct InitArgs {
    /// Directory for the files; existing files are not changed
    #[arg(value_name = "DIR", default_value = ".")]
    directory: PathBuf,
    #[command(flatten)]
    answers: InitAnswers,
}

const CONFIGURATION_TEMPLATE: &str = include_str!("../../config/wingd.toml");
const BOARD_TEMPLATE: &str = include_str!("../../config/new/board.toml");
const INSTALLATION_TEMPLATE: &str = include_str!("../../config/new/installation.toml");
const SURVEY_TEMPLATE: &str = include_str!("../../config/new/survey.csv");
const INSTALLATION_DRAWING: &str = include_str!("../../docs/images/installation.svg");

/// Next steps, in order.
const NEXT_STEPS: &str = "Next (docs/tutorial.md; installation.svg shows the quantities to measure):
  board.toml                      describe your board, take images of it, then
                                  wingd calibrate --board board.toml --output installation/camera.toml board/*.jpg
  installation/survey.csv         a line for each marker
  installation/installation.toml  fill in the blank values, then
                                  wingd check";

/// Writes the files of a new installation from answers or arguments.
pub(super) fn run(args: &InitArgs) -> TaskResult<Completion> {
    let answers = args.answers.clone().ask_missing();
    // Without this line the recorder records but does not solve.
    let configuration = CONFIGURATION_TEMPLATE.replace(
        "# installation = \"/var/lib/wingd/installation\"",
        "installation = \"installation\"",
    );
    let installation = answers.fill_template(INSTALLATION_TEMPLATE);
    let files = [
        ("wingd.toml", configuration.as_str()),
        ("board.toml", BOARD_TEMPLATE),
        ("installation.svg", INSTALLATION_DRAWING),
        ("installation/installation.toml", installation.as_str()),
        ("installation/survey.csv", SURVEY_TEMPLATE),
    ];
    for (name, text) in files {
        let path = args.directory.join(name);
        let state = match write_new_file(&path, text) {
            Ok(()) => "written",
            Err(error) if error.kind() == ErrorKind::AlreadyExists => "exists, not changed",
            Err(error) => {
                let what = format!("{}: {error}; name a writable directory", path.display());
                return Err(Failure::Failed(what));
            }
        };
        print_line(&format!("{}  {state}", path.display()))?;
    }
    for camera in find_cameras(Path::new("/dev/v4l/by-id")) {
        print_line(&format!(
            "found a camera: {}; in wingd.toml set kind = \"v4l\", device = {:?} (docs/reference/wingd-toml-camera.md)",
            camera.display(),
            camera
        ))?;
    }
    print_line(&format!("\n{NEXT_STEPS}"))?;
    Ok(Completion::All)
}

/// Writes a file, unless it exists.
fn write_new_file(path: &Path, text: &str) -> std::io::Result<()> {
    path.parent().map_or(Ok(()), std::fs::create_dir_all)?;
    OpenOptions::new()
        .write(true)
        .create_new(true)
        .open(path)?
        .write_all(text.as_bytes())
}

/// Finds cameras by their persistent device names; metadata devices are excluded.
fn find_cameras(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path());
    let mut found: Vec<PathBuf> = entries
        .filter(|path| path.to_string_lossy().ends_with("-video-index0"))
        .collect();
    found.sort();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_found_by_their_persistent_names() {
        let dir = tempfile::tempdir().unwrap();
        for name in [
            "usb-Maker_Model_123-video-index0",
            "usb-Maker_Model_123-video-index1",
            "other",
        ] {
            std::fs::write(dir.path().join(name), "").unwrap();
        }
        assert_eq!(
            find_cameras(dir.path()),
            [dir.path().join("usb-Maker_Model_123-video-index0")]
        );
        assert!(find_cameras(Path::new("/nonexistent")).is_empty());
    }
}
