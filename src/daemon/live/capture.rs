//! Frames between the series: one at each tick, handed on through a place for one.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::Shared;
use super::frames::Raw;
use super::governor::Governor;
use super::mailbox::Mailbox;
use super::result::LiveFrame;
use crate::camera::{CameraError, CameraInfo, Frame};
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;
use crate::daemon::judging::camera_map;
use crate::daemon::machine;
use crate::daemon::recorder::Recorder;
use crate::daemon::status::Activity;

/// After a shot that failed; twice as long after each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// At most.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);
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
    /// What the camera said when it was opened last.
    pub info: Option<CameraInfo>,
}

impl Drop for Feeder {
    fn drop(&mut self) {
        self.mailbox.close();
        self.raw.close();
    }
}

impl Feeder {
    pub(super) fn new(shared: Shared, mailbox: Arc<Mailbox<Arc<LiveFrame>>>, raw: Arc<Raw>) -> Self {
        let config = &shared.config;
        let governor = Governor::new(config.rate_hz.unwrap_or(1.0), config.max_temperature_c);
        let (next, look) = (Duration::ZERO, Duration::ZERO);
        Self { shared, mailbox, raw, governor, number: 0, next, look, failures: 0, info: None }
    }

    /// Whether the timetable's series are taken.
    pub fn series(&self) -> bool {
        self.shared.config.series
    }

    /// The camera was opened.
    pub fn opened(&mut self, info: &CameraInfo) {
        self.raw.camera(camera_map(info));
        self.info = Some(info.clone());
    }

    /// Saves what memory holds of the last seconds, and the next.
    pub fn trigger(&self) {
        let now_s = self.shared.clock.since_boot().as_secs_f64();
        self.shared.event(&self.raw, "asked for by wingd trigger".to_owned(), now_s, true);
    }

    /// A frame goes on; one that is still waiting for the solver is skipped for it.
    pub fn offer(&mut self, frame: Frame, stamp: Stamp, duration_s: f64, exposure: Exposure) {
        self.number += 1;
        let frame = Arc::new(LiveFrame { number: self.number, frame, stamp, duration_s, exposure });
        let lost = self.raw.push(&frame);
        if self.mailbox.put(frame) {
            self.shared.skip();
        }
        self.shared.update(|live| {
            live.frames += 1;
            live.lost_frames += lost;
        });
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
        }
        self.shared.update(|live| (live.temperature_c, live.allowed_hz) = (hottest, allowed_hz));
    }

    fn failed(&mut self, reason: &str, now: Duration) {
        let pause = FIRST_PAUSE.saturating_mul(1 << self.failures.min(10)).min(LONGEST_PAUSE);
        self.failures = self.failures.saturating_add(1);
        self.next = now + pause;
        self.shared.update(|live| live.failed_shots += 1);
        self.shared.fault("camera", &format!("no live frame: {reason}"));
    }
}

impl Recorder {
    /// Live frames for so long; returns early to stop and on a trigger.
    pub(in crate::daemon) fn live(&mut self, duration: Duration) {
        self.board.update(|status| status.activity = Activity::Live);
        let end = self.clock.since_boot() + duration;
        while !(self.halt.wanted() || self.triggered) {
            let now = self.clock.since_boot();
            let Some(live) = self.live.as_mut().filter(|_| now < end) else { return };
            if live.raw.unsolved.swap(false, Ordering::Relaxed) {
                let _ = self.wake.send(());
            }
            live.look_at_temperature(now);
            let due = match live.governor.allowed_hz() > 0.0 && self.camera.hanging() < MAX_HANGING {
                true => live.next,
                false => now + PAUSED,
            };
            if due > now {
                self.wait(due.min(end) - now, true);
            } else {
                live.tick(now);
                self.board.beat();
                self.listen();
                self.live_shot();
            }
        }
    }

    fn live_shot(&mut self) {
        let asked = self.clock.stamp();
        let outcome = self.take_live();
        let now = self.clock.since_boot();
        let duration_s = now.as_secs_f64() - asked.since_boot_s;
        match outcome {
            Ok(mut frame) => {
                let exposure = self.exposure(&mut frame, &asked);
                self.board.frame_seen(&asked);
                let Some(live) = &mut self.live else { return };
                live.failures = 0;
                live.shared.clear("camera");
                live.offer(frame, asked, duration_s, exposure);
            }
            Err(reason) => {
                let (hangs, hanging) = (self.camera.hangs(), self.camera.hanging());
                self.board.update(|status| {
                    status.counts.hangs = hangs;
                    status.camera.hanging_calls = hanging;
                });
                if let Some(live) = &mut self.live {
                    live.failed(&reason, now);
                }
            }
        }
    }

    /// A frame that is good, or why there is none.
    fn take_live(&mut self) -> Result<Frame, String> {
        let told = |error: CameraError| error.to_string();
        let board = self.board.clone();
        let beat = || board.beat();
        if let Some(info) = self.camera.ensure_open(&beat).map_err(told)? {
            for warning in &info.warnings {
                tracing::warn!(camera = info.name, warning);
            }
            self.board.update(|status| {
                status.camera.name = Some(info.name.clone());
                status.camera.open = true;
                status.camera.warnings = info.warnings.clone();
            });
            self.live.iter_mut().for_each(|live| live.opened(&info));
        }
        let frame = self.camera.live(self.config.shot_deadline, &beat).map_err(told)?;
        self.judge(&frame).map_err(|failure| failure.reason)?;
        Ok(frame)
    }
}
