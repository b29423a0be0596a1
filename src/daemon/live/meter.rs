//! Measures rate and latency of the last results for the status.

use std::collections::VecDeque;

/// Rate and latency of the last results.
#[derive(Default)]
pub(crate) struct Meter {
    /// Time since boot, s, and latency, ms.
    last: VecDeque<(f64, f64)>,
}

/// Time over which latencies are evaluated, s.
const LATENCY_WINDOW_S: f64 = 60.0;
/// Time over which the rate is evaluated, s.
const RATE_WINDOW_S: f64 = 10.0;
/// Maximum number of remembered results.
const MAX_RESULTS: usize = 6000;

impl Meter {
    /// Adds a result that came `now_s` since boot.
    pub fn add_result(&mut self, now_s: f64, latency_ms: f64) {
        self.last.push_back((now_s, latency_ms));
        let old = |entry: &&(f64, f64)| now_s - entry.0 > LATENCY_WINDOW_S;
        let gone = self
            .last
            .iter()
            .take_while(old)
            .count()
            .max(self.last.len().saturating_sub(MAX_RESULTS));
        self.last.drain(..gone);
    }

    /// Returns the results per second.
    pub fn rate_hz(&self, now_s: f64) -> f64 {
        let recent: Vec<f64> = self
            .last
            .iter()
            .map(|e| e.0)
            .filter(|at| now_s - at <= RATE_WINDOW_S)
            .collect();
        match (recent.first(), recent.len()) {
            (Some(first), 2..) => (recent.len() - 1) as f64 / (now_s - first).max(1e-3),
            _ => 0.0,
        }
    }

    /// Returns the quantile `share` of the latency, ms.
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
            meter.add_result(f64::from(k) * 0.1, f64::from(k % 100));
        }
        assert!(
            (meter.rate_hz(99.9) - 10.0).abs() < 0.2,
            "{}",
            meter.rate_hz(99.9)
        );
        assert_eq!(meter.last.len(), 601);
        assert!(
            meter
                .latency_ms(0.95)
                .is_some_and(|ms| (93.0..=96.0).contains(&ms)),
            "{:?}",
            meter.latency_ms(0.95)
        );
        assert_eq!(meter.rate_hz(200.0), 0.0);
    }
}
