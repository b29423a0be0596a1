//! What a flight's moments at one place say of wear: extremes, exceedances, the ground-air-ground cycle, damage.
//!
//! Damage is relative: that of one ground-air-ground cycle of the flight is 1. So neither the S-N curve's height nor
//! stress per moment is asked for, only the curve's slope, and the stiffness cancels.

use super::moment::Moment;
use super::rainflow::{self, Cycle};
use super::sampling::Unseen;

/// A range below so many of its standard deviations is not told from noise.
const GATE: f64 = 3.0;
/// The greatest (`sign` 1) or smallest (-1) moment and its place in the history.
pub fn extreme(moments: &[Moment], sign: f64) -> Option<(usize, Moment)> {
    let at = |(k, m): (usize, &Moment)| (k, *m);
    moments.iter().enumerate().map(at).max_by(|a, b| (sign * a.1.value).total_cmp(&(sign * b.1.value)))
}

/// From the ground up to the flight's extreme and back.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct GroundAirGround {
    /// Between the lowest and the highest moment, the ground's 0 among them, N m.
    pub range_n_m: f64,
    /// Of the range, from all, N m.
    pub sigma_range_n_m: f64,
    /// Half-way, against ground, N m.
    pub mean_n_m: f64,
    /// Of the range, from the curvature, N m.
    #[serde(skip)]
    pub sigma_by_curvature_n_m: f64,
}

/// The ground-air-ground cycle; `None` without a moment.
pub fn ground_air_ground(moments: &[Moment]) -> Option<GroundAirGround> {
    let ground = Moment { value: 0.0, sigma: 0.0, sigma_by_curvature: 0.0, sigma_by_stiffness: 0.0 };
    let (_, high) = extreme(moments, 1.0)?;
    let (_, low) = extreme(moments, -1.0)?;
    let high = if high.value > 0.0 { high } else { ground };
    let low = if low.value < 0.0 { low } else { ground };
    let by_curvature = high.sigma_by_curvature.hypot(low.sigma_by_curvature);
    // One stiffness for both: a share of the range.
    let by_stiffness = high.sigma_by_stiffness + low.sigma_by_stiffness;
    Some(GroundAirGround {
        range_n_m: high.value - low.value,
        mean_n_m: 0.5 * (high.value + low.value),
        sigma_by_curvature_n_m: by_curvature,
        sigma_range_n_m: by_curvature.hypot(by_stiffness),
    })
}

/// How often and how long a level was exceeded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exceedance {
    /// N m.
    pub level_n_m: f64,
    /// Frames above it.
    pub frames: usize,
    /// Passages from below to above, from one frame to the next (level-crossing count, ASTM E1049-85, 5.1).
    pub crossings: usize,
}

/// Of `count` levels that part the way from the lowest moment to the highest alike.
pub fn exceedances(moments: &[Moment], count: usize) -> Vec<Exceedance> {
    let (Some((_, high)), Some((_, low))) = (extreme(moments, 1.0), extreme(moments, -1.0)) else {
        return Vec::new();
    };
    let one = |k: usize| {
        let level = low.value + (high.value - low.value) * (k as f64 + 0.5) / count as f64;
        let above = |m: &&Moment| m.value > level;
        let crossings = moments.windows(2).filter(|pair| !above(&&pair[0]) && above(&&pair[1]));
        Exceedance {
            level_n_m: level,
            frames: moments.iter().filter(above).count(),
            crossings: crossings.count(),
        }
    };
    (0..count).map(one).collect()
}

/// A history's cycles, from the ground to the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct OverAFlight {
    /// Whose range is at least three of its standard deviations.
    pub cycles: Vec<Cycle>,
    /// Standard deviation of each one's range from the curvature, N m.
    pub sigmas_n_m: Vec<f64>,
    /// Smallest range that is counted between two usual frames, N m; from the ground, which is exact, less.
    pub gate_n_m: f64,
    /// Cycles below, halves as such: noise, or not told from it.
    pub left_out: f64,
}

