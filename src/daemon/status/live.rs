//! What the status says of live mode.

use serde::{Deserialize, Serialize};

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
    /// Frames taken.
    pub frames: u64,
    /// Frames that the camera did not deliver.
    pub failed_shots: u64,
    /// Results, with numbers or without.
    pub results: u64,
    /// Of those, without.
    pub unsolvable: u64,
    /// Of the results, those whose whole frame was searched.
    pub whole_searches: u64,
    /// Frames that were not solved because the next had come.
    pub skipped: u64,
    /// Frames given up because the solver did not return in time.
    pub solver_hangs: u64,
    /// Times that the camera was jolted.
    pub jolts: u64,
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
