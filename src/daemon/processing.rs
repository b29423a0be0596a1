//! Solving: asks the store for frames without a result, so that a restart needs no other recovery of work.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;

use serde_json::{Map, Value};

use super::status::{Activity, Board};
use super::{Event, Observer, Solver};
use crate::camera::Format;
use crate::record::{ImageRecord, Status};
use crate::store::{FrameRef, Store, StoreError};

/// Beginnings of one frame after which the frame is taken to bring the program down.
const MAX_BEGINNINGS: u32 = 5;

/// What the processing thread works with.
pub(crate) struct Processing {
    pub store: Arc<Store>,
    pub solver: Solver,
    pub board: Board,
    pub observer: Observer,
    pub stop: Arc<AtomicBool>,
}

impl Processing {
    /// Solves what there is, then waits to be woken. When nobody can wake it any more it solves the
    /// rest and ends; when asked to stop it ends after the frame under work.
    pub fn run(&self, wake: &Receiver<()>) {
        loop {
            if let Err(error) = self.solve_all() {
                tracing::error!(%error, "results cannot be stored; tried again with the next series");
                self.board.fault(&error.to_string());
            }
            if self.stop.load(Ordering::Relaxed) || wake.recv().is_err() {
                break;
            }
        }
        if !self.stop.load(Ordering::Relaxed) {
            self.board.update(|status| status.activity = Activity::Finishing);
            let _ = self.solve_all();
        }
    }

    fn solve_all(&self) -> Result<(), StoreError> {
        loop {
            let frames = self.store.unsolved(&self.solver.inputs)?;
            self.board.update(|status| status.to_solve = frames.len());
            if frames.is_empty() {
                return Ok(());
            }
            for frame in frames {
                if self.stop.load(Ordering::Relaxed) {
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
                failed(&frame.entry.file, format!("{what}; solve it with `wingd solve`, which says more"))
            }
            Ok(bytes) => self.compute(frame, &bytes),
            Err(error) => failed(&frame.entry.file, error.to_string()),
        };
        let ok = record.status == Status::Ok;
        let value = serde_json::to_value(&record).unwrap_or_else(|error| {
            let reason = format!("the result cannot be written as JSON: {error}");
            serde_json::to_value(failed(&frame.entry.file, reason)).unwrap_or(Value::Null)
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

    fn compute(&self, frame: &FrameRef, bytes: &[u8]) -> ImageRecord {
        let file = &frame.entry.file;
        let format = match serde_json::from_value::<Format>(frame.entry.format.clone()) {
            Ok(format) => format,
            Err(error) => return failed(file, format!("series.json does not say how to read it: {error}")),
        };
        catch_unwind(AssertUnwindSafe(|| (self.solver.solve)(file, bytes, &format))).unwrap_or_else(|_| {
            failed(file, "the solver broke off on this frame; send the frame to the developers".to_owned())
        })
    }
}

/// A record without numbers.
fn failed(image: &str, reason: String) -> ImageRecord {
    ImageRecord {
        image: image.to_owned(),
        status: Status::Failed,
        reason: Some(reason),
        method: String::new(),
        flight: false,
        variance_factor: None,
        redundancy: None,
        global_test: None,
        sigma_kind: None,
        model: Map::new(),
        tip: None,
        markers: Vec::new(),
        torsion: Vec::new(),
        curve: Vec::new(),
        quality: Map::new(),
        remarks: Vec::new(),
        provenance: Map::new(),
        timing_ms: Map::new(),
    }
}
