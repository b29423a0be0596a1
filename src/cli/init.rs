//! `wingd init` writes the files of a new installation, to be filled in.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::{Done, Failure, print};

/// Write a commented configuration, installation and board to fill in.
#[derive(clap::Args)]
pub struct Args {
    /// Where they go; files that are there already stay as they are
    #[arg(value_name = "DIR", default_value = ".")]
    directory: PathBuf,
}

const CONFIGURATION: &str = include_str!("../../config/wingd.toml");
const BOARD: &str = include_str!("../../config/new/board.toml");
const INSTALLATION: &str = include_str!("../../config/new/installation.toml");
const SURVEY: &str = include_str!("../../config/new/survey.csv");

/// What comes next, in order.
const NEXT: &str = "Next (docs/tutorial.md):
  board.toml                      describe your board, take pictures of it, then
                                  wingd calibrate --board board.toml --output installation/camera.toml board/*.jpg
  installation/survey.csv         a line for each marker
  installation/installation.toml  camera and wing, then
                                  wingd check --installation installation
  wingd.toml                      camera and store, then
                                  wingd check --config wingd.toml";

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    // A configuration without an installation records and does not solve; here there is one.
    let configuration = CONFIGURATION
        .replace("# installation = \"/var/lib/wingd/installation\"", "installation = \"installation\"");
    let files = [
        ("wingd.toml", configuration.as_str()),
        ("board.toml", BOARD),
        ("installation/installation.toml", INSTALLATION),
        ("installation/survey.csv", SURVEY),
    ];
    for (name, text) in files {
        let path = args.directory.join(name);
        let said = match write(&path, text) {
            Ok(()) => "written",
            Err(error) if error.kind() == ErrorKind::AlreadyExists => "is there already, left as it is",
            Err(error) => {
                let what = format!("{}: {error}; name a directory that can be written", path.display());
                return Err(Failure::Undone(what));
            }
        };
        print(&format!("{}  {said}", path.display()))?;
    }
    print(&format!("\n{NEXT}"))?;
    Ok(Done::All)
}

/// Never over a file that is there.
fn write(path: &Path, text: &str) -> std::io::Result<()> {
    path.parent().map_or(Ok(()), std::fs::create_dir_all)?;
    OpenOptions::new().write(true).create_new(true).open(path)?.write_all(text.as_bytes())
}
