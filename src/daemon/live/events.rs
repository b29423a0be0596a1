//! An event in the results has its raw frames kept. Pure.

use super::config::KeepConfig;
use super::result::LiveResult;

/// The mean that a departure counts from is of about this time, s.
const MEAN_OF_S: f64 = 60.0;
/// Before it is a mean, s.
const YOUNG_S: f64 = 10.0;
/// Two results farther apart than this tell no rate, s.
const APART_S: f64 = 1.0;

/// Looks at one result after the other.
pub(crate) struct Watch {
    keep: KeepConfig,
    /// Exposure since boot, s, and deflection, m.
    last: Option<(f64, f64)>,
    mean_m: f64,
    since_s: f64,
}

impl Watch {
    pub fn new(keep: KeepConfig) -> Self {
        Self { keep, last: None, mean_m: 0.0, since_s: 0.0 }
    }

    /// Why this result is an event, in words.
    pub fn look(&mut self, result: &LiveResult) -> Option<String> {
        let at_s = result.exposure.exposure_since_boot_s;
        let gust = result.tip_deflection_m().and_then(|deflection_m| self.gust(at_s, deflection_m));
        if result.mount_disturbed && self.keep.mount_disturbed {
            return Some("the camera mount was disturbed".to_owned());
        }
        if result.rejected() && self.keep.rejected {
            return Some("the global test of a frame rejected".to_owned());
        }
        gust
    }

    fn gust(&mut self, at_s: f64, deflection_m: f64) -> Option<String> {
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
        self.mean_m += departure * (1.0 - (-elapsed_s / MEAN_OF_S.min(at_s - self.since_s)).exp());
        let beyond = |value: f64, limit: Option<f64>| limit.is_some_and(|limit| value.abs() > limit);
        if elapsed_s <= APART_S && beyond(rate, self.keep.tip_rate_m_s) {
            return Some(format!("the tip moved at {rate:.2} m/s"));
        }
        (at_s - self.since_s >= YOUNG_S && beyond(departure, self.keep.tip_departure_m))
            .then(|| format!("the tip's deflection was {departure:+.2} m from its mean"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch(rate: Option<f64>, departure: Option<f64>) -> Watch {
        Watch::new(KeepConfig { tip_rate_m_s: rate, tip_departure_m: departure, ..KeepConfig::default() })
    }

    #[test]
    fn a_gust_is_fast_or_far() {
        let mut fast = watch(Some(1.0), None);
        let mut far = watch(None, Some(0.3));
        let level = |k: u32| 2.0 + 0.01 * f64::from(k % 2);
        for k in 0..300 {
            let at = f64::from(k) * 0.1;
            assert_eq!((fast.gust(at, level(k)), far.gust(at, level(k))), (None, None), "{k}");
        }
        assert!(fast.gust(30.0, 2.2).is_some_and(|why| why.contains("m/s")));
        assert!(far.gust(30.0, 2.2).is_none());
        assert!(far.gust(30.1, 2.4).is_some_and(|why| why.contains("+0.39 m")), "{}", far.mean_m);
        assert!(fast.gust(60.0, 0.0).is_none(), "a gap tells no rate");
    }
}
