//! Deadline for the answer of a device, in the machine's monotonic time: hardware does not follow a simulated clock.

use std::time::{Duration, Instant};

use crate::camera::CameraError;

/// Time limit that counts from its creation.
#[derive(Clone, Copy, Debug)]
pub struct Deadline {
    start: Instant,
    span: Duration,
}

impl Deadline {
    /// Starts a limit of `span` from now.
    pub fn new(span: Duration) -> Self {
        Self {
            start: Instant::now(),
            span,
        }
    }

    /// Returns the remaining time.
    ///
    /// # Errors
    /// Returns an error that names `what` was waited for if the deadline has passed.
    pub fn remaining(&self, what: &str) -> Result<Duration, CameraError> {
        match self.span.checked_sub(self.start.elapsed()) {
            Some(left) if !left.is_zero() => Ok(left),
            _ => Err(self.timeout_error(what)),
        }
    }

    /// Builds the error for `what` not arriving in time.
    pub fn timeout_error(&self, what: &str) -> CameraError {
        CameraError::Timeout {
            after_s: self.span.as_secs_f64(),
            what: what.to_owned(),
        }
    }
}
