//! A feed's lines become durable within seconds.

use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use super::feed::{LOOK, Shared};
use crate::aircraft::{self, Layout};
use crate::daemon::status::span;
use crate::store::aircraft::AircraftLine;

/// Lines that may wait to be recorded: a minute of ten feeds of 10 Hz.
pub(super) const WAITING: usize = 6000;
/// A line is durable at most this long after it came.
const FLUSH: Duration = Duration::from_secs(2);

/// Writes what has come, every two seconds, and the rest at the end.
pub(super) fn record(shared: &Shared, inbox: &Receiver<AircraftLine>) {
    let layout = shared.config.layout();
    let (udp, tcp) = (&shared.config.udp, &shared.config.tcp);
    let source = serde_json::json!({"udp": udp, "tcp": tcp, "layout": layout});
    let mut waiting: Vec<AircraftLine> = Vec::new();
    let mut flushed = Instant::now();
    loop {
        let heard = inbox.recv_timeout(LOOK);
        let gone = matches!(heard, Err(RecvTimeoutError::Disconnected));
        waiting.extend(heard);
        waiting.extend(inbox.try_iter().take(WAITING));
        let ending = gone || shared.over();
        // The power may be about to go.
        if ending || shared.core.halt.wanted() || flushed.elapsed() >= FLUSH {
            flush(shared, (&layout, &source), &mut waiting);
            flushed = Instant::now();
        }
        if ending {
            break;
        }
    }
    if let Err(error) = shared.core.store.close_aircraft_file() {
        shared.fault(Some(error.to_string()));
    }
}

fn flush(shared: &Shared, (layout, source): (&Layout, &serde_json::Value), waiting: &mut Vec<AircraftLine>) {
    if waiting.is_empty() {
        return;
    }
    let seen = Seen::of(layout, waiting);
    let count = waiting.len() as u64;
    match shared.core.store.add_aircraft_lines(source, waiting) {
        Ok(true) => {
            waiting.clear();
            shared.update(|status| {
                status.recorded += count;
                status.read += seen.read;
                status.impossible += seen.impossible;
            });
            shared.fault(seen.fault());
        }
        // The first series begins the flight that they belong to.
        Ok(false) => {
            let over = waiting.len().saturating_sub(WAITING);
            waiting.drain(..over);
            shared.update(|status| status.lost += over as u64);
        }
        Err(error) => {
            waiting.clear();
            shared.update(|status| status.lost += count);
            shared.fault(Some(error.to_string()));
        }
    }
}

/// What some lines are.
#[derive(Default)]
struct Seen {
    read: u64,
    impossible: u64,
    /// How far the last impossible one came after its tag, s.
    delay_s: f64,
}

impl Seen {
    fn of(layout: &Layout, lines: &[AircraftLine]) -> Self {
        let mut seen = Self::default();
        for line in lines {
            let Some(sample) = layout.read(&line.line) else { continue };
            seen.read += 1;
            if let Some(delay_s) = line.at.as_ref().and_then(|at| aircraft::impossible(sample.time_s, at)) {
                seen.impossible += 1;
                seen.delay_s = delay_s;
            }
        }
        seen
    }

    fn fault(&self) -> Option<String> {
        if self.read == 0 {
            return Some("lines come and none can be read; look at format".to_owned());
        }
        let way = if self.delay_s < 0.0 { "ahead of" } else { "behind" };
        (self.impossible > 0).then(|| {
            let apart = span(self.delay_s.abs().round());
            format!("time tags are {apart} {way} their receipt, which cannot be: look at both clocks; they are not joined")
        })
    }
}
