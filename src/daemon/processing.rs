//! Solves the frames of series. The frames come from the store, which lists those without a result; therefore a restart
//! needs no other recovery of work.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use serde_json::Value;

use super::core::{Core, SERIES_NICE, lower_priority};
use super::solver::{CurrentSolver, Solver, SolverSource};
use super::status::{Activity, RESULTS_PART};
use super::worker::{CallError, Worker};
use wingd_evaluation::frame_format::Format;
use wingd_evaluation::record::{ImageRecord, Reason};
use wingd_store::{FrameRef, StoreResult};

/// Number of attempts at one frame after which it is assumed to crash the program.
const MAX_ATTEMPTS: u32 = 5;
/// Maximum number of abandoned solvers that still run; each holds a thread, at worst a core.
const MAX_HANGING: usize = 2;

/// Time between two questions to the source of the solver: an installation that appears or changes is taken up. Reading one
/// takes some milliseconds.
const RENEWAL_INTERVAL: Duration = Duration::from_secs(5);

/// State of the processing thread.
pub(crate) struct Processing {
    core: Core,
    source: SolverSource,
    current: CurrentSolver,
    next_renewal: Instant,
    worker: Worker<()>,
    /// True if frames are solved live at the same time, with a higher priority.
    gives_way: bool,
}

impl Processing {
    /// Creates the processing of frames and sets the current solver; `gives_way`: it yields to the live solver.
    pub fn start(
        core: &Core,
        mut source: SolverSource,
        current: CurrentSolver,
        gives_way: bool,
    ) -> Self {
        let worker = Worker::new("solver", MAX_HANGING, core.halt.clone());
        current.renew(&mut source);
        let next_renewal = Instant::now() + RENEWAL_INTERVAL;
        Self {
            core: core.clone(),
            source,
            current,
            next_renewal,
            worker,
            gives_way,
        }
    }

    /// Takes up a newer solver if it is time to ask for one; returns whether there is one.
    fn renew_solver(&mut self) -> bool {
        let due = Instant::now() >= self.next_renewal;
        if due {
            self.next_renewal = Instant::now() + RENEWAL_INTERVAL;
        }
        due && self.current.renew(&mut self.source)
    }

