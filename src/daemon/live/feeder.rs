//! Between the series a frame is taken at each tick and handed on through a mailbox for one.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::frames::Raw;
use super::governor::Governor;
use super::mailbox::Mailbox;
use super::result::LiveFrame;
use super::shared::Shared;
use crate::daemon::capture::{Capture, Missed, Mode, Taken};
use crate::daemon::machine;

/// After a shot that failed; twice as long after each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// At most.
const MAX_PAUSE: Duration = Duration::from_secs(60);
/// So many calls to the camera may hang before live frames pause: what is left is for the series.
const MAX_HANGING: usize = 3;
/// Between two looks at the temperature.
const TEMPERATURE_EVERY: Duration = Duration::from_secs(5);
/// While frames pause.
const PAUSED: Duration = Duration::from_secs(1);

/// Hands frames on. When it is dropped, nothing more comes, and the threads of live mode end.
pub(crate) struct Feeder {
    shared: Shared,
    mailbox: Arc<Mailbox<Arc<LiveFrame>>>,
    raw: Arc<Raw>,
    governor: Governor,
    number: u64,
    /// Since boot.
    next: Duration,
    look: Duration,
    failures: u32,
    /// Which of the camera's openings the raw frames have noted.
    noted: u64,
}

impl Drop for Feeder {
    fn drop(&mut self) {
        self.mailbox.close();
        self.raw.close();
    }
}

impl Feeder {
    pub fn new(shared: Shared, mailbox: Arc<Mailbox<Arc<LiveFrame>>>, raw: Arc<Raw>) -> Self {
        let config = &shared.config;
        let governor = Governor::new(config.rate_hz.unwrap_or(1.0), config.max_temperature_c);
        let (next, look) = (Duration::ZERO, Duration::ZERO);
        Self { shared, mailbox, raw, governor, number: 0, next, look, failures: 0, noted: 0 }
    }

    /// Whether the timetable's series are taken.
    pub fn series(&self) -> bool {
        self.shared.config.series
    }

    /// A series of raw frames was closed since this was asked last: there is something to solve.
    pub fn has_unsolved(&self) -> bool {
        self.raw.unsolved.swap(false, Ordering::Relaxed)
    }

    /// Saves what memory holds of the last seconds, and the next.
    pub fn trigger(&self) {
        let now_s = self.shared.core.clock.since_boot().as_secs_f64();
        self.raw.event(&self.shared, "asked for by wingd trigger".to_owned(), now_s, true);
    }

    /// A good frame goes on; one that is still waiting for the solver is skipped for it.
    pub fn offer(&mut self, taken: Taken, capture: &Capture) {
        if let Some(camera) = capture.opened_since(&mut self.noted) {
            self.raw.camera(camera);
        }
        self.number += 1;
        let frame = Arc::new(LiveFrame { number: self.number, taken });
        let lost = self.raw.push(&frame);
        if self.mailbox.put(frame) {
            self.shared.skip();
        }
        self.shared.update(|live| {
            live.frames += 1;
            live.lost_frames += lost;
        });
    }

    /// When the next frame is due, since boot. While so many calls to the camera hang, or the processor is too hot, none is.
    pub fn due(&mut self, now: Duration, hanging: usize) -> Duration {
        self.look_at_temperature(now);
        match self.governor.allowed_hz() > 0.0 && hanging < MAX_HANGING {
            true => self.next,
            false => now + PAUSED,
        }
    }

    /// Takes the frame that is due.
    pub fn shot(&mut self, capture: &mut Capture) {
        let asked = self.shared.core.clock.stamp();
        self.tick(self.shared.core.clock.since_boot());
        let taken = capture.open().map_err(Missed::from).and_then(|_| capture.take(Mode::Stream, &asked));
        match taken {
            Ok(taken) => {
                self.failures = 0;
                self.shared.clear("camera");
                self.shared.core.board.frame_seen(&asked);
                self.offer(taken, capture);
            }
            Err(missed) => self.failed(&missed.failure.reason),
        }
    }

    /// How often a result is due from now on; `pause`: between two frames of a series.
    pub fn expect_results(&self, pause: Duration) {
        let allowed_hz = self.governor.allowed_hz();
        let interval = (allowed_hz > 0.0).then(|| Duration::from_secs_f64(1.0 / allowed_hz) + pause);
        self.shared.core.board.expect_results(interval);
    }

    /// A period after the last tick; ticks that went by are let go.
    fn tick(&mut self, now: Duration) {
        let period = Duration::from_secs_f64(1.0 / self.governor.allowed_hz().max(0.1));
        self.next = (self.next + period).max(now.saturating_sub(period));
    }

    fn look_at_temperature(&mut self, now: Duration) {
        if !self.governor.limited() || now < self.look {
            return;
        }
        self.look = now + TEMPERATURE_EVERY;
        let hottest =
            machine::temperatures_c(Path::new(machine::SYS)).into_iter().map(|t| t.1).reduce(f64::max);
        let changed = self.governor.look(now.as_secs_f64(), hottest);
        let allowed_hz = self.governor.allowed_hz();
        if changed {
            tracing::warn!(
                allowed_hz,
                temperature_c = hottest,
                "live mode: the rate follows the temperature"
            );
            self.expect_results(Duration::ZERO);
        }
        self.shared.update(|live| (live.temperature_c, live.allowed_hz) = (hottest, allowed_hz));
    }

    fn failed(&mut self, reason: &str) {
        let pause = FIRST_PAUSE.saturating_mul(1 << self.failures.min(10)).min(MAX_PAUSE);
        self.failures = self.failures.saturating_add(1);
        self.next = self.shared.core.clock.since_boot() + pause;
        self.shared.update(|live| live.failed_shots += 1);
        self.shared.fault("camera", &format!("no live frame: {reason}"));
    }
}
