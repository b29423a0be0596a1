//! A moment by which something must be done.

use std::sync::Arc;
use std::time::Duration;

use crate::camera::CameraError;
use crate::clock::Clock;

/// Counts down from its start.
#[derive(Clone)]
pub struct Deadline {
    clock: Arc<dyn Clock>,
    start: Duration,
    span: Duration,
}

impl Deadline {
    /// `span` from now.
    pub fn after(clock: &Arc<dyn Clock>, span: Duration) -> Self {
        Self { clock: clock.clone(), start: clock.since_boot(), span }
    }

    /// What is left; past the deadline the error says `what` was waited for.
    pub fn left(&self, what: &str) -> Result<Duration, CameraError> {
        let gone = self.clock.since_boot().saturating_sub(self.start);
        match self.span.checked_sub(gone) {
            Some(left) if !left.is_zero() => Ok(left),
            _ => Err(self.passed(what)),
        }
    }

    /// The error for `what` not having come in time.
    pub fn passed(&self, what: &str) -> CameraError {
        CameraError::Timeout { after_s: self.span.as_secs_f64(), what: what.to_owned() }
    }
}