/// Smallest range between two usual frames that is told from noise, N m.
fn gate(moments: &[Moment]) -> f64 {
    let mut sigmas: Vec<f64> = moments.iter().map(|m| m.sigma_by_curvature).collect();
    sigmas.sort_by(f64::total_cmp);
    GATE * std::f64::consts::SQRT_2 * sigmas.get(sigmas.len() / 2).copied().unwrap_or(0.0)
}

/// Counts the cycles of a flight that begins and ends on ground.
pub fn over_a_flight(moments: &[Moment]) -> OverAFlight {
    let on_ground = std::iter::once((0.0, 0.0));
    let in_flight = moments.iter().map(|m| (m.value, m.sigma_by_curvature));
    let (values, sigmas): (Vec<f64>, Vec<f64>) = on_ground.clone().chain(in_flight).chain(on_ground).unzip();
    let at = |k: usize| sigmas.get(k).copied().unwrap_or(0.0);
    let sigma = |cycle: &Cycle| at(cycle.ends[0]).hypot(at(cycle.ends[1]));
    let (cycles, small): (Vec<Cycle>, Vec<Cycle>) =
        rainflow::cycles(&values).into_iter().partition(|cycle| cycle.range >= GATE * sigma(cycle));
    OverAFlight {
        sigmas_n_m: cycles.iter().map(sigma).collect(),
        cycles,
        gate_n_m: gate(moments),
        left_out: small.iter().map(|cycle| cycle.count).sum(),
    }
}

/// Goodman's line: the moments that a mean is measured against, N m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goodman {
    /// On ground, to which the flight's are added.
    pub ground_n_m: f64,
    /// At failure.
    pub ultimate_n_m: f64,
}

impl Goodman {
    /// The range with mean 0 that does the same; a mean that closes cracks is not credited. Infinite at failure.
    pub fn range(&self, range: f64, mean: f64) -> f64 {
        let share = ((self.ground_n_m + mean) / self.ultimate_n_m).max(0.0);
        if share < 1.0 { range / (1.0 - share) } else { f64::INFINITY }
    }
}

/// Damage of a flight for one slope of the S-N curve; what is not finite, where a cycle reaches failure, is written as
/// `null`.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Damage {
    /// Slope: N goes with range to the power of -slope.
    pub slope: f64,
    /// Over that of one ground-air-ground cycle.
    pub relative: f64,
    /// Its standard deviation, from the curvature, and from what frames and gaps do not show.
    pub sigma_relative: f64,
    /// Range of one cycle that does the same, N m.
    pub equivalent_range_n_m: f64,
    /// Its standard deviation, from all, N m.
    pub sigma_equivalent_range_n_m: f64,
}

