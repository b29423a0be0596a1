//! Detects events in the results, whose raw frames are kept. Pure.

use super::config::KeepConfig;
use wingd_evaluation::pipeline::live::LiveResult;

/// Time constant of the mean from which a departure counts, s.
const MEAN_TIME_S: f64 = 60.0;
/// Minimum time from the first result until the mean is used, s.
const MIN_MEAN_AGE_S: f64 = 10.0;
/// Maximum time between two results from which a rate is computed, s.
const MAX_RATE_GAP_S: f64 = 1.0;

/// Detects events in consecutive results.
pub(crate) struct EventDetector {
    keep: KeepConfig,
    /// Last exposure since boot, s, and deflection, m.
    last: Option<(f64, f64)>,
    mean_m: f64,
    since_s: f64,
}

impl EventDetector {
    /// Creates a detector of events without a history.
    pub fn new(keep: KeepConfig) -> Self {
        Self {
            keep,
            last: None,
            mean_m: 0.0,
            since_s: 0.0,
        }
    }

    /// Returns the reason if this result is an event.
    pub fn detect(&mut self, result: &LiveResult) -> Option<String> {
        let at_s = result.exposure.exposure_since_boot_s;
        let gust = result
            .tip_deflection_m()
            .and_then(|deflection_m| self.detect_gust(at_s, deflection_m));
        if result.tracked.mount_disturbed && self.keep.mount_disturbed {
            return Some("the camera mount was disturbed".to_owned());
        }
        if result.is_rejected() && self.keep.rejected {
            return Some("a frame was rejected by the global test".to_owned());
        }
        gust
    }

    fn detect_gust(&mut self, at_s: f64, deflection_m: f64) -> Option<String> {
        let last = self.last.replace((at_s, deflection_m));
        let Some((before_s, before_m)) = last else {
            (self.mean_m, self.since_s) = (deflection_m, at_s);
            return None;
        };
        let elapsed_s = at_s - before_s;
        if elapsed_s <= 0.0 {
            return None;
        }
        let rate = (deflection_m - before_m) / elapsed_s;
        let departure = deflection_m - self.mean_m;
        self.mean_m +=
            departure * (1.0 - (-elapsed_s / MEAN_TIME_S.min(at_s - self.since_s)).exp());
        let beyond =
            |value: f64, limit: Option<f64>| limit.is_some_and(|limit| value.abs() > limit);
        if elapsed_s <= MAX_RATE_GAP_S && beyond(rate, self.keep.tip_rate_m_s) {
            return Some(format!("the tip moved at {rate:.2} m/s"));
        }
        (at_s - self.since_s >= MIN_MEAN_AGE_S && beyond(departure, self.keep.tip_departure_m))
            .then(|| format!("the tip's deflection was {departure:+.2} m from its mean"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch(rate: Option<f64>, departure: Option<f64>) -> EventDetector {
        EventDetector::new(KeepConfig {
            tip_rate_m_s: rate,
            tip_departure_m: departure,
            ..KeepConfig::default()
        })
    }

    #[test]
    fn a_gust_is_fast_or_far() {
        let mut fast = watch(Some(1.0), None);
        let mut far = watch(None, Some(0.3));
        let level = |k: u32| 2.0 + 0.01 * f64::from(k % 2);
        for k in 0..300 {
            let at = f64::from(k) * 0.1;
            assert_eq!(
                (
                    fast.detect_gust(at, level(k)),
                    far.detect_gust(at, level(k))
                ),
                (None, None),
                "{k}"
            );
        }
        assert!(
            fast.detect_gust(30.0, 2.2)
                .is_some_and(|why| why.contains("m/s"))
        );
        assert!(far.detect_gust(30.0, 2.2).is_none());
        assert!(
            far.detect_gust(30.1, 2.4)
                .is_some_and(|why| why.contains("+0.39 m")),
            "{}",
            far.mean_m
        );
        assert!(
            fast.detect_gust(60.0, 0.0).is_none(),
            "no rate across a gap"
        );
    }
}
