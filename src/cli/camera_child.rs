//! This is the camera process, which the recorder starts and never a person.

use crate::cli::{Done, Failure};

/// Serves the recorder on standard input and output.
pub fn run() -> Result<Done, Failure> {
    crate::camera::gphoto::child::serve()
        .map(|()| Done::All)
        .map_err(|error| Failure::Failed(format!("camera process: {error}")))
}
