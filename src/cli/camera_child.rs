//! The camera process: started by the recorder, never by a person.

use crate::cli::{Completion, Failure};

/// Serves the recorder on standard input and output.
pub fn run() -> Result<Completion, Failure> {
    crate::camera::gphoto::child::serve_requests()
        .map(|()| Completion::All)
        .map_err(|error| Failure::Failed(format!("camera process: {error}")))
}
