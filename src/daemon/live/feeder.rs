//! Takes a frame at each tick between the series, and hands it to the solver through a mailbox for one frame.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::thread::{Builder, Scope};
use std::time::Duration;

use super::context::LiveContext;
use super::frames::RawFrameBuffer;
use super::mailbox::Mailbox;
use super::result::LiveFrame;
use crate::daemon::capture::{Capture, CaptureMode, CapturedFrame, FailedAttempt};

/// Pause after the first failed shot; each further failure doubles it.
const INITIAL_PAUSE: Duration = Duration::from_millis(500);
/// Maximum pause after failed shots.
const MAX_PAUSE: Duration = Duration::from_secs(60);
/// Number of hanging camera calls at which live frames pause: the remaining ones are for the series.
const MAX_HANGING: usize = 3;
/// Time between two checks while frames pause.
const PAUSE_CHECK_INTERVAL: Duration = Duration::from_secs(1);

/// Maximum time for which frames are taken while the disk stores one of a series: a disk that hangs is the watchdog's, which counts
/// the frames as progress.
const MAX_STORAGE: Duration = Duration::from_secs(60);

/// Takes frames and hands them on. Dropping it ends the threads of live mode.
pub(crate) struct Feeder {
    shared: LiveContext,
    mailbox: Arc<Mailbox<Arc<LiveFrame>>>,
    raw: Arc<RawFrameBuffer>,
    /// Time from one frame to the next.
    period: Duration,
    number: u64,
    /// Time at which the newest frame was requested, since boot, s.
    newest_s: f64,
    /// Time at which the next frame is due, since boot.
    next_frame: Duration,
    failures: u32,
    /// Number of the camera opening that the raw frames have noted.
    noted_opening: u64,
}

impl Drop for Feeder {
    fn drop(&mut self) {
        self.mailbox.close();
        self.raw.close();
    }
}

impl Feeder {
    /// Creates a feeder that puts frames into the mailbox and the raw frame buffer.
    pub fn new(
        shared: LiveContext,
        mailbox: Arc<Mailbox<Arc<LiveFrame>>>,
        raw: Arc<RawFrameBuffer>,
        period: Duration,
    ) -> Self {
        Self {
            shared,
            mailbox,
            raw,
            period,
            number: 0,
            newest_s: 0.0,
            next_frame: Duration::ZERO,
            failures: 0,
            noted_opening: 0,
        }
    }

    /// Returns whether the recorder also takes scheduled series in live mode (key `series`).
    pub fn series_are_enabled(&self) -> bool {
        self.shared.config.series
    }

    /// Returns whether a series of raw frames was closed since the last call, so that there are frames to solve.
    pub fn has_unsolved(&self) -> bool {
        self.raw.unsolved.swap(false, Ordering::Relaxed)
    }

    /// Saves the raw frames of the last seconds from memory, and those of the next seconds.
    pub fn save_recent_frames(&self) {
        let now_s = self.shared.core.clock.since_boot().as_secs_f64();
        self.raw.add_event(
            &self.shared,
            "requested by wingd trigger".to_owned(),
            now_s,
            true,
        );
    }

    /// Forwards a good frame; a frame that still waits for the solver is skipped, and so is one older than the newest.
    pub fn forward_frame(&mut self, taken: CapturedFrame, capture: &Capture) {
        if taken.stamp.since_boot_s < self.newest_s {
            return;
        }
        self.newest_s = taken.stamp.since_boot_s;
        if let Some(camera) = capture.camera_if_reopened(&mut self.noted_opening) {
            self.raw.set_camera(camera);
        }
        self.number += 1;
        let frame = Arc::new(LiveFrame {
            number: self.number,
            taken,
        });
        let lost = self.raw.push(&frame);
        if self.mailbox.put(frame) {
            self.shared.count_skipped();
        }
        self.shared.update(|live| {
            live.frames += 1;
            live.lost_frames += lost;
        });
    }

    /// Returns the time at which the next frame is due, since boot. No frame is due while [`MAX_HANGING`] calls to the
    /// camera hang.
    pub fn next_due(&self, now: Duration, hanging: usize) -> Duration {
        match hanging < MAX_HANGING {
            true => self.next_frame,
            false => now + PAUSE_CHECK_INTERVAL,
        }
    }

    /// Takes the frame that is due.
    pub fn take_due_frame(&mut self, capture: &mut Capture) {
        let asked = self.shared.core.clock.stamp();
        self.advance_tick(self.shared.core.clock.since_boot());
        let taken = capture
            .ensure_open()
            .map_err(FailedAttempt::from)
            .and_then(|_| capture.take_frame(CaptureMode::Stream, &asked));
        match taken {
            Ok(taken) => {
                self.failures = 0;
                self.shared.clear_fault("camera");
                self.shared.core.board.note_frame(&asked);
                self.forward_frame(taken, capture);
                if !capture.is_streaming() {
                    // Otherwise live frames fill the camera's card.
                    capture.release_last_frame();
                }
            }
            Err(failed) => self.pause_after_failure(&failed.failure.reason),
        }
    }

    /// Takes frames on a thread of their own until the sender of `storing` is dropped. If it cannot be started, the next frame
    /// waits for the disk.
    pub fn spawn_while<'scope>(
        &'scope mut self,
        scope: &'scope Scope<'scope, '_>,
        storing: Receiver<()>,
        capture: &'scope mut Capture,
    ) {
        let feed = move || self.take_frames_while(&storing, capture);
        let _ = Builder::new()
            .name("live-feed".to_owned())
            .spawn_scoped(scope, feed);
    }

    /// Takes frames while the recorder's thread waits for the disk. The first one is due after one period, so that a fast disk
    /// leaves the camera to the series.
    fn take_frames_while(&mut self, storing: &Receiver<()>, capture: &mut Capture) {
        let core = self.shared.core.clone();
        let begun = core.clock.since_boot();
        self.next_frame = self.next_frame.max(begun + self.period);
        loop {
            let now = core.clock.since_boot();
            let wait = self
                .next_due(now, capture.hanging_calls())
                .saturating_sub(now);
            let ended = storing.recv_timeout(core.clock.machine_time(wait))
                != Err(RecvTimeoutError::Timeout);
            if ended
                || now > begun + MAX_STORAGE
                || core.halt.is_requested()
                || !capture.is_streaming()
            {
                return;
            }
            if wait.is_zero() {
                self.take_due_frame(capture);
            }
        }
    }

    /// Sets the interval at which results are expected; `pause`: additional time between two frames of a series.
    pub fn expect_results(&self, pause: Duration) {
        self.shared.core.board.expect_results(self.period + pause);
    }

    /// Advances the next tick by one period; failed ticks are dropped.
    fn advance_tick(&mut self, now: Duration) {
        self.next_frame = (self.next_frame + self.period).max(now.saturating_sub(self.period));
    }

    fn pause_after_failure(&mut self, reason: &str) {
        let pause = INITIAL_PAUSE
            .saturating_mul(1 << self.failures.min(10))
            .min(MAX_PAUSE);
        self.failures = self.failures.saturating_add(1);
        self.next_frame = self.shared.core.clock.since_boot() + pause;
        self.shared.update(|live| live.failed_shots += 1);
        self.shared
            .set_fault("camera", &format!("no live frame: {reason}"));
    }
}
