//! The status as written by all threads of the daemon.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use super::faults::{self, AIRCRAFT_PART, Faults, LIVE_PARTS, Part};
use super::health::{self, FrameMonitor, LiveMonitor, StorageMonitor};
use super::recent::RecentResults;
use super::{DaemonStatus, FaultNote, Health, LiveStatus, RecentShares};
use crate::daemon::watchdog::Beats;
use wingd_base::clock::{Clock, Stamp};
use wingd_evaluation::record::variant_name;
use wingd_pages::recorder::{LiveResults, Recorder, RecorderState};

/// The status, written by the threads. Cheap to clone; all clones share one status.
#[derive(Clone)]
pub struct StatusBoard {
    clock: Arc<dyn Clock>,
    state: Arc<Mutex<BoardState>>,
    live: Arc<OnceLock<Arc<dyn LiveResults>>>,
}

struct BoardState {
    status: DaemonStatus,
    frames: FrameMonitor,
    live: Option<LiveMonitor>,
    series: RecentResults,
    storage: StorageMonitor,
    faults: Faults,
    /// Time of the next series since boot, s.
    next_series_at_s: Option<f64>,
    beats: Beats,
}

impl BoardState {
    fn evaluate_health(&self, now_s: f64) -> (Health, Vec<String>) {
        let monitors = (
            &self.frames,
            &self.series,
            self.live.as_ref(),
            &self.storage,
        );
        health::evaluate_health(&self.status, monitors, &self.faults, now_s)
    }
}

impl StatusBoard {
    /// Creates an empty status.
    pub fn new(clock: Arc<dyn Clock>) -> Self {
        let status = DaemonStatus {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            started: Some(clock.stamp()),
            ..DaemonStatus::default()
        };
        let (frames, series, beats) = (
            FrameMonitor::default(),
            RecentResults::for_series(),
            Beats::default(),
        );
        let (storage, faults) = (StorageMonitor::default(), Faults::default());
        let state = BoardState {
            status,
            frames,
            live: None,
            series,
            storage,
            faults,
            next_series_at_s: None,
            beats,
        };
        Self {
            clock,
            state: Arc::new(Mutex::new(state)),
            live: Arc::default(),
        }
    }

    /// Shows the results of live mode on the pages.
    pub(crate) fn show_live(&self, results: Arc<dyn LiveResults>) {
        // Live mode starts once.
        let _ = self.live.set(results);
    }

    /// Returns the current status.
    pub fn snapshot(&self) -> DaemonStatus {
        let now = self.clock.stamp();
        let now_s = now.since_boot_s;
        self.with_state(|state| {
            let mut status = state.status.clone();
            (status.health, status.reasons) = state.evaluate_health(now_s);
            status.age_s = state
                .live
                .as_ref()
                .map_or(&state.series, |live| &live.results)
                .age_s(now_s);
            status.recent = RecentShares {
                skipped: None,
                ..state.series.shares()
            };
            if let (Some(live_status), Some(live)) = (&mut status.live, &state.live) {
                (live_status.interval_s, live_status.recent) =
                    (Some(live.interval_s), live.results.shares());
                live_status.fault = state.faults.first_of(LIVE_PARTS);
            }
            if let Some(aircraft) = &mut status.aircraft {
                aircraft.fault = state.faults.first_of(AIRCRAFT_PART.0);
            }
            status.faults = state
                .faults
                .current()
                .map(|(part, what)| (faults::name(part), what.to_owned()))
                .collect();
            status.last_frame_age_s = state.frames.age_s(now_s);
            status.next_series_s = state.next_series_at_s.map(|at| (at - now_s).max(0.0));
            status.now = Some(now.clone());
            status
        })
    }

    /// Returns the current health without its reasons.
    pub(crate) fn health(&self) -> Health {
        let now_s = self.seconds_since_boot();
        self.with_state(|state| state.evaluate_health(now_s).0)
    }

    fn seconds_since_boot(&self) -> f64 {
        self.clock.since_boot().as_secs_f64()
    }

    /// Sets the interval at which live results are expected from now on.
    pub(crate) fn expect_results(&self, interval: Duration) {
        let (now_s, interval_s) = (self.seconds_since_boot(), interval.as_secs_f64());
        self.with_state(|state| match &mut state.live {
            Some(live) => live.interval_s = interval_s,
            none => *none = Some(LiveMonitor::new(interval_s, now_s)),
        });
    }

    /// Adds a live result of a frame exposed at `at_s` since boot; `skipped`: frames skipped since the start.
    pub(crate) fn add_live_result(
        &self,
        at_s: f64,
        (solved, rejected): (bool, bool),
        skipped: u64,
    ) {
        self.with_state(|state| {
            if let Some(live) = &mut state.live {
                live.results.add_result(at_s, solved, rejected, skipped);
            }
        });
    }

    /// Adds the result of a frame of a series.
    pub(crate) fn add_series_result(&self, solved: bool, rejected: bool) {
        let now_s = self.seconds_since_boot();
        self.with_state(|state| state.series.add_result(now_s, solved, rejected, 0));
    }

    /// Updates the status with `f`.
    pub(crate) fn update<T>(&self, f: impl FnOnce(&mut DaemonStatus) -> T) -> T {
        self.with_state(|state| f(&mut state.status))
    }

