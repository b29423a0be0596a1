//! Makes live results durable within seconds, on its own thread, so that a slow disk does not stop solving.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use serde_json::{Map, Value};

use super::context::LiveContext;
use super::table::{ReasonWords, RowLayout};
use crate::pipeline::live::LiveResult;

/// Maximum time from a result until it is durable, apart from the disk's own time.
const FLUSH_INTERVAL: Duration = Duration::from_secs(2);
/// Maximum number of results that wait for the disk: 30 s at 20 per second.
pub(super) const MAX_WAITING: usize = 600;

pub(super) struct LiveResultWriter {
    pub shared: LiveContext,
    /// Provenance of all results.
    pub source: Map<String, Value>,
}

impl LiveResultWriter {
    /// Stores results until the sender ends.
    pub fn run(self, inbox: &Receiver<Arc<LiveResult>>) {
        let (mut layout, mut reasons) = (None, ReasonWords::default());
        let mut waiting = Vec::new();
        let mut open = true;
        while open {
            open = gather_results(inbox, &mut waiting);
            self.flush(&mut layout, &mut reasons, &mut waiting);
        }
        if let Err(error) = self.shared.core.store.close_live_file() {
            tracing::warn!(%error, "the file of live results cannot be closed; this will be done at the next start");
        }
    }

    /// Stores the waiting results; if that fails, up to [`MAX_WAITING`] are kept for the next attempt.
    fn flush(&self, layout: &mut Option<RowLayout>, reasons: &mut ReasonWords, waiting: &mut Vec<Arc<LiveResult>>) {
        let mut changed = false;
        waiting.iter().for_each(|result| changed |= reasons.register(result));
        if changed || layout.is_none() {
            let solved = || waiting.iter().find(|result| result.is_solved()).cloned();
            let first = layout.take().map(|layout| layout.first).or_else(solved);
            *layout = first.map(|first| RowLayout::from_result(first, &self.source, reasons));
        }
        let Some(layout) = layout.as_ref().filter(|_| !waiting.is_empty()) else {
            return self.drop_oldest_beyond_limit(waiting);
        };
        let core = &self.shared.core;
        core.board.note_live_storage(true);
        let mut rows: Vec<_> = waiting.iter().map(|result| layout.row(result)).collect();
        // A value that its column cannot hold costs its own row only.
        rows.retain(|row| layout.table.accepts(row));
        let refused = (waiting.len() - rows.len()) as u64;
        if refused > 0 {
            self.shared.set_fault("rows", &format!("{refused} live results have a value that the store cannot hold"));
        }
        match self.shared.core.store.append_live_rows(&layout.table, &rows, &core.clock.stamp()) {
            Ok(()) => {
                core.board.note_live_storage(false);
                core.board.update(|status| status.flight = core.store.current_flight());
                self.shared.update(|live| {
                    live.stored += rows.len() as u64;
                    live.dropped += refused;
                });
                self.shared.clear_fault("results");
                waiting.clear();
            }
            Err(error) => {
                self.shared.set_fault("results", &format!("live results cannot be stored: {error}"));
                self.drop_oldest_beyond_limit(waiting);
            }
        }
    }

    fn drop_oldest_beyond_limit(&self, waiting: &mut Vec<Arc<LiveResult>>) {
        let beyond = waiting.len().saturating_sub(MAX_WAITING);
        if beyond > 0 {
            waiting.drain(..beyond);
            self.shared.update(|live| live.dropped += beyond as u64);
        }
    }
}

/// Gathers the results that come within [`FLUSH_INTERVAL`]; returns false if no more will come.
fn gather_results(inbox: &Receiver<Arc<LiveResult>>, into: &mut Vec<Arc<LiveResult>>) -> bool {
    let end = Instant::now() + FLUSH_INTERVAL;
    loop {
        match inbox.recv_timeout(end.saturating_duration_since(Instant::now())) {
            Ok(result) => into.push(result),
            Err(RecvTimeoutError::Timeout) => return true,
            Err(RecvTimeoutError::Disconnected) => return false,
        }
    }
}
