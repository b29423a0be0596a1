//! Records the lines of a feed; each is durable within seconds.

use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use super::feed::{FeedContext, POLL_INTERVAL};
use crate::daemon::budget::check_disk_share;
use crate::daemon::status::format_span;
use wingd_evaluation::aircraft;
use wingd_evaluation::aircraft::Layout;
use wingd_store::aircraft::AircraftLine;

/// Maximum number of lines that wait to be recorded: one minute of ten feeds at 10 Hz, at most 25 MB.
pub(super) const MAX_WAITING: usize = 6000;
/// Maximum time from the receipt of a line until it is durable.
const FLUSH_INTERVAL: Duration = Duration::from_secs(2);
/// Share of the disk for aircraft data.
const DISK_SHARE: f64 = 0.1;
/// Time for which lost lines are reported: a person looks at the status later than at the moment of the loss.
const LOSS_REPORT: Duration = Duration::from_secs(60);

/// Records the lines of a feed.
pub(super) struct LineRecorder {
    shared: FeedContext,
    layout: Layout,
    /// Description of the feed in each file.
    source: serde_json::Value,
    waiting: Vec<AircraftLine>,
    /// Lost lines so far.
    lost: u64,
    /// Number of lines lost lately, and the time until which it is reported.
    recent: (u64, Instant),
}

impl LineRecorder {
    /// Creates the recorder of a feed.
    pub fn new(shared: FeedContext) -> Self {
        let layout = shared.config.layout();
        let (udp, tcp) = (&shared.config.udp, &shared.config.tcp);
        let source = serde_json::json!({"udp": udp, "tcp": tcp, "layout": layout});
        Self {
            shared,
            layout,
            source,
            waiting: Vec::new(),
            lost: 0,
            recent: (0, Instant::now()),
        }
    }

    /// Stores the received lines every two seconds, and the remaining ones at the end.
    pub fn run(mut self, inbox: &Receiver<AircraftLine>) {
        let mut flushed = Instant::now();
        loop {
            let received = inbox.recv_timeout(POLL_INTERVAL);
            let gone = matches!(received, Err(RecvTimeoutError::Disconnected));
            self.waiting.extend(received);
            self.waiting.extend(inbox.try_iter().take(MAX_WAITING));
            self.drop_excess();
            let ending = gone || self.shared.is_ending();
            // The power may be about to fail.
            if ending || self.shared.core.halt.is_requested() || flushed.elapsed() >= FLUSH_INTERVAL
            {
                self.store_lines();
                flushed = Instant::now();
            }
            if ending {
                break;
            }
        }
        if let Err(error) = self.shared.core.store.close_aircraft_file() {
            self.shared.set_fault(Some(error.to_string()));
        }
    }

    /// Drops the oldest lines beyond [`MAX_WAITING`].
    fn drop_excess(&mut self) {
        let over = self.waiting.len().saturating_sub(MAX_WAITING);
        self.waiting.drain(..over);
        if over > 0 {
            self.shared.update(|status| status.lost += over as u64);
        }
    }

    fn store_lines(&mut self) {
        if self.waiting.is_empty() {
            return;
        }
        let core = &self.shared.core;
        let used = core.store.aircraft_bytes();
        let used = used.map_err(|error| error.to_string());
        let stored = match used.and_then(|used| check_disk_share(&core.store, DISK_SHARE, used)) {
            Ok(()) => core
                .store
                .add_aircraft_lines(&self.source, &self.waiting)
                .map_err(|error| error.to_string()),
            Err(why) => Err(format!("not recorded: {why}")),
        };
        let count = self.waiting.len() as u64;
        let statistics = LineStatistics::from_lines(&self.layout, &self.waiting);
        match stored {
            // There is no flight yet: the first series begins it.
            Ok(false) => return,
            Ok(true) => self.shared.update(|status| {
                status.recorded += count;
                status.read += statistics.read;
                status.impossible += statistics.impossible;
            }),
            Err(_) => self.shared.update(|status| status.lost += count),
        }
        self.waiting.clear();
        let lost = self.count_losses();
        self.shared
            .set_fault(stored.err().or_else(|| statistics.fault(lost)));
    }

    /// Counts lost lines; 0 after [`LOSS_REPORT`] without a loss.
    fn count_losses(&mut self) -> u64 {
        let (lost, now) = (self.shared.update(|status| status.lost), Instant::now());
        let new = lost - std::mem::replace(&mut self.lost, lost);
        if now >= self.recent.1 {
            self.recent.0 = 0;
        }
        if new > 0 {
            self.recent = (self.recent.0 + new, now + LOSS_REPORT);
        }
        self.recent.0
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
            let Some(sample) = layout.read(&line.line) else {
                continue;
            };
            statistics.read += 1;
            if let Some(delay_s) = line
                .at
                .as_ref()
                .and_then(|at| aircraft::impossible_delay_s(sample.time_s, at))
            {
                statistics.impossible += 1;
                statistics.delay_s = delay_s;
            }
        }
        statistics
    }

    /// Returns the fault of a batch shortly before which `lost` lines were lost.
    fn fault(&self, lost: u64) -> Option<String> {
        if self.read == 0 {
            return Some("lines arrive but none can be parsed; check format".to_owned());
        }
        if lost > 0 {
            let remedy = "lines of other senders may displace those of your feed: list its address in senders";
            return Some(format!(
                "{lost} lines were lost, because more arrive than are recorded; {remedy}"
            ));
        }
        let direction = if self.delay_s < 0.0 {
            "ahead of"
        } else {
            "behind"
        };
        (self.impossible > 0).then(|| {
            let apart = format_span(self.delay_s.abs().round());
            format!("impossible time tags, {apart} {direction} their receipt, are not used; check both clocks")
        })
    }
}
