//! Live mode as the status shows it.

use std::collections::VecDeque;

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

/// Rate and latency of the last results.
#[derive(Default)]
pub(crate) struct Meter {
    /// When, since boot, s; how late, ms.
    last: VecDeque<(f64, f64)>,
}

/// Latencies are told of this time, s.
const LATENCY_OF_S: f64 = 60.0;
/// The rate is told of this time, s.
const RATE_OF_S: f64 = 10.0;
/// Results that are remembered at most.
const MOST: usize = 6000;

impl Meter {
    /// A result that came `now_s` since boot.
    pub fn note(&mut self, now_s: f64, latency_ms: f64) {
        self.last.push_back((now_s, latency_ms));
        let old = |entry: &&(f64, f64)| now_s - entry.0 > LATENCY_OF_S;
        let gone = self.last.iter().take_while(old).count().max(self.last.len().saturating_sub(MOST));
        self.last.drain(..gone);
    }

    /// Results a second.
    pub fn rate_hz(&self, now_s: f64) -> f64 {
        let recent: Vec<f64> = self.last.iter().map(|e| e.0).filter(|at| now_s - at <= RATE_OF_S).collect();
        match (recent.first(), recent.len()) {
            (Some(first), 2..) => (recent.len() - 1) as f64 / (now_s - first).max(1e-3),
            _ => 0.0,
        }
    }

    /// The latency that this share of the results keeps, ms.
    pub fn latency_ms(&self, share: f64) -> Option<f64> {
        let mut all: Vec<f64> = self.last.iter().map(|e| e.1).collect();
        all.sort_unstable_by(f64::total_cmp);
        let at = (share * all.len() as f64).ceil() as usize;
        all.get(at.saturating_sub(1)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_and_latency_are_those_of_the_last_results() {
        let mut meter = Meter::default();
        assert_eq!((meter.rate_hz(0.0), meter.latency_ms(0.95)), (0.0, None));
        for k in 0..1000 {
            meter.note(f64::from(k) * 0.1, f64::from(k % 100));
        }
        assert!((meter.rate_hz(99.9) - 10.0).abs() < 0.2, "{}", meter.rate_hz(99.9));
        assert_eq!(meter.last.len(), 601);
        assert!(
            meter.latency_ms(0.95).is_some_and(|ms| (93.0..=96.0).contains(&ms)),
            "{:?}",
            meter.latency_ms(0.95)
        );
        assert_eq!(meter.rate_hz(200.0), 0.0);
    }
}
