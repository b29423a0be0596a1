//! Sampling of a history: whether it has enough frames for cycles, over which time, and the fraction that it misses.

/// Samples per period of the lowest bending mode: an extreme between two samples is then missed by 5 % of the amplitude at
/// most, 1 - cos(pi/10).
pub const SAMPLES_PER_PERIOD: f64 = 10.0;
/// Relative tolerance of a rate: clocks of cameras are more accurate.
const RATE_TOLERANCE: f64 = 0.01;
/// Interval between frames over the median one from which on it is a gap.
const GAP_RATIO: f64 = 1.5;
/// Minimum fraction of frames present between two holes; with fewer, extremes are missing.
const MIN_PRESENT: f64 = 0.9;
/// Minimum fraction of the time in which cycles are countable; less does not represent a flight.
const MIN_DETERMINED: f64 = 0.1;

/// Rate and gaps of a history's frames.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Sampling {
    /// Frames per second by the median interval; `None` with fewer than two frames.
    pub rate_hz: Option<f64>,
    /// Rate that cycle counting needs, Hz.
    pub needed_hz: f64,
    /// Number of intervals longer than 1.5 times the median.
    pub gaps: usize,
    /// Longest gap, s; 0 without one.
    pub longest_gap_s: f64,
    /// Time in which frames follow each other closely enough for cycles, s.
    pub covered_s: f64,
    /// Remaining time, s: missing frames, gaps longer than a period of the lowest bending mode, and stretches with too many
    /// missing frames.
    pub uncovered_s: f64,
    /// Mean fraction of the range that frames miss of a cycle at the lowest bending frequency.
    missed: f64,
}

/// Fractions of the gust loads that a history does not show.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UnseenFractions {
    /// Missed fraction of a range.
    pub range_fraction: f64,
    /// Time without countable cycles over time with them.
    pub time_fraction: f64,
}

impl Sampling {
    /// Returns true if the frame rate is high enough for cycles.
    pub fn is_fast_enough(&self) -> bool {
        self.rate_hz
            .is_some_and(|rate| rate >= (1.0 - RATE_TOLERANCE) * self.needed_hz)
    }

    /// Returns true if cycles can be counted in a sufficient fraction of the time.
    pub fn has_countable_cycles(&self) -> bool {
        self.is_fast_enough()
            && self.covered_s > MIN_DETERMINED * (self.covered_s + self.uncovered_s)
    }

    /// Returns the fractions that the standard deviations of damage must allow for.
    pub fn unseen_fractions(&self) -> UnseenFractions {
        UnseenFractions {
            range_fraction: self.missed,
            time_fraction: self.uncovered_s / self.covered_s.max(f64::MIN_POSITIVE),
        }
    }
}

/// Analyses frames at these times (s, in order) for a wing with this lowest bending frequency (Hz).
pub fn analyse_sampling(times_s: &[f64], bending_hz: f64) -> Sampling {
    let steps: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let median_s = sorted
        .get(sorted.len() / 2)
        .copied()
        .filter(|step| *step > 0.0);
    let mut found = Sampling {
        rate_hz: median_s.map(f64::recip),
        needed_hz: SAMPLES_PER_PERIOD * bending_hz,
        ..Sampling::default()
    };
    let Some(median_s) = median_s else {
        return found;
    };
    let half_turn = std::f64::consts::PI * bending_hz * median_s;
    found.missed = 1.0 - half_turn.sin() / half_turn;
    // A lower rate that is enough for cycles counts as complete.
    let enough_s = median_s.max(((1.0 - RATE_TOLERANCE) * found.needed_hz).recip());
    let hole_s = bending_hz.recip().max(GAP_RATIO * median_s);
    for stretch in steps.split_inclusive(|step| *step > hole_s) {
        let gaps = stretch.iter().filter(|step| **step > GAP_RATIO * median_s);
        found.gaps += gaps.clone().count();
        found.longest_gap_s = gaps.copied().fold(found.longest_gap_s, f64::max);
        let (close, holes): (Vec<f64>, Vec<f64>) =
            stretch.iter().partition(|step| **step <= hole_s);
        let stretch_s: f64 = close.iter().sum();
        found.uncovered_s += holes.iter().sum::<f64>();
        let present_s: f64 = close.iter().map(|step| step.min(enough_s)).sum();
        let covered_s = if present_s >= MIN_PRESENT * stretch_s {
            present_s
        } else {
            0.0
        };
        found.covered_s += covered_s;
        found.uncovered_s += stretch_s - covered_s;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn every(step_s: f64, count: u32) -> Vec<f64> {
        (0..count).map(|k| step_s * f64::from(k)).collect()
    }

    #[test]
    fn ten_frames_per_period_allow_cycles_and_an_hourly_series_does_not() {
        let hourly: Vec<f64> = (0..80)
            .map(|k| f64::from(k / 10) * 3600.0 + f64::from(k % 10) * 2.0)
            .collect();
        let sampled = analyse_sampling(&hourly, 1.0);
        assert!(!sampled.has_countable_cycles() && sampled.rate_hz.unwrap() < 0.51);
        // The wing is slow enough for the series, but most of the time has no frames.
        assert!(
            analyse_sampling(&hourly, 0.05).is_fast_enough()
                && !analyse_sampling(&hourly, 0.05).has_countable_cycles()
        );
        let mut live = every(0.1, 2000);
        assert!(
            analyse_sampling(&live, 1.0).has_countable_cycles(),
            "10 frames per second are enough for 1 Hz"
        );
        assert!(!analyse_sampling(&live, 1.1).has_countable_cycles());
        live.retain(|t| (t * 10.0).round() as i64 % 5 != 0);
        assert!(
            !analyse_sampling(&live, 1.0).has_countable_cycles(),
            "every fifth frame is missing"
        );
        assert_eq!(analyse_sampling(&[1.0], 1.0).rate_hz, None);
    }

    #[test]
    fn skipped_frames_are_counted_and_holes_are_uncovered_time() {
        let mut skipped = every(0.2, 500);
        skipped.retain(|t| (t * 5.0).round() as i64 % 33 != 7);
        let found = analyse_sampling(&skipped, 0.5);
        assert!(
            found.has_countable_cycles() && (found.rate_hz.unwrap() - 5.0).abs() < 1e-9,
            "{found:?}"
        );
        assert!(
            found.gaps == 15
                && (found.uncovered_s - 3.0).abs() < 0.1
                && (found.longest_gap_s - 0.4).abs() < 1e-9
        );
        let mut hole = every(0.1, 36_000);
        hole.retain(|t| !(1000.0..2200.0).contains(t));
        let found = analyse_sampling(&hole, 1.0);
        assert!(found.has_countable_cycles() && found.gaps == 1, "{found:?}");
        assert!(
            (found.uncovered_s - 1200.0).abs() < 0.5 && (found.covered_s - 2400.0).abs() < 0.5,
            "{found:?}"
        );
        assert!(
            (found.unseen_fractions().time_fraction - 0.5).abs() < 1e-3
                && (found.unseen_fractions().range_fraction - 0.016).abs() < 1e-3
        );
    }
}
