//! `wingd init` writes the files of a new installation, to fill in.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::print_line;

/// Write a commented configuration, installation and board to fill in; `wingd check` lists the blank values.
#[derive(clap::Args)]
pub struct InitArgs {
    /// Directory for the files; existing files are not changed
    #[arg(value_name = "DIR", default_value = ".")]
    directory: PathBuf,
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

/// Writes the files of a new installation.
pub(super) fn run(args: &InitArgs) -> TaskResult<Completion> {
    // Without this line the recorder records but does not solve.
    let configuration = CONFIGURATION_TEMPLATE.replace(
        "# installation = \"/var/lib/wingd/installation\"",
        "installation = \"installation\"",
    );
    let files = [
        ("wingd.toml", configuration.as_str()),
        ("board.toml", BOARD_TEMPLATE),
        ("installation.svg", INSTALLATION_DRAWING),
        ("installation/installation.toml", INSTALLATION_TEMPLATE),
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
