//! A feed's lines become durable within seconds.

use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use super::feed::{LOOK, Shared};
use crate::aircraft::Layout;
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
    if let Err(error) = shared.core.store.close_aircraft() {
        shared.fault(Some(error.to_string()));
    }
}

fn flush(shared: &Shared, (layout, source): (&Layout, &serde_json::Value), waiting: &mut Vec<AircraftLine>) {
    if waiting.is_empty() {
        return;
    }
    let read = waiting.iter().filter(|line| layout.read(&line.line).is_some()).count() as u64;
    let count = waiting.len() as u64;
    match shared.core.store.add_aircraft(source, waiting) {
        Ok(true) => {
            waiting.clear();
            shared.update(|status| {
                status.recorded += count;
                status.read += read;
                status.fault =
                    (read == 0).then(|| "lines come and none can be read; look at format".to_owned());
            });
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
