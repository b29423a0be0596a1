//! `wingd completions` and the man pages of the package come from the command line's own description.

use std::io;
use std::path::{Path, PathBuf};

use clap::{Command, CommandFactory};

use super::{Arguments, Done, Failure, help, print};

/// Completions for a shell, to standard output.
#[derive(clap::Args)]
pub struct CompletionsArgs {
    /// The shell
    shell: clap_complete::Shell,
}

/// Man pages, one for each command, into a directory.
#[derive(clap::Args)]
pub struct ManArgs {
    /// Where they go
    directory: PathBuf,
}

pub(super) fn completions(args: &CompletionsArgs) -> Result<Done, Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Arguments::command(), "wingd", &mut script);
    print(String::from_utf8_lossy(&script).trim_end())?;
    Ok(Done::All)
}

pub(super) fn man(args: &ManArgs) -> Result<Done, Failure> {
    let mut command = help::dress(Arguments::command());
    command.build();
    let visible: Vec<&Command> =
        command.get_subcommands().filter(|c| !c.is_hide_set() && c.get_name() != "help").collect();
    write(&args.directory, "wingd", &command)
        .and_then(|()| {
            visible.iter().try_for_each(|c| write(&args.directory, &format!("wingd-{}", c.get_name()), c))
        })
        .map_err(|error| {
            let directory = args.directory.display();
            Failure::Failed(format!("{directory}: {error}; name a directory that can be written"))
        })?;
    Ok(Done::All)
}

fn write(directory: &Path, name: &str, command: &Command) -> io::Result<()> {
    let page = clap_mangen::Man::new(command.clone()).title(name.to_uppercase());
    let mut text = Vec::new();
    page.render(&mut text)?;
    std::fs::create_dir_all(directory)?;
    std::fs::write(directory.join(format!("{name}.1")), text)
}
