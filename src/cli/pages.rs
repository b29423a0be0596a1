//! `wingd completions` and `wingd man` generate their output from the command line's definition.

use std::io;
use std::path::{Path, PathBuf};

use clap::{Command, CommandFactory};

use super::{Arguments, help};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::print_line;

/// Print completions for a shell to standard output.
#[derive(clap::Args)]
pub struct CompletionsArgs {
    /// Shell
    shell: clap_complete::Shell,
}

/// Write the man pages, one for each command, into a directory.
#[derive(clap::Args)]
pub struct ManArgs {
    /// Directory for the pages
    directory: PathBuf,
}

pub(super) fn write_completions(args: &CompletionsArgs) -> TaskResult<Completion> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Arguments::command(), "wingd", &mut script);
    print_line(String::from_utf8_lossy(&script).trim_end())?;
    Ok(Completion::All)
}

pub(super) fn write_man_pages(args: &ManArgs) -> TaskResult<Completion> {
    let mut command = help::with_groups_and_examples(Arguments::command());
    command.build();
    let visible: Vec<&Command> = command
        .get_subcommands()
        .filter(|c| !c.is_hide_set() && c.get_name() != "help")
        .collect();
    write_man_page(&args.directory, "wingd", &command)
        .and_then(|()| {
            visible.iter().try_for_each(|c| {
                write_man_page(&args.directory, &format!("wingd-{}", c.get_name()), c)
            })
        })
        .map_err(|error| {
            let directory = args.directory.display();
            Failure::Failed(format!("{directory}: {error}; name a writable directory"))
        })?;
    Ok(Completion::All)
}

fn write_man_page(directory: &Path, name: &str, command: &Command) -> io::Result<()> {
    let page = clap_mangen::Man::new(command.clone()).title(name.to_uppercase());
    let mut text = Vec::new();
    page.render(&mut text)?;
    std::fs::create_dir_all(directory)?;
    std::fs::write(directory.join(format!("{name}.1")), text)
}
