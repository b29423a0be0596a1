//! Solves the frames of series. The store is asked for frames without a result, so that a restart needs no other recovery of
//! work.

use std::sync::mpsc::Receiver;

use serde_json::Value;

use super::core::{Core, SERIES_NICE, give_way};
use super::solver::Solver;
use super::status::Activity;
use super::worker::{Unanswered, Worker};
use crate::camera::Format;
use crate::record::{ImageRecord, Method, Reason};
use crate::store::{FrameRef, StoreError};

/// Beginnings of one frame after which the frame is taken to bring the program down.
const MAX_BEGINNINGS: u32 = 5;
/// Solvers given up that may run on at a time; each holds a thread, at worst a core.
const MAX_HANGING: usize = 2;

/// What the processing thread works with.
pub(crate) struct Processing {
    core: Core,
    solver: Solver,
    worker: Worker<()>,
    /// Frames are solved live meanwhile, and go before these.
    gives_way: bool,
}

impl Processing {
    pub fn new(core: &Core, solver: Solver, gives_way: bool) -> Self {
        let worker = Worker::new("solver", MAX_HANGING, core.halt.clone());
        Self { core: core.clone(), solver, worker, gives_way }
    }

    /// Solves what there is, then waits to be woken. When nobody can wake it any more it solves the
    /// rest and ends; when asked to stop it ends after the frame under work.
    pub fn run(mut self, wake: &Receiver<()>) {
        loop {
            let solved = self.solve_all();
            self.core.store.seal();
            if let Err(error) = solved {
                tracing::error!(%error, "results cannot be stored; tried again with the next series");
                self.core.board.fault(&error.to_string());
            }
            self.core.board.beat_processing(false);
            if self.core.halt.ending() || wake.recv().is_err() {
                break;
            }
        }
        if !self.core.halt.wanted() {
            self.core.board.update(|status| status.activity = Activity::Finishing);
            let _ = self.solve_all();
            self.core.store.seal();
        }
    }

    fn solve_all(&mut self) -> Result<(), StoreError> {
        loop {
            self.core.board.beat_processing(true);
            let frames = self.core.store.unsolved_frames(&self.solver.inputs)?;
            self.core.board.update(|status| status.to_solve = frames.len());
            if frames.is_empty() {
                return Ok(());
            }
            for frame in frames {
                self.core.board.beat_processing(true);
                if self.core.halt.wanted() {
                    return Ok(());
                }
                if self.worker.hanging() >= MAX_HANGING {
                    let what = "solvers hang; frames are recorded and solved after a restart of wingd";
                    tracing::error!(hanging = self.worker.hanging(), what);
                    self.core.board.fault(what);
                    return Ok(());
                }
                self.solve(&frame)?;
            }
        }
    }

    /// Whatever comes of it is written: a frame that cannot be solved must not be tried for ever.
    fn solve(&mut self, frame: &FrameRef) -> Result<(), StoreError> {
        let beginnings = self.core.store.begin_solving(frame, &self.solver.inputs)?;
        let record = match self.core.store.read_frame(frame) {
            Ok(_) if beginnings > MAX_BEGINNINGS => {
                let what = format!(
                    "wingd ended {MAX_BEGINNINGS} times while solving this frame; solve it with `wingd solve`, which says more"
                );
                ImageRecord::failed(&frame.entry.file, Method::None, what)
            }
            Ok(bytes) => match self.compute(frame, bytes) {
                Some(record) => record,
                None => return self.core.store.cancel_solving(),
            },
            Err(error) => ImageRecord::failed(&frame.entry.file, Method::None, error.to_string()),
        };
        let value = serde_json::to_value(&record).unwrap_or_else(|error| {
            let reason = format!("the result cannot be written as JSON: {error}");
            serde_json::to_value(ImageRecord::failed(&frame.entry.file, Method::None, reason))
                .unwrap_or(Value::Null)
        });
        let new = self.core.store.add_result(frame, &self.solver.inputs, value)?;
        self.core.frame_solved(frame, &record, new);
        Ok(())
    }

    /// `None` where it was given up because wingd stops or the power fails.
    fn compute(&mut self, frame: &FrameRef, bytes: Vec<u8>) -> Option<ImageRecord> {
        let file = frame.entry.file.clone();
        let why = match self.within_deadline(file.clone(), bytes, &frame.entry.format) {
            Ok(record) => return Some(record),
            Err(why) => why?,
        };
        Some(ImageRecord::failed(&file, Method::None, why.text()))
    }

    /// The solver's record, or why there is none; no reason where work is to be given up.
    fn within_deadline(
        &mut self,
        file: String,
        bytes: Vec<u8>,
        format: &Value,
    ) -> Result<ImageRecord, Option<Reason>> {
        let format = Format::from_manifest(format).map_err(Reason::of)?;
        let (solve, deadline, gives_way) = (self.solver.solve.clone(), self.solver.deadline, self.gives_way);
        let make = move || {
            if gives_way {
                give_way(SERIES_NICE);
            }
            Some(())
        };
        let board = &self.core.board;
        let beat = || board.beat_processing(true);
        let answer = self.worker.call(deadline, &beat, make, move |()| solve(&file, &bytes, &format));
        board.update(|status| status.counts.solver_hangs = self.worker.given_up());
        answer.map_err(|why| {
            let what = match why {
                Unanswered::Halted(_) => return None,
                Unanswered::TooManyHang => "solvers hang; solve it with `wingd solve`".to_owned(),
                Unanswered::NoThread(error) => {
                    format!("no thread to solve it on: {error}; solve it with `wingd solve`")
                }
                Unanswered::Late => format!(
                    "the solver had no result after {deadline:?} and was given up; send the frame to the developers"
                ),
                Unanswered::Broken => {
                    "the solver broke off on this frame; send the frame to the developers".to_owned()
                }
            };
            Some(what.into())
        })
    }
}
