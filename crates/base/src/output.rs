//! Output of all commands: results to standard output, notes and progress to standard error, files.

use std::fmt::Display;
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::failure::{Failure, TaskResult};
use crate::pending_file::PendingFile;
use crate::text::printable_text;

/// Prints a line of results; a closed pipe (`| head`) is not an error.
///
/// # Errors
/// Returns an error if the line cannot be written, because a lost result must not look like success.
pub fn print_line(text: &str) -> TaskResult<()> {
    let mut output = std::io::stdout().lock();
    match writeln!(output, "{}", printable_text(text)).and_then(|()| output.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Failure::Failed(format!(
            "the results cannot be written to standard output ({error}); free space, or redirect them elsewhere"
        ))),
        _ => Ok(()),
    }
}

/// Prints a result as a line of JSON.
pub fn print_json(result: &impl Serialize) -> TaskResult<()> {
    let line = serde_json::to_string(result);
    print_line(&line.map_err(|error| {
        Failure::Failed(format!("the result cannot be written as JSON: {error}"))
    })?)
}

/// Prints notes to standard error, a line each.
pub fn print_notes<T: Display>(notes: impl IntoIterator<Item = T>) {
    for note in notes {
        eprintln!("wingd: {note}");
    }
}

/// Writes an output file: a reader sees the old content or the new, never a part. Devices and links are written in place.
///
/// # Errors
/// Returns an error with `remedy` if the file cannot be written.
pub fn write_output(file: &Path, content: impl AsRef<[u8]>, remedy: &str) -> TaskResult<()> {
    let write = || {
        let mut pending = PendingFile::create_output(file)?;
        pending.write_all(content.as_ref())?;
        pending.commit()
    };
    write().map_err(|error| Failure::from_write_error(file, &error, remedy))
}

/// Creates a progress bar on standard error, drawn from the start; invisible unless that is a terminal.
pub fn progress_bar(total: usize, what: &str) -> ProgressBar {
    let bar = ProgressBar::new(total as u64);
    let bar = styled_bar(
        bar,
        "{msg} [{bar:30}] {pos}/{len} {elapsed}, left {eta}",
        what,
    );
    bar.enable_steady_tick(TICK);
    bar
}

/// Creates a progress bar in bytes.
pub fn byte_progress(bytes: u64, what: &str) -> ProgressBar {
    styled_bar(
        ProgressBar::new(bytes),
        "{msg} [{bar:30}] {bytes}/{total_bytes} {eta}",
        what,
    )
}

/// Runs a task and meanwhile shows it with its elapsed time on standard error.
pub fn show_busy<T>(what: &str, task: impl FnOnce() -> T) -> T {
    let bar = styled_bar(ProgressBar::new_spinner(), "{msg} {elapsed}", what);
    bar.enable_steady_tick(TICK);
    let outcome = task();
    bar.finish_and_clear();
    outcome
}

/// Time between two updates of the elapsed time.
const TICK: Duration = Duration::from_secs(1);

fn styled_bar(bar: ProgressBar, template: &str, what: &str) -> ProgressBar {
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.with_style(style).with_message(what.to_owned())
}
