//! Lowers the frame rate of a processor that is too hot, down to a pause. Pure.

/// Difference below the limit at which the rate is raised again, degrees.
const HYSTERESIS_C: f64 = 5.0;
/// Time until a change of the rate shows in the temperature, s.
const SETTLING_S: f64 = 20.0;
/// Rate below which frames pause, Hz.
const MIN_RATE_HZ: f64 = 1.0;

/// Frame rate as limited by the temperature.
pub(crate) struct Governor {
    wanted_hz: f64,
    limit_c: Option<f64>,
    allowed_hz: f64,
    changed_s: f64,
}

impl Governor {
    /// Creates a governor for a wanted rate, Hz, and a temperature limit, degrees Celsius.
    pub fn new(wanted_hz: f64, limit_c: Option<f64>) -> Self {
        Self {
            wanted_hz,
            limit_c,
            allowed_hz: wanted_hz,
            changed_s: f64::NEG_INFINITY,
        }
    }

    /// Returns the allowed frames per second; 0: frames pause.
    pub fn allowed_hz(&self) -> f64 {
        self.allowed_hz
    }

    /// Returns whether a temperature limit is configured.
    pub fn has_limit(&self) -> bool {
        self.limit_c.is_some()
    }

    /// Updates the rate from the highest temperature, degrees Celsius. Returns whether the rate changed.
    pub fn update(&mut self, now_s: f64, temperature_c: Option<f64>) -> bool {
        let (Some(limit), Some(now_c)) = (self.limit_c, temperature_c) else {
            return false;
        };
        if now_s - self.changed_s < SETTLING_S {
            return false;
        }
        let allowed_hz = if now_c > limit {
            let half = 0.5 * self.allowed_hz;
            if half < MIN_RATE_HZ.min(self.wanted_hz) {
                0.0
            } else {
                half
            }
        } else if now_c < limit - HYSTERESIS_C {
            (2.0 * self.allowed_hz).max(MIN_RATE_HZ).min(self.wanted_hz)
        } else {
            self.allowed_hz
        };
        if allowed_hz == self.allowed_hz {
            return false;
        }
        (self.allowed_hz, self.changed_s) = (allowed_hz, now_s);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heat_lowers_the_rate_then_pauses_and_cold_brings_it_back() {
        let mut governor = Governor::new(10.0, Some(80.0));
        let mut rates = vec![];
        for (step, temperature) in [
            (0, 85.0),
            (1, 85.0),
            (2, 85.0),
            (3, 85.0),
            (4, 85.0),
            (5, 78.0),
            (6, 70.0),
        ] {
            governor.update(f64::from(step) * 30.0, Some(temperature));
            rates.push(governor.allowed_hz());
        }
        assert_eq!(rates, [5.0, 2.5, 1.25, 0.0, 0.0, 0.0, 1.0]);
        for step in 7..12 {
            governor.update(f64::from(step) * 30.0, Some(60.0));
        }
        assert_eq!(governor.allowed_hz(), 10.0);
        assert!(!governor.update(1e3, None) && !Governor::new(10.0, None).update(0.0, Some(200.0)));
        assert!(
            governor.update(1e3, Some(81.0)) && !governor.update(1001.0, Some(90.0)),
            "it waits for its effect"
        );
    }
}
