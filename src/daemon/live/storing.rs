//! Results become durable within seconds, on a thread of its own: a slow disk does not stop solving.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use serde_json::{Map, Value};

use super::result::LiveResult;
use super::shared::Shared;
use super::table::{Table, Words};

/// A result is durable at most this long after it came, but for the disk's own time.
const FLUSH: Duration = Duration::from_secs(2);
/// Results that may wait for the disk: half a minute at 20 a second.
pub(super) const WAITING: usize = 600;

pub(super) struct Storing {
    pub shared: Shared,
    /// What all results come from.
    pub source: Map<String, Value>,
}

impl Storing {
    /// Until nobody gives results any more.
    pub fn run(self, inbox: &Receiver<Arc<LiveResult>>) {
        let (mut table, mut words) = (None, Words::default());
        let mut waiting = Vec::new();
        let mut open = true;
        while open {
            open = gather(inbox, &mut waiting);
            self.flush(&mut table, &mut words, &mut waiting);
        }
        if let Err(error) = self.shared.core.store.close_live_file() {
            tracing::warn!(%error, "the live results' file is closed at the next start");
        }
    }

    /// What cannot be written now is kept for the next time, as many as may wait.
    fn flush(&self, table: &mut Option<Table>, words: &mut Words, waiting: &mut Vec<Arc<LiveResult>>) {
        let mut news = false;
        waiting.iter().for_each(|result| news |= words.learn(result));
        match table.as_mut() {
            Some(table) if news => table.say(words),
            Some(_) => {}
            None => {
                let first = waiting.iter().find(|result| result.solved());
                *table = first.map(|result| Table::of(result, &self.source, words));
            }
        }
        let Some(table) = table.as_ref().filter(|_| !waiting.is_empty()) else { return self.bound(waiting) };
        let rows: Vec<_> = waiting.iter().map(|result| table.row(result)).collect();
        match self.shared.core.store.append_live_rows(&table.table, &rows, &self.shared.core.clock.stamp()) {
            Ok(()) => {
                let core = &self.shared.core;
                core.board.update(|status| status.flight = core.store.current_flight());
                self.shared.update(|live| live.stored += rows.len() as u64);
                self.shared.clear("results");
                waiting.clear();
            }
            Err(error) => {
                self.shared.fault("results", &format!("live results cannot be stored: {error}"));
                self.bound(waiting);
            }
        }
    }

    fn bound(&self, waiting: &mut Vec<Arc<LiveResult>>) {
        let beyond = waiting.len().saturating_sub(WAITING);
        if beyond > 0 {
            waiting.drain(..beyond);
            self.shared.update(|live| live.dropped += beyond as u64);
        }
    }
}

/// What comes within [`FLUSH`]; false where nothing will come any more.
fn gather(inbox: &Receiver<Arc<LiveResult>>, into: &mut Vec<Arc<LiveResult>>) -> bool {
    let end = Instant::now() + FLUSH;
    loop {
        match inbox.recv_timeout(end.saturating_duration_since(Instant::now())) {
            Ok(result) => into.push(result),
            Err(RecvTimeoutError::Timeout) => return true,
            Err(RecvTimeoutError::Disconnected) => return false,
        }
    }
}
