//! The camera process; started by the recorder, never by a person.

use crate::cli::{Done, Failure};

/// Serves the recorder on standard input and output.
pub fn run() -> Result<Done, Failure> {
    crate::camera::gphoto::child::serve()
        .map(|()| Done::All)
        .map_err(|error| Failure::Undone(format!("camera process: {error}")))
}
