//! All threads of the daemon write their state here.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::health::{self, Frames, Live};
use super::recent::Results;
use super::{Health, LiveStatus, Noted, Recent, Status};
use crate::clock::{Clock, Stamp};
use crate::daemon::watchdog::Beats;

/// The status as the threads write it. Cheap to clone; all clones write the same status.
#[derive(Clone)]
pub struct StatusBoard {
    clock: Arc<dyn Clock>,
    state: Arc<Mutex<State>>,
}

struct State {
    status: Status,
    frames: Frames,
    live: Option<Live>,
    series: Results,
    /// Since boot, s.
    next_series_at_s: Option<f64>,
    beats: Beats,
}

impl State {
    fn judge(&self, now_s: f64) -> (Health, Vec<String>) {
        health::judge(&self.status, (&self.frames, &self.series, self.live.as_ref()), now_s)
    }
}

impl StatusBoard {
    /// A status that nobody has written to.
    pub fn new(clock: Arc<dyn Clock>) -> Self {
        let status = Status {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            started: Some(clock.stamp()),
            ..Status::default()
        };
        let (frames, series, beats) = (Frames::default(), Results::of_series(), Beats::default());
        let state = State { status, frames, live: None, series, next_series_at_s: None, beats };
        Self { clock, state: Arc::new(Mutex::new(state)) }
    }

    /// The status now.
    pub fn snapshot(&self) -> Status {
        let now = self.clock.stamp();
        let now_s = now.since_boot_s;
        self.with(|state| {
            let mut status = state.status.clone();
            (status.health, status.reasons) = state.judge(now_s);
            status.age_s = state.live.as_ref().map_or(&state.series, |live| &live.results).age_s(now_s);
            status.recent = Recent { skipped: None, ..state.series.recent() };
            if let (Some(said), Some(live)) = (&mut status.live, &state.live) {
                (said.interval_s, said.recent) = (live.interval_s, live.results.recent());
            }
            status.last_frame_age_s = state.frames.age_s(now_s);
            status.next_series_s = state.next_series_at_s.map(|at| (at - now_s).max(0.0));
            status.now = Some(now.clone());
            status
        })
    }

    /// Health alone.
    pub(crate) fn health(&self) -> Health {
        let now_s = self.now_s();
        self.with(|state| state.judge(now_s).0)
    }

    fn now_s(&self) -> f64 {
        self.clock.since_boot().as_secs_f64()
    }

    /// A live result is expected every interval, for as long as nothing else is said; none where live frames pause.
    pub(crate) fn expect_results(&self, interval: Option<Duration>) {
        let (now_s, interval_s) = (self.now_s(), interval.map(|interval| interval.as_secs_f64()));
        self.with(|state| match &mut state.live {
            Some(live) => live.interval_s = interval_s,
            none => *none = Some(Live::begin(interval_s, now_s)),
        });
    }

    /// A live result came, of a frame exposed at this time since boot, s; `skipped`: frames skipped since the start.
    pub(crate) fn live_result(&self, at_s: f64, (solved, rejected): (bool, bool), skipped: u64) {
        self.with(|state| {
            if let Some(live) = &mut state.live {
                live.results.note(at_s, solved, rejected, skipped);
            }
        });
    }

    /// A frame of a series has its result.
    pub(crate) fn series_result(&self, solved: bool, rejected: bool) {
        let now_s = self.now_s();
        self.with(|state| state.series.note(now_s, solved, rejected, 0));
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
        let now_s = self.now_s();
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
        let now_s = self.now_s();
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
    use crate::clock::SimulatedClock;
    use crate::daemon::Health;

    #[test]
    fn health_is_the_age_of_the_last_good_frame() {
        let clock = Arc::new(SimulatedClock::new("b", "2026-03-01T06:00:00Z".parse().unwrap(), None));
        let board = StatusBoard::new(clock.clone());
        board.expect_frames(Duration::from_secs(3600));
        assert_eq!((board.snapshot().health, board.snapshot().last_frame_age_s), (Health::Ok, None));
        board.frame_stored(&clock.stamp());
        clock.sleep(Duration::from_secs(5000));
        assert_eq!(board.snapshot().health, Health::Ok);
        assert_eq!(board.snapshot().last_frame_age_s, Some(5000.0));
        clock.sleep(Duration::from_secs(500));
        assert_eq!(board.snapshot().health, Health::Failed);
    }

    #[test]
    fn without_any_frame_health_turns_bad_too() {
        let clock = Arc::new(SimulatedClock::new("b", "1970-01-01T00:00:30Z".parse().unwrap(), None));
        let board = StatusBoard::new(clock.clone());
        board.expect_frames(Duration::from_secs(3600));
        clock.sleep(Duration::from_secs(5500));
        assert_eq!(board.snapshot().health, Health::Failed);
    }
}
