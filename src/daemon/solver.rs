//! The daemon is handed its solver: it knows frames and records, and not how one becomes the other.

use std::sync::Arc;
use std::time::Duration;

use crate::camera::Format;
use crate::measure::adjust::AdjustError;
use crate::pipeline::live::Tracked;
use crate::record::ImageRecord;
use crate::store::Inputs;

/// Solves one frame after the other: its name, bytes, how to read them, when it was exposed (since boot, s).
pub type Tracking = Box<dyn FnMut(&str, &[u8], &Format, f64) -> Tracked + Send>;

/// Begins tracking, at the start and after a solver was given up.
pub type Track = Arc<dyn Fn() -> Result<Tracking, AdjustError> + Send + Sync>;

/// File name, bytes, how to read them -> the result.
pub type Solve = Arc<dyn Fn(&str, &[u8], &Format) -> ImageRecord + Send + Sync>;

/// How frames are solved, one at a time.
#[derive(Clone)]
pub struct Solver {
    /// What the results depend on beside the frame.
    pub inputs: Inputs,
    /// Does it.
    pub solve: Solve,
    /// A frame that takes longer is given up and recorded as failed. Machine time.
    pub deadline: Duration,
    /// Solves live frames one after the other; none, and they are recorded only.
    pub track: Option<Track>,
}