/// The damage of cycles by Palmgren's and Miner's rule. `stiffness_share`: standard deviation of the stiffness over it. What the
/// frames do not show of gusts is in the standard deviations: all cycles but the largest are taken for them.
pub fn damage(
    flight: &OverAFlight,
    whole: &GroundAirGround,
    slope: f64,
    goodman: Option<Goodman>,
    (stiffness_share, unseen): (f64, Unseen),
) -> Damage {
    let corrected = |range: f64, mean: f64| goodman.map_or(range, |g| g.range(range, mean));
    let reference = corrected(whole.range_n_m, whole.mean_n_m);
    let (mut sum, mut variance, mut largest) = (0.0, 0.0, 0.0_f64);
    for (cycle, sigma) in flight.cycles.iter().zip(&flight.sigmas_n_m) {
        let own = cycle.count * (corrected(cycle.range, cycle.mean) / reference).powf(slope);
        sum += own;
        largest = largest.max(own);
        variance += (slope * own * sigma / cycle.range).powi(2);
    }
    let by_reference = slope * sum * whole.sigma_by_curvature_n_m / whole.range_n_m;
    // Both are losses, and of the time that is not told the ranges would be missed too.
    let by_unseen = (sum - largest) * ((1.0 + slope * unseen.of_range) * (1.0 + unseen.of_time) - 1.0);
    let equivalent = reference * sum.powf(slope.recip());
    let by_cycles = if sum > 0.0 { variance.sqrt().hypot(by_unseen) / (slope * sum) } else { 0.0 };
    Damage {
        slope,
        relative: sum,
        sigma_relative: variance.sqrt().hypot(by_reference).hypot(by_unseen),
        equivalent_range_n_m: equivalent,
        sigma_equivalent_range_n_m: equivalent * by_cycles.hypot(stiffness_share),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    fn moment(value: f64) -> Moment {
        Moment { value, sigma: 0.1, sigma_by_curvature: 0.1, sigma_by_stiffness: 0.0 }
    }

    fn seen(stiffness_share: f64) -> (f64, Unseen) {
        (stiffness_share, Unseen::default())
    }

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-9 * b.abs().max(1.0), "{a} {b}");
    }

    #[test]
    fn one_smooth_flight_is_one_ground_air_ground_cycle() {
        let moments: Vec<Moment> = [1.0, 5.0, 10.0, 4.0].map(moment).to_vec();
        let whole = ground_air_ground(&moments).unwrap();
        close(whole.range_n_m, 10.0);
        let flight = over_a_flight(&moments);
        close(flight.left_out, 0.0);
        for slope in [3.0, 5.0] {
            let damage = damage(&flight, &whole, slope, None, seen(0.05));
            close(damage.relative, 1.0);
            close(damage.equivalent_range_n_m, 10.0);
            close(damage.sigma_equivalent_range_n_m, 10.0 * 0.05f64.hypot(0.01 / 2f64.sqrt()));
        }
    }

    #[test]
    fn gusts_add_their_share_and_noise_adds_none() {
        let gusts = [10.0, 5.0, 10.0, 5.0, 10.0, 9.9, 10.0].map(moment).to_vec();
        let (whole, flight) = (ground_air_ground(&gusts).unwrap(), over_a_flight(&gusts));
        close(flight.left_out, 1.0);
        close(damage(&flight, &whole, 3.0, None, seen(0.0)).relative, 1.0 + 2.0 * 0.125);
        close(damage(&flight, &whole, 5.0, None, seen(0.0)).relative, 1.0 + 2.0 / 32.0);
    }

    #[test]
    fn the_way_from_the_ground_counts_where_one_frame_tells_it() {
        // 3.5 standard deviations of one frame, fewer than three of two.
        let (whole, flight) = (ground_air_ground(&[moment(0.35)]).unwrap(), over_a_flight(&[moment(0.35)]));
        assert!(flight.gate_n_m > 0.35);
        close(damage(&flight, &whole, 3.0, None, seen(0.0)).relative, 1.0);
    }

    #[test]
    fn goodman_raises_what_swings_about_a_load() {
        let line = Goodman { ground_n_m: 0.0, ultimate_n_m: 30.0 };
        close(line.range(10.0, 15.0), 20.0);
        close(line.range(10.0, -15.0), 10.0);
        assert_eq!(line.range(10.0, 30.0), f64::INFINITY);
        let gusts = [10.0, 5.0, 10.0].map(moment).to_vec();
        let (whole, flight) = (ground_air_ground(&gusts).unwrap(), over_a_flight(&gusts));
        let corrected = damage(&flight, &whole, 3.0, Some(line), seen(0.0)).relative;
        close(corrected, 1.0 + ((5.0 / 0.75) / (10.0 * 6.0 / 5.0f64)).powi(3));
    }

    #[test]
    fn levels_are_crossed_upwards_and_counted() {
        let moments = [0.0, 8.0, 0.0, 8.0, 8.0, 0.0].map(moment).to_vec();
        let found = exceedances(&moments, 2);
        assert_eq!(found[0], Exceedance { level_n_m: 2.0, frames: 3, crossings: 2 });
        assert_eq!(exceedances(&[], 2), []);
    }
}
