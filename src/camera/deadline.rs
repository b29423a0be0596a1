//! A moment by which a device must have answered. Hardware does not follow a simulated clock, hence
//! the machine's own monotonic one.

use std::time::{Duration, Instant};

use crate::camera::CameraError;

/// Counts down from its start.
#[derive(Clone, Copy, Debug)]
pub struct Deadline {
    start: Instant,
    span: Duration,
}

impl Deadline {
    /// `span` from now.
    pub fn new(span: Duration) -> Self {
        Self { start: Instant::now(), span }
    }

    /// What is left; past the deadline the error says `what` was waited for.
    pub fn remaining(&self, what: &str) -> Result<Duration, CameraError> {
        match self.span.checked_sub(self.start.elapsed()) {
            Some(left) if !left.is_zero() => Ok(left),
            _ => Err(self.timeout_error(what)),
        }
    }

    /// The error for `what` not having come in time.
    pub fn timeout_error(&self, what: &str) -> CameraError {
        CameraError::Timeout { after_s: self.span.as_secs_f64(), what: what.to_owned() }
    }
}
