//! Solving: asks the store for frames without a result, so that a restart needs no other recovery of work.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use serde_json::Value;

use super::halt::Halt;
use super::status::{Activity, Board};
use super::{Event, Observer, Solver};
use crate::camera::Format;
use crate::record::{ImageRecord, Method, Status};
use crate::store::{FrameRef, Store, StoreError};

/// Beginnings of one frame after which the frame is taken to bring the program down.
const MAX_BEGINNINGS: u32 = 5;
/// Solvers given up that may run on at a time; each holds a thread, at worst a core.
const MAX_HANGING: usize = 2;
/// The longest wait without a sign of life, and without a look at the halt.
const BEAT: Duration = Duration::from_millis(50);

/// What the processing thread works with.
pub(crate) struct Processing {
    pub store: Arc<Store>,
    pub solver: Solver,
    pub board: Board,
    pub observer: Observer,
    pub halt: Halt,
    /// One count per solver that runs, and ours.
    pub running: Arc<()>,
    /// Frames are solved live meanwhile, and go before these.
    pub gives_way: bool,
}

impl Processing {
    /// Solves what there is, then waits to be woken. When nobody can wake it any more it solves the
    /// rest and ends; when asked to stop it ends after the frame under work.
    pub fn run(&self, wake: &Receiver<()>) {
        loop {
            let solved = self.solve_all();
            self.store.seal();
            if let Err(error) = solved {
                tracing::error!(%error, "results cannot be stored; tried again with the next series");
                self.board.fault(&error.to_string());
            }
            self.board.beat_processing(false);
            if self.halt.ending() || wake.recv().is_err() {
                break;
            }
        }
        if !self.halt.wanted() {
            self.board.update(|status| status.activity = Activity::Finishing);
            let _ = self.solve_all();
            self.store.seal();
        }
    }

    fn solve_all(&self) -> Result<(), StoreError> {
        loop {
            self.board.beat_processing(true);
            let frames = self.store.unsolved(&self.solver.inputs)?;
            self.board.update(|status| status.to_solve = frames.len());
            if frames.is_empty() {
                return Ok(());
            }
            for frame in frames {
                self.board.beat_processing(true);
                if self.halt.wanted() {
                    return Ok(());
                }
                if self.hanging() >= MAX_HANGING {
                    let what = "solvers hang; frames are recorded and solved after a restart of wingd";
                    tracing::error!(hanging = self.hanging(), what);
                    self.board.fault(what);
                    return Ok(());
                }
                self.solve(&frame)?;
            }
        }
    }

    /// Whatever comes of it is written: a frame that cannot be solved must not be tried for ever.
    fn solve(&self, frame: &FrameRef) -> Result<(), StoreError> {
        let beginnings = self.store.begin_solving(frame, &self.solver.inputs)?;
        let record = match self.store.read_frame(frame) {
            Ok(_) if beginnings > MAX_BEGINNINGS => {
                let what = format!("wingd ended {MAX_BEGINNINGS} times while solving this frame");
                ImageRecord::failed(
                    &frame.entry.file,
                    Method::None,
                    format!("{what}; solve it with `wingd solve`, which says more"),
                )
            }
            Ok(bytes) => match self.compute(frame, bytes) {
                Some(record) => record,
                None => return self.store.forget_solving(),
            },
            Err(error) => ImageRecord::failed(&frame.entry.file, Method::None, error.to_string()),
        };
        let ok = record.status == Status::Ok;
        let value = serde_json::to_value(&record).unwrap_or_else(|error| {
            let reason = format!("the result cannot be written as JSON: {error}");
            serde_json::to_value(ImageRecord::failed(&frame.entry.file, Method::None, reason))
                .unwrap_or(Value::Null)
        });
        let new = self.store.add_result(frame, &self.solver.inputs, value)?;
        let (series, file) = (frame.series.id.as_str(), frame.entry.file.as_str());
        match (&record.reason, new) {
            (_, false) => tracing::warn!(series, file, "has a result already"),
            (None, true) => tracing::info!(series, file, "solved"),
            (Some(reason), true) => tracing::warn!(series, file, reason, "not solved"),
        }
        self.board.update(|status| {
            let count = if ok { &mut status.counts.solved } else { &mut status.counts.unsolvable };
            *count += u64::from(new);
            status.to_solve = status.to_solve.saturating_sub(1);
        });
        (self.observer)(&Event::Solved { series: series.to_owned(), file: file.to_owned(), ok });
        Ok(())
    }

    /// Solvers that were given up and run still.
    fn hanging(&self) -> usize {
        Arc::strong_count(&self.running) - 1
    }

    /// `None` where it was given up because wingd stops or the power fails.
    fn compute(&self, frame: &FrameRef, bytes: Vec<u8>) -> Option<ImageRecord> {
        let file = &frame.entry.file;
        let format = match Format::of_manifest(&frame.entry.format) {
            Ok(format) => format,
            Err(what) => return Some(ImageRecord::failed(file, Method::None, what)),
        };
        let deadline = self.solver.deadline;
        Some(match self.within_deadline(file.clone(), bytes, format) {
            Ok(Some(record)) => record,
            Ok(None) if self.halt.over() => return None,
            Ok(None) => {
                self.board.update(|status| status.counts.solver_hangs += 1);
                let what = format!("the solver had no result after {deadline:?} and was given up");
                ImageRecord::failed(file, Method::None, format!("{what}; send the frame to the developers"))
            }
            Err(why) => ImageRecord::failed(file, Method::None, why),
        })
    }

    /// The solver on a thread of its own, which is left behind (`None`) where it does not return in time,
    /// or not before work is to be given up.
    fn within_deadline(
        &self,
        file: String,
        bytes: Vec<u8>,
        format: Format,
    ) -> Result<Option<ImageRecord>, String> {
        let (solve, running, gives_way) = (self.solver.solve.clone(), self.running.clone(), self.gives_way);
        let (done, result) = channel();
        let thread = std::thread::Builder::new().name("solver".to_owned()).spawn(move || {
            let running = running;
            if gives_way {
                super::live::give_way(super::live::SERIES_NICE);
            }
            let record = solve(&file, &bytes, &format);
            // Before the answer, or the next frame would count this thread as hanging.
            drop(running);
            let _ = done.send(record);
        });
        thread.map_err(|error| format!("no thread to solve it on: {error}; solve it with `wingd solve`"))?;
        let mut left = self.solver.deadline;
        loop {
            self.board.beat_processing(true);
            let slice = left.min(BEAT);
            match result.recv_timeout(slice) {
                Ok(record) => return Ok(Some(record)),
                Err(RecvTimeoutError::Disconnected) => {
                    return Err("the solver broke off on this frame; send the frame to the developers".into());
                }
                Err(RecvTimeoutError::Timeout) if left <= slice || self.halt.over() => return Ok(None),
                Err(RecvTimeoutError::Timeout) => left -= slice,
            }
        }
    }
}
