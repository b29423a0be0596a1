//! What the daemon says of itself. The daemon's threads write one [`Status`] by way of a [`StatusBoard`], and whoever asks
//! at the socket or the page gets a copy, as JSON or as Prometheus metrics.

mod board;
mod health;
mod metrics;
mod recent;

use serde::{Deserialize, Serialize};

use crate::clock::Stamp;

pub use board::StatusBoard;
pub use health::{Health, span};
pub(crate) use metrics::exposition;
pub use recent::Recent;

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

/// The daemon's state.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct Status {
    /// Of wingd.
    pub version: String,
    /// Now.
    pub activity: Activity,
    /// In one word.
    pub health: Health,
    /// Why it is not good, the worst first.
    #[serde(default)]
    pub reasons: Vec<String>,
    /// Of the last result, s: of live mode, where it is on, since its exposure; else since a series' result came. `null` before
    /// the first.
    #[serde(default)]
    pub age_s: Option<f64>,
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
    /// The last results of series.
    #[serde(default)]
    pub recent: Recent,
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
    /// Why it took the last series not; `null` where it took it.
    #[serde(default)]
    pub refuses: Option<String>,
}

/// Something with its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noted {
    /// When.
    pub stamp: Stamp,
    /// What.
    pub what: String,
}

/// The feed as the status shows it.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct AircraftStatus {
    /// Lines recorded.
    pub recorded: u64,
    /// Of those, lines that could be read.
    pub read: u64,
    /// Of those, lines whose time tag cannot be true: ahead of its receipt, or far behind it. They are joined with no frame.
    #[serde(default)]
    pub impossible: u64,
    /// Lines that came and were not recorded: too many at once, or a full disk.
    pub lost: u64,
    /// When the last one came.
    pub last: Option<Stamp>,
    /// What is wrong with the feed now; `null` where nothing is.
    pub fault: Option<String>,
}

/// Live mode since the start.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LiveStatus {
    /// Frames a second that are asked for.
    pub wanted_hz: f64,
    /// Frames a second that the temperature allows; 0 while they pause.
    pub allowed_hz: f64,
    /// Results a second over the last ten seconds.
    pub rate_hz: f64,
    /// From one result to the next, as it should be, s; longer during a series, `null` while frames pause.
    pub interval_s: Option<f64>,
    /// The last results, over ten seconds.
    pub recent: Recent,
    /// Frames taken.
    pub frames: u64,
    /// Frames that the camera did not deliver.
    pub failed_shots: u64,
    /// Results, with numbers or without.
    pub results: u64,
    /// Of those, without.
    pub unsolvable: u64,
    /// Of the results, those whose whole frame was searched.
    pub full_searches: u64,
    /// Frames that were not solved because the next had come.
    pub skipped: u64,
    /// Frames given up because the solver did not return in time.
    pub solver_hangs: u64,
    /// Times that the camera mount was disturbed.
    pub mount_disturbances: u64,
    /// From exposure to result over the last minute, ms.
    pub latency_median_ms: Option<f64>,
    /// Of 20 results 19 were quicker, ms.
    pub latency_p95_ms: Option<f64>,
    /// Results made durable.
    pub stored: u64,
    /// Results that the disk was too slow or too full for.
    pub dropped: u64,
    /// Lines that listeners at the socket were too slow for.
    pub lines_lost: u64,
    /// Datagrams sent.
    pub datagrams: u64,
    /// Datagrams that the machine did not take.
    pub datagrams_lost: u64,
    /// Raw frames kept.
    pub kept_frames: u64,
    /// Raw frames of an event that memory did not hold.
    pub lost_frames: u64,
    /// Events.
    pub events: u64,
    /// The hottest place, degrees Celsius; `null` where no limit is set or the kernel says nothing.
    pub temperature_c: Option<f64>,
    /// What is wrong now; `null` where nothing is.
    pub fault: Option<String>,
}
