//! Deflection of a wing in gusts as a function of time.

use super::SeededRandom;

/// Frequencies of the gusts, Hz, rounded to whole periods: a short gust, the wing's first bending mode, a patch of rough
/// air.
const GUSTS_HZ: [f64; 3] = [0.17, 0.6, 1.9];
/// Relative variation of the fuel's bending relief with the fastest gust: the inertia of the fuel responds with its own
/// phase.
const RELIEF_VARIATION: f64 = 0.1;
/// Maximum amplitude of a random vibration relative to its rms.
const MAX_PEAK_TO_RMS: f64 = 4.0;

/// Gusts of one amplitude, each with a whole number of periods in the flight, so that its end is followed by its beginning.
pub struct GustSeries {
    amplitude_m: f64,
    /// Frequency, Hz, and phase of each gust.
    gusts: [(f64, f64); 3],
}

impl GustSeries {
    /// Samples the phases of the gusts of a flight of this duration; `amplitude_m` is that of the tip deflection.
    pub fn new(seconds: f64, amplitude_m: f64, random: &mut SeededRandom) -> Self {
        let gust = |hz: f64| {
            let whole_hz = (hz * seconds).round().max(1.0) / seconds;
            (whole_hz, random.uniform(0.0, std::f64::consts::TAU))
        };
        Self {
            amplitude_m,
            gusts: GUSTS_HZ.map(gust),
        }
    }

    /// Returns the maximum deflection added by gusts and modes, m.
    pub fn max_deflection_m(amplitude_m: f64, modes: &[BendingMode]) -> f64 {
        let modes: f64 = modes.iter().map(|mode| MAX_PEAK_TO_RMS * mode.rms_m).sum();
        amplitude_m * GUSTS_HZ.len() as f64 + modes
    }

    /// Returns the tip deflection added by the gusts at a time, m.
    pub fn tip_deflection_m(&self, time_s: f64) -> f64 {
        (0..self.gusts.len())
            .map(|k| self.amplitude_m * self.phase_sine(k, time_s))
            .sum()
    }

    /// Returns the factor of the fuel's bending relief at a time.
    pub fn relief_factor(&self, time_s: f64) -> f64 {
        if self.amplitude_m > 0.0 {
            1.0 + RELIEF_VARIATION * self.phase_sine(2, time_s + 0.1)
        } else {
            1.0
        }
    }

    fn phase_sine(&self, gust: usize, time_s: f64) -> f64 {
        let (hz, phase) = self.gusts[gust];
        (std::f64::consts::TAU * hz * time_s + phase).sin()
    }
}

/// A bending mode of the wing, excited at random.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BendingMode {
    /// Frequency, Hz.
    pub hz: f64,
    /// Damping ratio, below 1.
    pub damping: f64,
    /// Root mean square of the tip deflection, m.
    pub rms_m: f64,
}

impl BendingMode {
    /// Samples the mode's amplitude at each frame, m: a damped oscillator driven by white noise, in its steady state.
    pub fn sample_amplitudes(
        self,
        rate_hz: f64,
        count: usize,
        random: &mut SeededRandom,
    ) -> Vec<f64> {
        let omega = std::f64::consts::TAU * self.hz / rate_hz;
        let decay = (-self.damping * omega).exp();
        let first = 2.0 * decay * (omega * (1.0 - self.damping.powi(2)).sqrt()).cos();
        let second = decay * decay;
        let gain = (1.0 - second) * ((1.0 + second).powi(2) - first * first) / (1.0 + second);
        let settled = (20.0 / (self.damping * omega)).ceil() as usize;
        let (mut last, mut before) = (0.0, 0.0);
        let mut next = || {
            let now = first * last - second * before + self.rms_m * gain.sqrt() * random.normal();
            (last, before) = (now, last);
            now
        };
        (0..settled + count).map(|_| next()).skip(settled).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mode_has_its_frequency_damping_and_rms() {
        let mode = BendingMode {
            hz: 1.3,
            damping: 0.03,
            rms_m: 0.1,
        };
        let swing = mode.sample_amplitudes(10.0, 200_000, &mut SeededRandom::new(5, 1));
        let mean = |lag: usize| {
            swing
                .iter()
                .zip(&swing[lag..])
                .map(|(a, b)| a * b)
                .sum::<f64>()
                / (swing.len() - lag) as f64
        };
        assert!(
            (mean(0).sqrt() / 0.1 - 1.0).abs() < 0.03,
            "{}",
            mean(0).sqrt()
        );
        // Yule and Walker: the recursion from its correlations.
        let (zero, one, two) = (mean(0), mean(1), mean(2));
        let (first, second) = (
            one * (zero - two) / (zero * zero - one * one),
            (zero * two - one * one) / (zero * zero - one * one),
        );
        let decay = (-second).sqrt();
        let (real, imaginary) = (decay.ln(), (0.5 * first / decay).acos());
        let hz = real.hypot(imaginary) * 10.0 / std::f64::consts::TAU;
        assert!(
            (hz - 1.3).abs() < 0.01 && (-real / real.hypot(imaginary) - 0.03).abs() < 0.005,
            "{hz}"
        );
    }
}
