//! Makes live results durable within seconds, on its own thread, so that a slow disk does not stop solving.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use super::context::LiveContext;
use super::table::{ReasonWords, RowLayout};
use crate::daemon::solver::Solver;
use wingd_evaluation::pipeline::live::LiveResult;

/// Maximum time from a result until it is durable, apart from the disk's own time.
const FLUSH_INTERVAL: Duration = Duration::from_secs(2);
/// Maximum number of results that wait for the disk: 30 s at 20 per second.
pub(super) const MAX_WAITING: usize = 600;

/// A result that waits for the disk.
pub(super) struct WaitingResult {
    pub result: Arc<LiveResult>,
    /// Solver whose provenance the result has.
    pub solver: Arc<Solver>,
}

pub(super) struct LiveResultWriter {
    pub shared: LiveContext,
}

/// Layout of the rows of a solver's results.
#[derive(Default)]
struct SolverRows {
    solver: Option<Arc<Solver>>,
    layout: Option<RowLayout>,
    reasons: ReasonWords,
}

impl SolverRows {
    /// Returns the layout for results of one solver; `None` while none of them has had numbers.
    fn layout_for(&mut self, waiting: &[WaitingResult]) -> Option<&RowLayout> {
        let solver = &waiting.first()?.solver;
        if self
            .solver
            .as_ref()
            .is_none_or(|before| !Arc::ptr_eq(before, solver))
        {
            *self = Self {
                solver: Some(solver.clone()),
                ..Self::default()
            };
        }
        let mut changed = self.layout.is_none();
        waiting
            .iter()
            .for_each(|one| changed |= self.reasons.register(&one.result));
        if changed {
            let solved = || {
                waiting
                    .iter()
                    .map(|one| &one.result)
                    .find(|result| result.is_solved())
                    .cloned()
            };
            let first = self
                .layout
                .take()
                .map(|layout| layout.first)
                .or_else(solved);
            self.layout = first.map(|first| {
                RowLayout::from_result(first, &solver.inputs.provenance, &self.reasons)
            });
        }
        self.layout.as_ref()
    }
}

impl LiveResultWriter {
    /// Stores results until the sender ends.
    pub fn run(self, inbox: &Receiver<WaitingResult>) {
        let (mut rows, mut waiting) = (SolverRows::default(), Vec::new());
        let mut open = true;
        while open {
            open = gather_results(inbox, &mut waiting);
            while self.flush(&mut rows, &mut waiting) {}
        }
        if let Err(error) = self.shared.core.store.close_live_file() {
            tracing::warn!(%error, "the file of live results cannot be closed; this will be done at the next start");
        }
    }

    /// Stores the waiting results of the first solver; if that fails, up to [`MAX_WAITING`] are kept for the next attempt.
    /// Returns whether results of another solver wait.
    fn flush(&self, rows: &mut SolverRows, waiting: &mut Vec<WaitingResult>) -> bool {
        let same = waiting
            .chunk_by(|a, b| Arc::ptr_eq(&a.solver, &b.solver))
            .next()
            .unwrap_or_default();
        let (count, more) = (same.len(), same.len() < waiting.len());
        let stored = match rows.layout_for(same) {
            Some(layout) => self.store_rows(layout, same),
            // No further result of this solver can give the layout.
            None => more.then_some(0),
        };
        match stored {
            Some(stored) => {
                waiting.drain(..count);
                self.shared.update(|live| {
                    live.stored += stored as u64;
                    live.dropped += (count - stored) as u64;
                });
                more
            }
            None => {
                self.drop_oldest_beyond_limit(waiting);
                false
            }
        }
    }

    /// Stores results; returns the number of those that the store can hold, `None` if they could not be written.
    fn store_rows(&self, layout: &RowLayout, waiting: &[WaitingResult]) -> Option<usize> {
        let core = &self.shared.core;
        core.board.note_live_storage(true);
        let mut rows: Vec<_> = waiting.iter().map(|one| layout.row(&one.result)).collect();
        // A value that its column cannot hold costs its own row only.
        rows.retain(|row| layout.table.accepts(row));
        let refused = waiting.len() - rows.len();
        if refused > 0 {
            self.shared.set_fault(
                "rows",
                &format!("{refused} live results have a value that the store cannot hold"),
            );
        }
        if let Err(error) = core
            .store
            .append_live_rows(&layout.table, &rows, &core.clock.stamp())
        {
            self.shared.set_fault(
                "results",
                &format!("live results cannot be stored: {error}"),
            );
            return None;
        }
        core.board.note_live_storage(false);
        // Not under the lock of the status, which capturing needs: a series may hold the store's.
        let flight = core.store.current_flight();
        core.board.update(|status| status.flight = flight);
        self.shared.clear_fault("results");
        Some(rows.len())
    }

    fn drop_oldest_beyond_limit(&self, waiting: &mut Vec<WaitingResult>) {
        let beyond = waiting.len().saturating_sub(MAX_WAITING);
        if beyond > 0 {
            waiting.drain(..beyond);
            self.shared.update(|live| live.dropped += beyond as u64);
        }
    }
}

/// Gathers the results that come within [`FLUSH_INTERVAL`]; returns false if no more will come.
fn gather_results(inbox: &Receiver<WaitingResult>, into: &mut Vec<WaitingResult>) -> bool {
    let end = Instant::now() + FLUSH_INTERVAL;
    loop {
        match inbox.recv_timeout(end.saturating_duration_since(Instant::now())) {
            Ok(result) => into.push(result),
            Err(RecvTimeoutError::Timeout) => return true,
            Err(RecvTimeoutError::Disconnected) => return false,
        }
    }
}
