//! Failures and completions of commands, by their exit status.

use std::fmt::Display;
use std::path::Path;

use crate::fault::Fault;

/// Result of a task.
pub type TaskResult<T> = Result<T, Failure>;

/// Failure of a task, by what its user has to change.
#[derive(Debug)]
pub enum Failure {
    /// Operation that could not be completed; the text names the cause and the remedy. Exit status 1.
    Failed(String),
    /// Wrong usage that the parser does not detect. Exit status 2.
    Usage(String),
    /// Errors in configuration or installation. Exit status 78.
    Faults(Vec<Fault>),
}

/// Remedy for a file that cannot be written.
pub const CHECK_WRITE_ACCESS: &str = "check permissions and free space";

impl Failure {
    /// Creates the failure from an error that names cause and remedy.
    pub fn from_error(error: impl Display) -> Self {
        Self::Failed(error.to_string())
    }

    /// Creates the failure from an error about a file or directory.
    pub fn from_path_error(path: &Path, error: impl Display) -> Self {
        Self::Failed(format!("{}: {error}", path.display()))
    }

    /// Creates the failure of writing a file.
    pub fn from_write_error(file: &Path, error: &dyn Display, remedy: &str) -> Self {
        Self::Failed(format!(
            "{} cannot be written ({error}); {remedy}",
            file.display()
        ))
    }
}

impl From<Vec<Fault>> for Failure {
    fn from(faults: Vec<Fault>) -> Self {
        Self::Faults(faults)
    }
}

impl From<Fault> for Failure {
    fn from(fault: Fault) -> Self {
        Self::Faults(vec![fault])
    }
}

/// Success of a command: complete or in part.
pub enum Completion {
    /// Complete success. Exit status 0.
    All,
    /// Partial success: some images failed, each with a message. Exit status 1.
    Partly,
    /// Errors in configuration or installation, printed to standard output as results. Exit status 78.
    Faulty,
}

impl Completion {
    /// Returns complete success, or partial success.
    pub fn from_success(ok: bool) -> Self {
        if ok { Self::All } else { Self::Partly }
    }
}

/// Creates the failure for a part of the program that the on-board build lacks.
pub fn not_on_board(part: &str) -> Failure {
    Failure::Usage(format!(
        "{part} is not in the on-board build; use the package wingd-desk, on a copy of the store"
    ))
}