    /// Waits for the next wake-up or for a newer solver; returns false if nothing more comes.
    fn wait(&mut self, wake: &Receiver<()>) -> bool {
        loop {
            match wake.recv_timeout(RENEWAL_INTERVAL) {
                Ok(()) => return true,
                Err(RecvTimeoutError::Disconnected) => return false,
                Err(RecvTimeoutError::Timeout) if self.renew_solver() => return true,
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// Solves all unsolved frames, then waits for the next wake-up. When the sender is gone it solves the rest and ends; on
    /// a stop request it ends after the current frame.
    pub fn run(mut self, wake: &Receiver<()>) {
        loop {
            let solved = self.solve_all();
            self.core.store.seal();
            let fault = solved
                .err()
                .map(|why| format!("{why}; trying again after the next series"));
            self.core.board.set_fault(RESULTS_PART, fault);
            self.core.board.beat_processing(false);
            if self.core.halt.is_ending() || !self.wait(wake) {
                break;
            }
        }
        if !self.core.halt.is_requested() {
            self.core
                .board
                .update(|status| status.activity = Activity::Finishing);
            let _ = self.solve_all();
            self.core.store.seal();
        }
    }

    /// Solves all unsolved frames, or returns the reason why they wait.
    fn solve_all(&mut self) -> Result<(), String> {
        loop {
            self.core.board.beat_processing(true);
            self.renew_solver();
            let Some(solver) = self.current.get() else {
                return Ok(());
            };
            let frames = self
                .core
                .store
                .unsolved_frames(&solver.inputs)
                .map_err(|error| error.to_string())?;
            self.core.board.note_unsolved(frames.len(), false);
            if frames.is_empty() {
                return Ok(());
            }
            for frame in frames {
                self.core.board.beat_processing(true);
                if self.core.halt.is_requested() {
                    return Ok(());
                }
                if self.worker.hanging() >= MAX_HANGING {
                    return Err(
                        "solvers hang; frames are only recorded until you restart wingd, then solved".to_owned()
                    );
                }
                self.solve_frame(&solver, &frame)
                    .map_err(|error| format!("results cannot be stored: {error}"))?;
                if self.renew_solver() {
                    break;
                }
            }
        }
    }

    /// Solves a frame and stores the outcome in any case: a frame that cannot be solved must not be tried forever.
    fn solve_frame(&mut self, solver: &Arc<Solver>, frame: &FrameRef) -> StoreResult<()> {
        let beginnings = self.core.store.begin_solving(frame, &solver.inputs)?;
        let record = match self.core.store.read_frame(frame) {
            Ok(_) if beginnings > MAX_ATTEMPTS => {
                let reason = format!(
                    "wingd ended {MAX_ATTEMPTS} times while solving this frame; run `wingd solve` on it for details"
                );
                ImageRecord::failed(&frame.entry.file, reason)
            }
            Ok(bytes) => match self.compute_result(solver, frame, bytes) {
                Some(record) => record,
                None => return self.core.store.cancel_solving(),
            },
            Err(error) => ImageRecord::failed(&frame.entry.file, error.to_string()),
        };
        let value = serde_json::to_value(&record).unwrap_or_else(|error| {
            let reason = format!("the result cannot be written as JSON: {error}");
            serde_json::to_value(ImageRecord::failed(&frame.entry.file, reason))
                .unwrap_or(Value::Null)
        });
        let new = self.core.store.add_result(frame, &solver.inputs, value)?;
        self.core.log_frame_solved(frame, &record, new);
        Ok(())
    }

    /// Computes the result of a frame; `None` if it was abandoned because wingd stops or the power fails.
    fn compute_result(
        &mut self,
        solver: &Arc<Solver>,
        frame: &FrameRef,
        bytes: Vec<u8>,
    ) -> Option<ImageRecord> {
        let file = frame.entry.file.clone();
        let why = match self.solve_within_deadline(
            solver.clone(),
            file.clone(),
            bytes,
            &frame.entry.format,
        ) {
            Ok(record) => return Some(record),
            Err(why) => why?,
        };
        Some(ImageRecord::failed(&file, why.text()))
    }

    /// Returns the solver's record, or the reason for its absence; without a reason if work is to be abandoned.
    fn solve_within_deadline(
        &mut self,
        solver: Arc<Solver>,
        file: String,
        bytes: Vec<u8>,
        format: &Value,
    ) -> Result<ImageRecord, Option<Reason>> {
        let format = Format::from_manifest(format).map_err(Reason::from_error)?;
        let (deadline, gives_way) = (solver.deadline, self.gives_way);
        let make = move || {
            if gives_way {
                lower_priority(SERIES_NICE);
            }
            Some(())
        };
        let board = &self.core.board;
        let beat = || board.beat_processing(true);
        let answer = self.worker.call(deadline, &beat, make, move |()| {
            (solver.solve)(&file, &bytes, &format)
        });
        board.update(|status| status.counts.solver_hangs = self.worker.given_up());
        answer.map_err(|why| {
            let reason = match why {
                CallError::Halted(_) => return None,
                CallError::TooManyHang => "solvers hang; solve the frame with `wingd solve`".to_owned(),
                CallError::NoThread(error) => {
                    format!("no thread can be started for the solver: {error}; solve the frame with `wingd solve`")
                }
                CallError::TimedOut => format!(
                    "the solver had no result after {deadline:?} and was abandoned; run `wingd solve` on the frame and report it"
                ),
                CallError::Broken => "the solver crashed on this frame; run `wingd solve` on the frame and report it".to_owned(),
            };
            Some(reason.into())
        })
    }
}
