//! All threads of the daemon write their state here.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::health::Frames;
use super::{LiveStatus, Noted, Status};
use crate::clock::{Clock, Stamp};
use crate::daemon::pulse::Beats;

/// The status as the threads write it. Cheap to clone; all clones write the same status.
#[derive(Clone)]
pub struct StatusBoard {
    clock: Arc<dyn Clock>,
    state: Arc<Mutex<State>>,
}

#[derive(Default)]
struct State {
    status: Status,
    frames: Frames,
    /// Since boot, s.
    next_series_at_s: Option<f64>,
    beats: Beats,
}

impl StatusBoard {
    /// A status that nobody has written to.
    pub fn new(clock: Arc<dyn Clock>) -> Self {
        let status = Status {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            started: Some(clock.stamp()),
            ..Status::default()
        };
        Self { clock, state: Arc::new(Mutex::new(State { status, ..State::default() })) }
    }

    /// The status now.
    pub fn snapshot(&self) -> Status {
        let now = self.clock.stamp();
        self.with(|state| Status {
            last_frame_age_s: state.frames.age_s(now.since_boot_s),
            next_series_s: state.next_series_at_s.map(|at| (at - now.since_boot_s).max(0.0)),
            health: state.frames.health(now.since_boot_s),
            now: Some(now.clone()),
            ..state.status.clone()
        })
    }

    /// Changes the status.
    pub(crate) fn update(&self, f: impl FnOnce(&mut Status)) {
        self.with(|state| f(&mut state.status));
    }

    /// Changes what is said of live mode.
    pub(crate) fn update_live(&self, f: impl FnOnce(&mut LiveStatus)) {
        self.update(|status| f(status.live.get_or_insert_default()));
    }

    /// A good frame is expected every interval.
    pub(crate) fn expect_frames(&self, interval: Duration) {
        let now_s = self.clock.since_boot().as_secs_f64();
        self.with(|state| state.frames.expect(interval.as_secs_f64(), now_s));
    }

    /// A good frame that is not stored: the camera is well.
    pub(crate) fn frame_seen(&self, stamp: &Stamp) {
        self.with(|state| state.frames.came(stamp.since_boot_s));
    }

    pub(crate) fn frame_stored(&self, stamp: &Stamp) {
        self.frame_seen(stamp);
        self.update(|status| status.counts.frames += 1);
    }

    pub(crate) fn next_series_in(&self, wait: Option<Duration>) {
        let now_s = self.clock.since_boot().as_secs_f64();
        self.with(|state| state.next_series_at_s = wait.map(|wait| now_s + wait.as_secs_f64()));
    }

    pub(crate) fn fault(&self, what: &str) {
        let noted = Noted { stamp: self.clock.stamp(), what: what.to_owned() };
        self.update(|status| status.last_fault = Some(noted));
    }

    /// The recorder makes progress.
    pub(crate) fn beat(&self) {
        self.with(|state| state.beats.recorder += 1);
    }

    /// The processing makes progress; `busy` until it says that it has no work.
    pub(crate) fn beat_processing(&self, busy: bool) {
        self.with(|state| {
            state.beats.processing += 1;
            state.beats.processing_busy = busy;
        });
    }

    /// Steps so far.
    pub(crate) fn beats(&self) -> Beats {
        self.with(|state| state.beats)
    }

    fn with<T>(&self, f: impl FnOnce(&mut State) -> T) -> T {
        f(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::clock::Simulated;
    use crate::daemon::Health;

    #[test]
    fn health_is_the_age_of_the_last_good_frame() {
        let clock = Arc::new(Simulated::new("b", "2026-03-01T06:00:00Z".parse().unwrap(), None));
        let board = StatusBoard::new(clock.clone());
        board.expect_frames(Duration::from_secs(3600));
        assert_eq!(board.snapshot().health, Health::Young);
        board.frame_stored(&clock.stamp());
        clock.sleep(Duration::from_secs(5000));
        assert_eq!(board.snapshot().health, Health::Good);
        assert_eq!(board.snapshot().last_frame_age_s, Some(5000.0));
        clock.sleep(Duration::from_secs(500));
        assert_eq!(board.snapshot().health, Health::Stale);
    }

    #[test]
    fn without_any_frame_health_turns_bad_too() {
        let clock = Arc::new(Simulated::new("b", "1970-01-01T00:00:30Z".parse().unwrap(), None));
        let board = StatusBoard::new(clock.clone());
        board.expect_frames(Duration::from_secs(3600));
        clock.sleep(Duration::from_secs(5500));
        assert_eq!(board.snapshot().health, Health::Stale);
    }
}
