//! Estimate of a camera's delay from the time differences of many images, and test of recorded times.

use crate::adjust::GlobalTest;
use crate::estimation::quality::global_test;

/// Delay of a screen between reading the clock and its light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Screen {
    /// Refresh interval, s.
    pub refresh_s: f64,
    /// Delay from reading the clock to the light in the row of the fastest bits, just above the middle of the screen, s.
    pub latency_s: f64,
    /// Standard deviation of the latency, s: the same error in every image.
    pub latency_sigma_s: f64,
}

impl Screen {
    /// Returns the mean delay from the displayed tick's time to its light, s: a frame is visible for a full refresh.
    pub fn display_delay_s(&self) -> f64 {
        self.latency_s + 0.5 * self.refresh_s
    }

    /// Returns the standard deviation of the phase of an image in the refresh, s.
    fn phase_s(&self) -> f64 {
        self.refresh_s / 12f64.sqrt()
    }

    /// Returns the standard deviation of one image's time, s, without the latency: uniform in `width_s` and in the refresh.
    pub fn read_sigma_s(&self, width_s: f64) -> f64 {
        (width_s / 12f64.sqrt()).hypot(self.phase_s())
    }

    /// Returns the standard deviation of errors common to all images, s: the latency, and the phase of the refresh if the
    /// images have a fixed rate.
    pub fn systematic_s(&self) -> f64 {
        self.latency_sigma_s.hypot(self.phase_s())
    }
}

/// Delay estimated from several images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DelayEstimate {
    /// Number of images.
    pub images: usize,
    pub mean_s: f64,
    /// Standard deviation of the mean, including errors common to all images, s.
    pub mean_sigma_s: f64,
    /// Standard deviation of one image about the mean, s; `None` for one image.
    pub scatter_s: Option<f64>,
    /// Scatter expected from reading the images alone, s.
    pub read_sigma_s: f64,
    /// Standard deviation of the delay of a future image: that of the mean, and an upper limit of the scatter beyond the
    /// reading errors, s; `None` for one image.
    pub sigma_s: Option<f64>,
}

/// Estimates the delay from each image's delay and the standard deviation of its reading, s; `None` without images.
pub fn estimate_delay(images: &[(f64, f64)], systematic_s: f64) -> Option<DelayEstimate> {
    let n = images.len() as f64;
    let mean = |value: &dyn Fn(&(f64, f64)) -> f64| images.iter().map(value).sum::<f64>() / n;
    let (mean_s, read2) = (mean(&|p| p.0), mean(&|p| p.1 * p.1));
    let freedom = n - 1.0;
    let scatter2 = (freedom > 0.0).then(|| mean(&|p| (p.0 - mean_s).powi(2)) * n / freedom);
    let mean_sigma_s = (scatter2.unwrap_or(read2).max(read2) / n)
        .sqrt()
        .hypot(systematic_s);
    // A variance from n images has the relative standard deviation sqrt(2 / (n - 1)).
    let excess2 = |scatter2: f64| (scatter2 - read2 + (2.0 / freedom).sqrt() * read2).max(0.0);
    (n > 0.0).then(|| DelayEstimate {
        images: images.len(),
        mean_s,
        mean_sigma_s,
        scatter_s: scatter2.map(f64::sqrt),
        read_sigma_s: read2.sqrt(),
        sigma_s: scatter2.map(|scatter2| excess2(scatter2).sqrt().hypot(mean_sigma_s)),
    })
}

/// Maximum mean difference between recorded and shown times, in standard deviations, for them to agree.
const MAX_NORMALIZED: f64 = 3.0;
/// Significance level of the test of the scatter.
const SIGNIFICANCE: f64 = 0.001;

/// Test of recorded times of exposure against those shown by a screen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExposureTest {
    /// Recorded exposure minus screen.
    pub difference: DelayEstimate,
    /// Root mean square of the recorded standard deviations, s.
    pub recorded_s: f64,
    /// Mean difference divided by its standard deviation, including the recorded one.
    pub normalised: f64,
    pub agrees: bool,
}

impl ExposureTest {
    /// Tests the mean with its standard deviation, assuming that the recorded ones, s, are one error common to all images,
    /// and the scatter with both.
    pub fn new(difference: DelayEstimate, recorded_sigmas_s: &[f64]) -> Self {
        let recorded = recorded_sigmas_s.iter().map(|sigma_s| sigma_s.powi(2));
        let recorded_variance = recorded.sum::<f64>() / recorded_sigmas_s.len().max(1) as f64;
        let normalised =
            difference.mean_s.abs() / (difference.mean_sigma_s.powi(2) + recorded_variance).sqrt();
        let freedom = difference.images.saturating_sub(1);
        let scattered = difference.scatter_s.is_some_and(|scatter_s| {
            let omega = freedom as f64 * scatter_s.powi(2)
                / (difference.read_sigma_s.powi(2) + recorded_variance);
            global_test(omega, freedom, SIGNIFICANCE) == Some(GlobalTest::Rejected)
        });
        let agrees = normalised <= MAX_NORMALIZED && !scattered;
        Self {
            difference,
            recorded_s: recorded_variance.sqrt(),
            normalised,
            agrees,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scatter_beyond_the_reading_error_is_attributed_to_the_delay() {
        let jumps = |far: f64| {
            (0..200u32)
                .map(|k| (0.05 + if k.is_multiple_of(2) { far } else { -far }, 0.005))
                .collect::<Vec<_>>()
        };
        let found = estimate_delay(&jumps(0.02), 0.0).unwrap();
        assert!((found.mean_s - 0.05).abs() < 1e-12);
        assert!(
            (found.sigma_s.unwrap() - (0.02f64.powi(2) - 0.005f64.powi(2)).sqrt()).abs() < 3e-4
        );
        let still = estimate_delay(&jumps(0.005), 0.01).unwrap();
        assert!((still.mean_sigma_s - 0.01).abs() < 1e-4 && still.sigma_s.unwrap() < 0.011);
        assert_eq!(estimate_delay(&[], 0.0), None);
        let one = estimate_delay(&[(0.05, 0.005)], 0.0).unwrap();
        assert_eq!(
            (one.sigma_s, one.scatter_s, one.mean_sigma_s),
            (None, None, 0.005)
        );
    }
}
