//! Status of the daemon. Its threads write one [`DaemonStatus`] through a [`StatusBoard`]; clients of the socket and of the
//! page get a copy, as JSON or as Prometheus metrics.

mod board;
mod faults;
mod health;
mod recent;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use wingd_base::clock::Stamp;

pub use board::StatusBoard;
pub(crate) use faults::{
    AIRCRAFT_PART, LIVE_PARTS, PAGE_PART, RESULTS_PART, SIGNING_PART, SOLVER_PART, STATUS_PART,
};
pub use health::{Health, format_span};
pub use recent::RecentShares;

/// Current activity of the daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activity {
    /// The daemon is starting.
    #[default]
    Starting,
    /// Waiting for the next series.
    Waiting,
    /// Taking live frames until the next series.
    Live,
    /// Taking a series.
    Capturing,
    /// Solving the remaining frames; no more series are taken.
    Finishing,
    /// Stopping on request.
    Stopping,
    /// Power failure: everything is durable, and nothing begins until the power is back.
    #[serde(rename = "power_failing")]
    PowerFailing,
}

/// Status of the daemon.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct DaemonStatus {
    /// Version of wingd.
    pub version: String,
    pub activity: Activity,
    pub health: Health,
    /// Reasons why health is not ok, the most severe first.
    #[serde(default)]
    pub reasons: Vec<String>,
    /// Age of the last result, s: in live mode since the exposure of the last live result, otherwise since the last result
    /// of a series. `null` before the first.
    #[serde(default)]
    pub age_s: Option<f64>,
    /// Start of the daemon.
    pub started: Option<Stamp>,
    /// Time of this status.
    pub now: Option<Stamp>,
    /// The newest flight.
    pub flight: Option<String>,
    /// The last series begun.
    pub series: Option<String>,
    /// Shots attempted in that series.
    pub shot: u32,
    pub shots_per_series: u32,
    /// Time until the next scheduled series, s.
    pub next_series_s: Option<f64>,
    /// Time since the last good frame, s; `null` if there was none since the start.
    pub last_frame_age_s: Option<f64>,
    /// Counts since the start.
    pub counts: Counts,
    /// Frames that wait to be solved.
    pub to_solve: usize,
    /// Shares of the last results of series.
    #[serde(default)]
    pub recent: RecentShares,
    pub camera: CameraStatus,
    pub store: StoreStatus,
    /// Aircraft data feed; `null` if none is configured.
    #[serde(default)]
    pub aircraft: Option<AircraftStatus>,
    /// Live mode; `null` if it is off.
    #[serde(default)]
    pub live: Option<LiveStatus>,
    /// Current faults, by the part of the recorder that does not work.
    #[serde(default)]
    pub faults: BTreeMap<String, String>,
    pub last_fault: Option<FaultNote>,
}

/// Counts since the daemon's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Counts {
    /// Frames made durable.
    pub frames: u64,
    /// Shots without a frame.
    pub failed_shots: u64,
    /// Failed attempts, whether or not another attempt succeeded.
    pub failed_attempts: u64,
    /// Failed attempts in which an old frame was delivered.
    pub stale_frames: u64,
    /// Camera calls that did not return and were abandoned.
    pub hangs: u64,
    pub series_complete: u64,
    pub series_interrupted: u64,
    /// Series refused by the store.
    pub series_refused: u64,
    /// Frames solved.
    pub solved: u64,
    /// Frames that could not be solved; the reasons are in the results.
    pub unsolvable: u64,
    /// Unsolvable frames whose solver was abandoned at its deadline.
    #[serde(default)]
    pub solver_hangs: u64,
}

/// Status of the camera.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct CameraStatus {
    /// Name that the camera reports.
    pub name: Option<String>,
    /// True if the camera is open now.
    pub open: bool,
    /// Settings that differ from the configuration.
    pub warnings: Vec<String>,
    /// Camera calls that still hang.
    pub hanging_calls: usize,
}

/// Directory and free space of the store.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct StoreStatus {
    /// Directory of the store.
    pub path: String,
    pub free_mb: Option<u64>,
    pub reserve_mb: u64,
    /// Reason why the store refused the last series; `null` if it accepted it.
    #[serde(default)]
    pub refuses: Option<String>,
    /// Reason why the last series could not be closed; `null` if it was.
    #[serde(default)]
    pub unclosed: Option<String>,
    /// Number of series in `incoming/` that are not under way.
    #[serde(default)]
    pub stranded: usize,
}

/// A fault with its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FaultNote {
    pub stamp: Stamp,
    /// Fault in words.
    pub what: String,
}

/// Status of the aircraft data feed.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct AircraftStatus {
    /// Lines recorded.
    pub recorded: u64,
    /// Recorded lines that could be parsed.
    pub read: u64,
    /// Parsed lines whose time tag is impossible: ahead of its receipt, or far behind it. No frame uses them.
    #[serde(default)]
    pub impossible: u64,
    /// Received lines that were not recorded: too many at once, or a full disk.
    pub lost: u64,
    /// Time of the last line.
    pub last: Option<Stamp>,
    /// Current fault of the feed; `null` if there is none.
    pub fault: Option<String>,
}

/// Status of live mode since the start.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LiveStatus {
    /// Configured frames per second.
    pub wanted_hz: f64,
    /// Results per second over the last ten seconds.
    pub rate_hz: f64,
    /// Expected time from one result to the next, s; longer during a series.
    pub interval_s: Option<f64>,
    /// Shares of the last results, over ten seconds.
    pub recent: RecentShares,
    /// Frames taken.
    pub frames: u64,
    /// Frames that the camera did not deliver.
    pub failed_shots: u64,
    /// Results, with numbers or without.
    pub results: u64,
    /// Results without numbers.
    pub unsolvable: u64,
    /// Results from a full search of the frame.
    pub full_searches: u64,
    /// Frames that were not solved because the next one had come.
    pub skipped: u64,
    /// Frames abandoned because the solver did not return in time.
    pub solver_hangs: u64,
    /// Number of mount disturbances of the camera.
    pub mount_disturbances: u64,
    /// Median of the latency from exposure to result over the last minute, ms.
    pub latency_median_ms: Option<f64>,
    /// 95th percentile of the latency from exposure to result over the last minute, ms.
    pub latency_p95_ms: Option<f64>,
    /// Results made durable.
    pub stored: u64,
    /// Results that were not stored because the disk was too slow or too full.
    pub dropped: u64,
    /// Lines lost because listeners at the socket were too slow.
    pub lines_lost: u64,
    /// Datagrams sent.
    pub datagrams: u64,
    /// Datagrams that the network refused.
    pub datagrams_lost: u64,
    /// Raw frames kept.
    pub kept_frames: u64,
    /// Raw frames of an event for which memory had no space.
    pub lost_frames: u64,
    pub events: u64,
    /// Current fault of live mode; `null` if there is none.
    pub fault: Option<String>,
}
