//! Differences of many pictures -> what is known of a delay.

/// A screen, as far as its light comes later than the clock was read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Screen {
    /// From one of its frames to the next, s.
    pub refresh_s: f64,
    /// From reading the clock to the light in the row of the fastest bits, just above the middle of the screen, s.
    pub latency_s: f64,
    /// Its standard deviation, s: the same in every picture.
    pub latency_sigma_s: f64,
}

impl Screen {
    /// From the tick's time shown to the light's: a frame stands for a whole refresh.
    pub fn display_delay_s(&self) -> f64 {
        self.latency_s + 0.5 * self.refresh_s
    }

    /// Standard deviation of the phase in which a picture meets the refresh, s.
    fn phase_s(&self) -> f64 {
        self.refresh_s / 12f64.sqrt()
    }

    /// Standard deviation of one picture's time, s, latency left out: anywhere in `width_s`, in any phase of the refresh.
    pub fn read_sigma_s(&self, width_s: f64) -> f64 {
        (width_s / 12f64.sqrt()).hypot(self.phase_s())
    }

    /// Standard deviation of what may be the same in all pictures, s: the latency, and the phase of the refresh where they come at
    /// a fixed rate.
    pub fn systematic_s(&self) -> f64 {
        self.latency_sigma_s.hypot(self.phase_s())
    }
}

/// A delay from several pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DelayEstimate {
    /// Pictures.
    pub pictures: usize,
    /// Mean, s.
    pub mean_s: f64,
    /// Standard deviation of the mean, what is the same in all pictures included, s.
    pub mean_sigma_s: f64,
    /// Standard deviation of one picture about the mean, s; `None` for one picture.
    pub scatter_s: Option<f64>,
    /// The scatter that reading the pictures alone makes, s.
    pub read_sigma_s: f64,
    /// To what the delay of a picture to come is known: the mean's standard deviation, and the scatter beyond the reading, to
    /// its upper standard deviation, s; `None` for one picture.
    pub sigma_s: Option<f64>,
}

/// From each picture's delay and the standard deviation of its reading, s; `None` without pictures.
pub fn estimate_delay(pictures: &[(f64, f64)], systematic_s: f64) -> Option<DelayEstimate> {
    let n = pictures.len() as f64;
    let mean = |of: &dyn Fn(&(f64, f64)) -> f64| pictures.iter().map(of).sum::<f64>() / n;
    let (mean_s, read2) = (mean(&|p| p.0), mean(&|p| p.1 * p.1));
    let freedom = n - 1.0;
    let scatter2 = (freedom > 0.0).then(|| mean(&|p| (p.0 - mean_s).powi(2)) * n / freedom);
    let mean_sigma_s = (scatter2.unwrap_or(read2).max(read2) / n).sqrt().hypot(systematic_s);
    // A variance from n pictures has the standard deviation sqrt(2 / (n - 1)) of itself.
    let own2 = |scatter2: f64| (scatter2 - read2 + (2.0 / freedom).sqrt() * read2).max(0.0);
    (n > 0.0).then(|| DelayEstimate {
        pictures: pictures.len(),
        mean_s,
        mean_sigma_s,
        scatter_s: scatter2.map(f64::sqrt),
        read_sigma_s: read2.sqrt(),
        sigma_s: scatter2.map(|scatter2| own2(scatter2).sqrt().hypot(mean_sigma_s)),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn scatter_beyond_the_reading_is_the_delays_own() {
        let jumps = |far: f64| {
            (0..200u32)
                .map(|k| (0.05 + if k.is_multiple_of(2) { far } else { -far }, 0.005))
                .collect::<Vec<_>>()
        };
        let found = estimate_delay(&jumps(0.02), 0.0).unwrap();
        assert!((found.mean_s - 0.05).abs() < 1e-12);
        assert!((found.sigma_s.unwrap() - (0.02f64.powi(2) - 0.005f64.powi(2)).sqrt()).abs() < 3e-4);
        let still = estimate_delay(&jumps(0.005), 0.01).unwrap();
        assert!((still.mean_sigma_s - 0.01).abs() < 1e-4 && still.sigma_s.unwrap() < 0.011);
        assert_eq!(estimate_delay(&[], 0.0), None);
        let one = estimate_delay(&[(0.05, 0.005)], 0.0).unwrap();
        assert_eq!((one.sigma_s, one.scatter_s, one.mean_sigma_s), (None, None, 0.005));
    }
}
