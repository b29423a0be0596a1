//! The camera process: started by the recorder, never by a person.

use wingd_base::failure::{Completion, Failure, TaskResult};

/// Arguments of the camera process: none.
#[derive(clap::Args)]
pub struct CameraChildArgs {}

/// Serves the recorder on standard input and output.
pub fn run(_: &CameraChildArgs) -> TaskResult<Completion> {
    crate::camera::gphoto::child::serve_requests()
        .map(|()| Completion::All)
        .map_err(|error| Failure::Failed(format!("camera process: {error}")))
}
