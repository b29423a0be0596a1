//! Work beside the recorder, on images and stores: import, calibration, plans, learning, load evaluation, simulation. The
//! commands (`cli`) add arguments, words and the exit status.

pub mod aircraft_table;
#[cfg(feature = "boards")]
pub mod calibration;
pub mod clock_page;
pub mod flight_marks;
pub mod image_files;
pub mod image_names;
pub mod image_times;
pub mod import;
pub mod learning;
pub mod manual_points;
pub mod mount_comparison;
pub mod plan;
pub mod simulation;
pub mod stored_flights;
pub mod stored_frames;
pub mod stress;
pub mod surface;
pub mod time_check;
pub mod time_list;

use std::fmt::Display;
use std::path::Path;

use crate::installation::Fault;
use crate::record::Reason;
use crate::store::StoreError;

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

/// Reads a text file named by the user.
///
/// # Errors
/// Returns an error with file and remedy if it cannot be read or is not text.
fn read_text_file(file: &Path) -> Result<String, Fault> {
    let trouble = |problem: String, remedy: &str| Fault::new(file, "file", problem, remedy);
    let bytes = std::fs::read(file).map_err(|error| {
        trouble(
            format!("cannot be read ({error})"),
            "name a file of UTF-8 text",
        )
    })?;
    crate::installation::decode_text(bytes)
        .map_err(|(problem, remedy)| trouble(problem.into(), remedy))
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

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::from_error(error)
    }
}

impl From<Reason> for Failure {
    fn from(reason: Reason) -> Self {
        Self::from_error(reason)
    }
}
