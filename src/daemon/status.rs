//! What the daemon tells about itself: one struct, written by its threads, read by whoever asks.

use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use super::aircraft::AircraftStatus;
use super::live::LiveStatus;
use super::pulse::Beats;
use crate::clock::{Clock, Stamp};

/// What the daemon is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activity {
    /// Not yet at work.
    #[default]
    Starting,
    /// For the next series.
    Waiting,
    /// For the next series, taking live frames meanwhile.
    Live,
    /// Taking a series.
    Capturing,
    /// Taking no more series; solving what is left.
    Finishing,
    /// Asked to stop.
    Stopping,
    /// The supply fails: everything is durable, and nothing is begun until it is back.
    #[serde(rename = "power_failing")]
    PowerFailing,
}

/// Whether frames come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Health {
    /// No frame is due yet.
    #[default]
    Young,
    /// The last good frame is younger than one and a half intervals.
    Good,
    /// It is older: the camera needs a look, whatever it answers.
    Stale,
}

/// The daemon's state.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct Status {
    /// Of wingd.
    pub version: String,
    /// Now.
    pub activity: Activity,
    /// By the age of the last good frame.
    pub health: Health,
    /// When the daemon began.
    pub started: Option<Stamp>,
    /// The moment of this status.
    pub now: Option<Stamp>,
    /// The newest flight.
    pub flight: Option<String>,
    /// The last series begun.
    pub series: Option<String>,
    /// Shots tried in it.
    pub shot: u32,
    /// Shots that each series has.
    pub shots_per_series: u32,
    /// Until the next scheduled series, s.
    pub next_series_s: Option<f64>,
    /// Since the last good frame, s; `null` where there was none since the start.
    pub last_frame_age_s: Option<f64>,
    /// Since the start.
    pub counts: Counts,
    /// Frames that wait to be solved, of the series under work.
    pub to_solve: usize,
    /// The camera.
    pub camera: CameraStatus,
    /// The store.
    pub store: StoreStatus,
    /// The aircraft's data; `null` where none are configured.
    #[serde(default)]
    pub aircraft: Option<AircraftStatus>,
    /// Live mode; `null` where it is off.
    #[serde(default)]
    pub live: Option<LiveStatus>,
    /// The last thing that went wrong, in words.
    pub last_fault: Option<Noted>,
}

/// Numbers since the daemon's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Counts {
    /// Frames made durable.
    pub frames: u64,
    /// Shots without a frame.
    pub failed_shots: u64,
    /// Attempts that failed, made good by another attempt or not.
    pub failed_attempts: u64,
    /// Of those, old frames in place of new ones.
    pub stale_frames: u64,
    /// Camera calls that did not return and were given up.
    pub hangs: u64,
    /// Series.
    pub series_complete: u64,
    /// Series.
    pub series_interrupted: u64,
    /// Series that the store did not take.
    pub series_refused: u64,
    /// Frames solved.
    pub solved: u64,
    /// Frames that could not be solved; the reasons are in the results.
    pub unsolvable: u64,
    /// Of those, frames given up because the solver did not return in time.
    #[serde(default)]
    pub solver_hangs: u64,
}

/// The camera, as far as the daemon sees it.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct CameraStatus {
    /// As it names itself.
    pub name: Option<String>,
    /// Open now.
    pub open: bool,
    /// Settings that are not as configured.
    pub warnings: Vec<String>,
    /// Calls that hang still.
    pub hanging_calls: usize,
}

/// The store's place and space.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct StoreStatus {
    /// The directory.
    pub path: String,
    /// MB.
    pub free_mb: Option<u64>,
    /// MB.
    pub reserve_mb: u64,
}

/// Something with its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noted {
    /// When.
    pub stamp: Stamp,
    /// What.
    pub what: String,
}

/// The board that the threads write on. Cheap to clone; all clones are the same board.
#[derive(Clone)]
pub struct Board {
    clock: Arc<dyn Clock>,
    state: Arc<Mutex<State>>,
}

#[derive(Default)]
struct State {
    status: Status,
    /// Since boot, s.
    last_frame_s: Option<f64>,
    next_series_at_s: Option<f64>,
    /// A good frame is due by then, since boot, s.
    frame_due_s: Option<f64>,
    beats: Beats,
    interval_s: f64,
}

impl Board {
    /// Blank.
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
        self.with(|state| {
            let mut status = state.status.clone();
            status.last_frame_age_s = state.last_frame_s.map(|at| now.since_boot_s - at);
            status.next_series_s = state.next_series_at_s.map(|at| (at - now.since_boot_s).max(0.0));
            let overdue = state.frame_due_s.is_some_and(|due| now.since_boot_s > due);
            status.health = match (overdue, state.last_frame_s) {
                (true, _) => Health::Stale,
                (false, Some(_)) => Health::Good,
                (false, None) => Health::Young,
            };
            status.now = Some(now.clone());
            status
        })
    }

    /// Changes the status.
    pub(crate) fn update(&self, f: impl FnOnce(&mut Status)) {
        self.with(|state| f(&mut state.status));
    }

    /// A good frame is expected every interval.
    pub(crate) fn expect_frames(&self, interval: std::time::Duration) {
        let now_s = self.clock.since_boot().as_secs_f64();
        self.with(|state| {
            state.interval_s = interval.as_secs_f64();
            state.frame_due_s = Some(now_s + 1.5 * state.interval_s);
        });
    }

    /// A good frame that is not stored: the camera is well.
    pub(crate) fn frame_seen(&self, stamp: &Stamp) {
        self.with(|state| {
            state.last_frame_s = Some(stamp.since_boot_s);
            state.frame_due_s = Some(stamp.since_boot_s + 1.5 * state.interval_s);
        });
    }

    pub(crate) fn frame_stored(&self, stamp: &Stamp) {
        self.frame_seen(stamp);
        self.with(|state| state.status.counts.frames += 1);
    }

    pub(crate) fn next_series_in(&self, wait: Option<std::time::Duration>) {
        let now_s = self.clock.since_boot().as_secs_f64();
        self.with(|state| state.next_series_at_s = wait.map(|wait| now_s + wait.as_secs_f64()));
    }

    pub(crate) fn fault(&self, what: &str) {
        let noted = Noted { stamp: self.clock.stamp(), what: what.to_owned() };
        self.with(|state| state.status.last_fault = Some(noted));
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
    use std::time::Duration;

    #[test]
    fn health_is_the_age_of_the_last_good_frame() {
        let clock = Arc::new(Simulated::new("b", "2026-03-01T06:00:00Z".parse().unwrap(), None));
        let board = Board::new(clock.clone());
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
        let board = Board::new(clock.clone());
        board.expect_frames(Duration::from_secs(3600));
        clock.sleep(Duration::from_secs(5500));
        assert_eq!(board.snapshot().health, Health::Stale);
    }
}
