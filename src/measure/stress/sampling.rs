//! Whether a history has enough frames for cycles, where it has, and what it does not show.

/// Samples that a period of the lowest bending needs: an extreme between two of them is then missed by 5 % of the
/// amplitude at most, 1 - cos(pi/10).
pub const SAMPLES_PER_PERIOD: f64 = 10.0;
/// Lowest bending frequency where nobody states the wing's, Hz: transport aircraft have 1 to 3 (an assumption on the
/// safe side, for the more samples are asked for).
pub const USUAL_BENDING_HZ: f64 = 3.0;
/// A rate is kept to this share: clocks of cameras are off by less.
const TOLERANCE: f64 = 0.01;
/// An interval longer than so many usual ones is a gap.
const GAP: f64 = 1.5;
/// Of the frames between two holes so many must be there: where more are missing extremes are.
const THERE: f64 = 0.9;
/// Of the time so much must be told: less says nothing of a flight.
const MIN_DETERMINED: f64 = 0.1;

/// How often a history has frames, and where it has none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Frames a second by the median interval; `None` with fewer than two frames.
    pub rate_hz: Option<f64>,
    /// What cycles need.
    pub needed_hz: f64,
    /// Intervals longer than one and a half usual ones.
    pub gaps: usize,
    /// The longest of them, s; 0 without one.
    pub longest_gap_s: f64,
    /// Time over which frames follow each other closely enough, s.
    pub told_s: f64,
    /// The other time: of frames that are missing, of gaps longer than a period of the lowest bending, and where too many frames
    /// are missing, s.
    pub untold_s: f64,
    /// Of a cycle at the lowest bending, the share of its range that frames miss on the average.
    missed: f64,
}

/// What a history does not show of the gusts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Unseen {
    /// Share of a range.
    pub of_range: f64,
    /// Time that is not told over time that is told.
    pub of_time: f64,
}

impl Sampling {
    /// Whether the frames come often enough.
    pub fn is_fast_enough(&self) -> bool {
        self.rate_hz.is_some_and(|rate| rate >= (1.0 - TOLERANCE) * self.needed_hz)
    }

    /// Whether cycles can be told, of the time that is told.
    pub fn tells_cycles(&self) -> bool {
        self.is_fast_enough() && self.told_s > MIN_DETERMINED * (self.told_s + self.untold_s)
    }

    /// What is to be allowed for.
    pub fn unseen(&self) -> Unseen {
        Unseen { of_range: self.missed, of_time: self.untold_s / self.told_s.max(f64::MIN_POSITIVE) }
    }
}

/// The sampling of frames at these times (s, in order) of a wing with this lowest bending frequency (Hz).
pub fn sampling(times_s: &[f64], bending_hz: f64) -> Sampling {
    let steps: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let usual_s = sorted.get(sorted.len() / 2).copied().filter(|step| *step > 0.0);
    let mut found = Sampling {
        rate_hz: usual_s.map(f64::recip),
        needed_hz: SAMPLES_PER_PERIOD * bending_hz,
        gaps: 0,
        longest_gap_s: 0.0,
        told_s: 0.0,
        untold_s: 0.0,
        missed: 0.0,
    };
    let Some(usual_s) = usual_s else { return found };
    let half_turn = std::f64::consts::PI * bending_hz * usual_s;
    found.missed = 1.0 - half_turn.sin() / half_turn;
    // What cycles need is enough, however often frames come elsewhere.
    let enough_s = usual_s.max(((1.0 - TOLERANCE) * found.needed_hz).recip());
    let hole_s = bending_hz.recip().max(GAP * usual_s);
    for stretch in steps.split_inclusive(|step| *step > hole_s) {
        let gaps = stretch.iter().filter(|step| **step > GAP * usual_s);
        found.gaps += gaps.clone().count();
        found.longest_gap_s = gaps.copied().fold(found.longest_gap_s, f64::max);
        let (close, holes): (Vec<f64>, Vec<f64>) = stretch.iter().partition(|step| **step <= hole_s);
        let lasting_s: f64 = close.iter().sum();
        found.untold_s += holes.iter().sum::<f64>();
        let there_s: f64 = close.iter().map(|step| step.min(enough_s)).sum();
        let told_s = if there_s >= THERE * lasting_s { there_s } else { 0.0 };
        found.told_s += told_s;
        found.untold_s += lasting_s - told_s;
    }
    found
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    fn every(step_s: f64, count: u32) -> Vec<f64> {
        (0..count).map(|k| step_s * f64::from(k)).collect()
    }

    #[test]
    fn a_series_an_hour_tells_no_cycles_and_ten_frames_a_period_do() {
        let hourly: Vec<f64> =
            (0..80).map(|k| f64::from(k / 10) * 3600.0 + f64::from(k % 10) * 2.0).collect();
        let sampled = sampling(&hourly, 1.0);
        assert!(!sampled.tells_cycles() && sampled.rate_hz.unwrap() < 0.51);
        // A wing that is slow enough for the series, of which most of the time is not told.
        assert!(sampling(&hourly, 0.05).is_fast_enough() && !sampling(&hourly, 0.05).tells_cycles());
        let mut live = every(0.1, 2000);
        assert!(sampling(&live, 1.0).tells_cycles(), "ten a second are ten a second");
        assert!(!sampling(&live, 1.1).tells_cycles());
        live.retain(|t| (t * 10.0).round() as i64 % 5 != 0);
        assert!(!sampling(&live, 1.0).tells_cycles(), "every fifth is missing");
        assert_eq!(sampling(&[1.0], 1.0).rate_hz, None);
    }

    #[test]
    fn frames_skipped_are_counted_and_a_hole_is_time_that_is_not_told() {
        let mut skipped = every(0.2, 500);
        skipped.retain(|t| (t * 5.0).round() as i64 % 33 != 7);
        let found = sampling(&skipped, 0.5);
        assert!(found.tells_cycles() && (found.rate_hz.unwrap() - 5.0).abs() < 1e-9, "{found:?}");
        assert!(
            found.gaps == 15
                && (found.untold_s - 3.0).abs() < 0.1
                && (found.longest_gap_s - 0.4).abs() < 1e-9
        );
        let mut hole = every(0.1, 36_000);
        hole.retain(|t| !(1000.0..2200.0).contains(t));
        let found = sampling(&hole, 1.0);
        assert!(found.tells_cycles() && found.gaps == 1, "{found:?}");
        assert!((found.untold_s - 1200.0).abs() < 0.5 && (found.told_s - 2400.0).abs() < 0.5, "{found:?}");
        assert!(
            (found.unseen().of_time - 0.5).abs() < 1e-3 && (found.unseen().of_range - 0.016).abs() < 1e-3
        );
    }
}