    /// Sets or clears the fault of a part of the recorder. A lasting one is logged at growing intervals.
    pub(crate) fn set_fault(&self, part: Part, fault: Option<String>) {
        let now_s = self.seconds_since_boot();
        if self.with_state(|state| state.faults.set(part, fault.clone(), now_s)) {
            self.note_fault(&fault.unwrap_or_default());
        }
    }

    /// Notes that live results wait to be stored, or that all of them are.
    pub(crate) fn note_live_storage(&self, waiting: bool) {
        let now_s = self.seconds_since_boot();
        self.with_state(|state| state.storage.live.set_waiting(waiting, now_s));
    }

    /// Sets the number of frames of series that wait to be solved; `stored`: one of them has its result now.
    pub(crate) fn note_unsolved(&self, count: usize, stored: bool) {
        let now_s = self.seconds_since_boot();
        self.with_state(|state| {
            if stored {
                state.storage.series.set_waiting(false, now_s);
            }
            state.storage.series.set_waiting(count > 0, now_s);
            state.status.to_solve = count;
        });
    }

    /// Updates the status of live mode with `f`.
    pub(crate) fn update_live(&self, f: impl FnOnce(&mut LiveStatus)) {
        self.update(|status| f(status.live.get_or_insert_default()));
    }

    /// Sets the interval at which good frames are expected.
    pub(crate) fn expect_frames(&self, interval: Duration) {
        let now_s = self.seconds_since_boot();
        self.with_state(|state| state.frames.expect_every(interval.as_secs_f64(), now_s));
    }

    /// Notes a good frame, stored or not: the camera works.
    pub(crate) fn note_frame(&self, stamp: &Stamp) {
        self.with_state(|state| state.frames.note_frame(stamp.since_boot_s));
    }

    pub(crate) fn note_stored_frame(&self, stamp: &Stamp) {
        self.note_frame(stamp);
        self.update(|status| status.counts.frames += 1);
    }

    pub(crate) fn set_next_series(&self, wait: Option<Duration>) {
        let now_s = self.seconds_since_boot();
        self.with_state(|state| {
            state.next_series_at_s = wait.map(|wait| now_s + wait.as_secs_f64())
        });
    }

    pub(crate) fn note_fault(&self, fault: &str) {
        let note = FaultNote {
            stamp: self.clock.stamp(),
            what: fault.to_owned(),
        };
        self.update(|status| status.last_fault = Some(note));
    }

    /// Counts a step of the recorder.
    pub(crate) fn beat(&self) {
        self.with_state(|state| state.beats.recorder += 1);
    }

    /// Counts a step of the processing; `busy`: it has work.
    pub(crate) fn beat_processing(&self, busy: bool) {
        self.with_state(|state| {
            state.beats.processing += 1;
            state.beats.processing_busy = busy;
        });
    }

    /// Returns the counts of steps of recorder and processing, by which the watchdog sees that they run.
    pub(crate) fn beats(&self) -> Beats {
        self.with_state(|state| state.beats)
    }

    fn with_state<T>(&self, f: impl FnOnce(&mut BoardState) -> T) -> T {
        f(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Recorder for StatusBoard {
    fn state(&self) -> RecorderState {
        let status = self.snapshot();
        RecorderState {
            health: variant_name(status.health).to_owned(),
            is_healthy: status.health == Health::Ok,
            activity: variant_name(status.activity).to_owned(),
            reasons: status.reasons.clone(),
            last_fault: status.last_fault.as_ref().map(|fault| fault.what.clone()),
            next_series_s: status.next_series_s,
            reserve_mb: status.store.reserve_mb,
            status: serde_json::to_value(&status).unwrap_or_default(),
        }
    }

    fn live(&self) -> Option<Arc<dyn LiveResults>> {
        self.live.get().cloned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::Health;
    use wingd_base::clock::SimulatedClock;

    #[test]
    fn health_is_the_age_of_the_last_good_frame() {
        let clock = Arc::new(SimulatedClock::new(
            "b",
            "2026-03-01T06:00:00Z".parse().unwrap(),
            None,
        ));
        let board = StatusBoard::new(clock.clone());
        board.expect_frames(Duration::from_secs(3600));
        assert_eq!(
            (board.snapshot().health, board.snapshot().last_frame_age_s),
            (Health::Ok, None)
        );
        board.note_stored_frame(&clock.stamp());
        clock.sleep(Duration::from_secs(5000));
        assert_eq!(board.snapshot().health, Health::Ok);
        assert_eq!(board.snapshot().last_frame_age_s, Some(5000.0));
        clock.sleep(Duration::from_secs(500));
        assert_eq!(board.snapshot().health, Health::Failed);
    }

    #[test]
    fn without_any_frame_health_turns_failed_too() {
        let clock = Arc::new(SimulatedClock::new(
            "b",
            "1970-01-01T00:00:30Z".parse().unwrap(),
            None,
        ));
        let board = StatusBoard::new(clock.clone());
        board.expect_frames(Duration::from_secs(3600));
        clock.sleep(Duration::from_secs(5500));
        assert_eq!(board.snapshot().health, Health::Failed);
    }
}
