//! Records the lines of a feed; each is durable within seconds.

use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use super::feed::{FeedContext, POLL_INTERVAL};
use crate::aircraft::{self, Layout};
use crate::daemon::status::format_span;
use crate::store::aircraft::AircraftLine;

/// Maximum number of lines that wait to be recorded: one minute of ten feeds at 10 Hz.
pub(super) const MAX_WAITING: usize = 6000;
/// Maximum time from the receipt of a line until it is durable.
const FLUSH_INTERVAL: Duration = Duration::from_secs(2);

/// Stores the received lines every two seconds, and the remaining ones at the end.
pub(super) fn record_lines(shared: &FeedContext, inbox: &Receiver<AircraftLine>) {
    let layout = shared.config.layout();
    let (udp, tcp) = (&shared.config.udp, &shared.config.tcp);
    let source = serde_json::json!({"udp": udp, "tcp": tcp, "layout": layout});
    let mut waiting: Vec<AircraftLine> = Vec::new();
    let mut flushed = Instant::now();
    loop {
        let received = inbox.recv_timeout(POLL_INTERVAL);
        let gone = matches!(received, Err(RecvTimeoutError::Disconnected));
        waiting.extend(received);
        waiting.extend(inbox.try_iter().take(MAX_WAITING));
        let ending = gone || shared.is_ending();
        // The power may be about to fail.
        if ending || shared.core.halt.is_requested() || flushed.elapsed() >= FLUSH_INTERVAL {
            store_lines(shared, (&layout, &source), &mut waiting);
            flushed = Instant::now();
        }
        if ending {
            break;
        }
    }
    if let Err(error) = shared.core.store.close_aircraft_file() {
        shared.set_fault(Some(error.to_string()));
    }
}

fn store_lines(shared: &FeedContext, (layout, source): (&Layout, &serde_json::Value), waiting: &mut Vec<AircraftLine>) {
    if waiting.is_empty() {
        return;
    }
    let statistics = LineStatistics::from_lines(layout, waiting);
    let count = waiting.len() as u64;
    match shared.core.store.add_aircraft_lines(source, waiting) {
        Ok(true) => {
            waiting.clear();
            shared.update(|status| {
                status.recorded += count;
                status.read += statistics.read;
                status.impossible += statistics.impossible;
            });
            shared.set_fault(statistics.fault());
        }
        // There is no flight yet: the first series begins it.
        Ok(false) => {
            let over = waiting.len().saturating_sub(MAX_WAITING);
            waiting.drain(..over);
            shared.update(|status| status.lost += over as u64);
        }
        Err(error) => {
            waiting.clear();
            shared.update(|status| status.lost += count);
            shared.set_fault(Some(error.to_string()));
        }
    }
}

/// Counts of readable lines and of impossible time tags in a batch.
#[derive(Default)]
struct LineStatistics {
    read: u64,
    impossible: u64,
    /// Delay of the last impossible line, receipt minus time tag, s.
    delay_s: f64,
}

impl LineStatistics {
    fn from_lines(layout: &Layout, lines: &[AircraftLine]) -> Self {
        let mut statistics = Self::default();
        for line in lines {
            let Some(sample) = layout.read(&line.line) else { continue };
            statistics.read += 1;
            if let Some(delay_s) = line.at.as_ref().and_then(|at| aircraft::impossible_delay_s(sample.time_s, at)) {
                statistics.impossible += 1;
                statistics.delay_s = delay_s;
            }
        }
        statistics
    }

    fn fault(&self) -> Option<String> {
        if self.read == 0 {
            return Some("lines arrive but none can be parsed; check format".to_owned());
        }
        let direction = if self.delay_s < 0.0 { "ahead of" } else { "behind" };
        (self.impossible > 0).then(|| {
            let apart = format_span(self.delay_s.abs().round());
            format!("impossible time tags, {apart} {direction} their receipt, are not used; check both clocks")
        })
    }
}
