//! The interface to the solver, which is passed in: the daemon knows frames and records, not how one becomes the other.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use wingd_evaluation::frame_format::Format;
use wingd_evaluation::pipeline::live::TrackedFrame;
use wingd_evaluation::record::ImageRecord;
use wingd_measure::adjust::AdjustResult;
use wingd_store::Inputs;

/// Solves consecutive live frames: name, bytes, format, time of exposure (since boot, s).
pub type FrameTracker = Box<dyn FnMut(&str, &[u8], &Format, f64) -> TrackedFrame + Send>;

/// Creates a tracker, at the start and after a solver was abandoned.
pub type FrameTrackerFactory = Arc<dyn Fn() -> AdjustResult<FrameTracker> + Send + Sync>;

/// Solves one frame: file name, bytes, format.
pub type FrameSolver = Arc<dyn Fn(&str, &[u8], &Format) -> ImageRecord + Send + Sync>;

/// Solvers for frames of series and for live frames.
#[derive(Clone)]
pub struct Solver {
    /// Inputs on which results depend in addition to the frame.
    pub inputs: Inputs,
    /// Solver of one frame.
    pub solve: FrameSolver,
    /// Time after which a frame is abandoned and recorded as failed. Machine time.
    pub deadline: Duration,
    /// Factory of trackers for live frames; without it they are only recorded.
    pub track: Option<FrameTrackerFactory>,
}

impl Solver {
    /// Returns the source of this solver alone.
    pub fn into_source(self) -> SolverSource {
        let mut solver = Some(self);
        Box::new(move |_| solver.take())
    }
}

/// Source of the solver, called at the start and every few seconds: returns the solver that replaces the current one, `None`
/// while there is no other. It reports its own faults.
pub type SolverSource = Box<dyn FnMut(Option<&Solver>) -> Option<Solver> + Send>;

/// Current solver, shared by the threads that solve; none while there is no installation.
#[derive(Clone, Default)]
pub(crate) struct CurrentSolver(Arc<Mutex<Option<Arc<Solver>>>>);

impl CurrentSolver {
    /// Returns the solver.
    pub fn get(&self) -> Option<Arc<Solver>> {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Asks the source for a newer solver; returns whether there is one.
    pub fn renew(&self, source: &mut SolverSource) -> bool {
        let newer = source(self.get().as_deref());
        let renewed = newer.is_some();
        if renewed {
            *self.0.lock().unwrap_or_else(PoisonError::into_inner) = newer.map(Arc::new);
        }
        renewed
    }
}
