//! Fatigue from a flight's moments at one section: extremes, exceedances, the ground-air-ground cycle, damage.
//!
//! Damage is relative: that of one ground-air-ground cycle of the flight is 1. It needs the slope of the S-N curve, but
//! neither its height nor the stress per moment, and the stiffness cancels.

use super::moment::BendingMoment;
use super::rainflow::{self, LoadCycle};
use super::sampling::UnseenFractions;

/// Smallest significant range, in standard deviations.
const NOISE_SIGMAS: f64 = 3.0;
/// Returns the largest (`sign` 1) or smallest (-1) moment and its index in the history.
pub fn extreme_moment(moments: &[BendingMoment], sign: f64) -> Option<(usize, BendingMoment)> {
    let at = |(k, m): (usize, &BendingMoment)| (k, *m);
    moments
        .iter()
        .enumerate()
        .map(at)
        .max_by(|a, b| (sign * a.1.value).total_cmp(&(sign * b.1.value)))
}

/// The ground-air-ground cycle: from the ground to the flight's extreme and back.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct GroundAirGround {
    /// Range between the lowest and the highest moment, including the ground's 0, N m.
    pub range_n_m: f64,
    /// Standard deviation of the range from all contributions, N m.
    pub sigma_range_n_m: f64,
    /// Mean of the lowest and the highest moment, relative to the ground, N m.
    pub mean_n_m: f64,
    /// Contribution of the curvature to the standard deviation of the range, N m.
    #[serde(skip)]
    pub sigma_by_curvature_n_m: f64,
}

/// Returns the ground-air-ground cycle; `None` without moments.
pub fn ground_air_ground(moments: &[BendingMoment]) -> Option<GroundAirGround> {
    let ground = BendingMoment {
        value: 0.0,
        sigma: 0.0,
        sigma_by_curvature: 0.0,
        sigma_by_stiffness: 0.0,
    };
    let (_, high) = extreme_moment(moments, 1.0)?;
    let (_, low) = extreme_moment(moments, -1.0)?;
    let high = if high.value > 0.0 { high } else { ground };
    let low = if low.value < 0.0 { low } else { ground };
    let by_curvature = high.sigma_by_curvature.hypot(low.sigma_by_curvature);
    // Both moments have the same error of the stiffness, proportional to the range.
    let by_stiffness = high.sigma_by_stiffness + low.sigma_by_stiffness;
    Some(GroundAirGround {
        range_n_m: high.value - low.value,
        mean_n_m: 0.5 * (high.value + low.value),
        sigma_by_curvature_n_m: by_curvature,
        sigma_range_n_m: by_curvature.hypot(by_stiffness),
    })
}

/// Exceedances of a level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exceedance {
    pub level_n_m: f64,
    /// Number of frames above the level.
    pub frames: usize,
    /// Number of upward crossings from one frame to the next (level-crossing count, ASTM E1049-85, 5.1).
    pub crossings: usize,
}

/// Counts exceedances of `count` equidistant levels between the lowest and the highest moment.
pub fn count_exceedances(moments: &[BendingMoment], count: usize) -> Vec<Exceedance> {
    let (Some((_, high)), Some((_, low))) =
        (extreme_moment(moments, 1.0), extreme_moment(moments, -1.0))
    else {
        return Vec::new();
    };
    let one = |k: usize| {
        let level = low.value + (high.value - low.value) * (k as f64 + 0.5) / count as f64;
        let above = |m: &&BendingMoment| m.value > level;
        let crossings = moments
            .windows(2)
            .filter(|pair| !above(&&pair[0]) && above(&&pair[1]));
        Exceedance {
            level_n_m: level,
            frames: moments.iter().filter(above).count(),
            crossings: crossings.count(),
        }
    };
    (0..count).map(one).collect()
}

/// Cycles of a flight, from ground to ground.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightCycles {
    /// Cycles whose range is at least three of its standard deviations.
    pub cycles: Vec<LoadCycle>,
    /// Contribution of the curvature to the standard deviation of each range, N m.
    pub sigmas_n_m: Vec<f64>,
    /// Smallest range that is counted between two typical frames, N m; from the ground, which is exact, it is smaller.
    pub gate_n_m: f64,
    /// Number of cycles below the limit, half cycles counted as 0.5: not distinguishable from noise.
    pub excluded: f64,
}

/// Returns the smallest significant range between two typical frames, N m.
fn noise_gate(moments: &[BendingMoment]) -> f64 {
    let mut sigmas: Vec<f64> = moments.iter().map(|m| m.sigma_by_curvature).collect();
    sigmas.sort_by(f64::total_cmp);
    NOISE_SIGMAS * std::f64::consts::SQRT_2 * sigmas.get(sigmas.len() / 2).copied().unwrap_or(0.0)
}

/// Counts the cycles of a flight that begins and ends on the ground.
pub fn count_flight_cycles(moments: &[BendingMoment]) -> FlightCycles {
    let on_ground = std::iter::once((0.0, 0.0));
    let in_flight = moments.iter().map(|m| (m.value, m.sigma_by_curvature));
    let (values, sigmas): (Vec<f64>, Vec<f64>) =
        on_ground.clone().chain(in_flight).chain(on_ground).unzip();
    let at = |k: usize| sigmas.get(k).copied().unwrap_or(0.0);
    let sigma = |cycle: &LoadCycle| at(cycle.ends[0]).hypot(at(cycle.ends[1]));
    let (cycles, small): (Vec<LoadCycle>, Vec<LoadCycle>) = rainflow::count_cycles(&values)
        .into_iter()
        .partition(|cycle| cycle.range >= NOISE_SIGMAS * sigma(cycle));
    FlightCycles {
        sigmas_n_m: cycles.iter().map(sigma).collect(),
        cycles,
        gate_n_m: noise_gate(moments),
        excluded: small.iter().map(|cycle| cycle.count).sum(),
    }
}

/// Moments of Goodman's line, which corrects a range for its mean, N m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GoodmanLine {
    /// Moment on the ground, to which the flight's moments are added.
    pub ground_n_m: f64,
    /// Moment at failure.
    pub ultimate_n_m: f64,
}

impl GoodmanLine {
    /// Returns the range with mean 0 of equal damage; a mean that closes cracks is not credited. Infinite at failure.
    pub fn equivalent_range(&self, range: f64, mean: f64) -> f64 {
        let share = ((self.ground_n_m + mean) / self.ultimate_n_m).max(0.0);
        if share < 1.0 {
            range / (1.0 - share)
        } else {
            f64::INFINITY
        }
    }
}

/// Damage of a flight for one slope of the S-N curve. Infinite values, if a cycle reaches failure, are written as `null`.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Damage {
    /// Slope of the S-N curve: N is proportional to the range to the power of -slope.
    pub slope: f64,
    /// Damage relative to one ground-air-ground cycle.
    pub relative: f64,
    /// Standard deviation of the relative damage, from the curvature and from gusts that frames and gaps do not show.
    pub sigma_relative: f64,
    /// Range of one cycle of equal damage, N m.
    pub equivalent_range_n_m: f64,
    /// Standard deviation of the equivalent range from all contributions, N m.
    pub sigma_equivalent_range_n_m: f64,
}

/// Computes the damage of cycles by the Palmgren-Miner rule. `stiffness_fraction`: relative standard deviation of the
/// stiffness. Gusts that the frames do not show are in the standard deviations: all cycles except the largest are taken as
/// gusts.
pub fn relative_damage(
    flight: &FlightCycles,
    reference_cycle: &GroundAirGround,
    slope: f64,
    goodman: Option<GoodmanLine>,
    (stiffness_fraction, unseen): (f64, UnseenFractions),
) -> Damage {
    let corrected =
        |range: f64, mean: f64| goodman.map_or(range, |g| g.equivalent_range(range, mean));
    let reference = corrected(reference_cycle.range_n_m, reference_cycle.mean_n_m);
    let (mut sum, mut variance, mut largest) = (0.0, 0.0, 0.0_f64);
    for (cycle, sigma) in flight.cycles.iter().zip(&flight.sigmas_n_m) {
        let own = cycle.count * (corrected(cycle.range, cycle.mean) / reference).powf(slope);
        sum += own;
        largest = largest.max(own);
        variance += (slope * own * sigma / cycle.range).powi(2);
    }
    let by_reference =
        slope * sum * reference_cycle.sigma_by_curvature_n_m / reference_cycle.range_n_m;
    // Both are losses, and the ranges of the uncovered time would be missed too.
    let by_unseen = (sum - largest)
        * ((1.0 + slope * unseen.range_fraction) * (1.0 + unseen.time_fraction) - 1.0);
    let equivalent = reference * sum.powf(slope.recip());
    let by_cycles = if sum > 0.0 {
        variance.sqrt().hypot(by_unseen) / (slope * sum)
    } else {
        0.0
    };
    Damage {
        slope,
        relative: sum,
        sigma_relative: variance.sqrt().hypot(by_reference).hypot(by_unseen),
        equivalent_range_n_m: equivalent,
        sigma_equivalent_range_n_m: equivalent * by_cycles.hypot(stiffness_fraction),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moment(value: f64) -> BendingMoment {
        BendingMoment {
            value,
            sigma: 0.1,
            sigma_by_curvature: 0.1,
            sigma_by_stiffness: 0.0,
        }
    }

    fn seen(stiffness_fraction: f64) -> (f64, UnseenFractions) {
        (stiffness_fraction, UnseenFractions::default())
    }

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-9 * b.abs().max(1.0), "{a} {b}");
    }

    #[test]
    fn one_smooth_flight_is_one_ground_air_ground_cycle() {
        let moments: Vec<BendingMoment> = [1.0, 5.0, 10.0, 4.0].map(moment).to_vec();
        let reference_cycle = ground_air_ground(&moments).unwrap();
        close(reference_cycle.range_n_m, 10.0);
        let flight = count_flight_cycles(&moments);
        close(flight.excluded, 0.0);
        for slope in [3.0, 5.0] {
            let damage = relative_damage(&flight, &reference_cycle, slope, None, seen(0.05));
            close(damage.relative, 1.0);
            close(damage.equivalent_range_n_m, 10.0);
            close(
                damage.sigma_equivalent_range_n_m,
                10.0 * 0.05f64.hypot(0.01 / 2f64.sqrt()),
            );
        }
    }

    #[test]
    fn gusts_add_damage_and_noise_adds_none() {
        let gusts = [10.0, 5.0, 10.0, 5.0, 10.0, 9.9, 10.0].map(moment).to_vec();
        let (reference_cycle, flight) = (
            ground_air_ground(&gusts).unwrap(),
            count_flight_cycles(&gusts),
        );
        close(flight.excluded, 1.0);
        close(
            relative_damage(&flight, &reference_cycle, 3.0, None, seen(0.0)).relative,
            1.0 + 2.0 * 0.125,
        );
        close(
            relative_damage(&flight, &reference_cycle, 5.0, None, seen(0.0)).relative,
            1.0 + 2.0 / 32.0,
        );
    }

    #[test]
    fn one_significant_frame_counts_as_a_cycle_from_the_ground() {
        // 3.5 standard deviations of one frame, fewer than 3 of the difference of two.
        let (reference_cycle, flight) = (
            ground_air_ground(&[moment(0.35)]).unwrap(),
            count_flight_cycles(&[moment(0.35)]),
        );
        assert!(flight.gate_n_m > 0.35);
        close(
            relative_damage(&flight, &reference_cycle, 3.0, None, seen(0.0)).relative,
            1.0,
        );
    }

    #[test]
    fn goodman_raises_ranges_about_a_mean_load() {
        let line = GoodmanLine {
            ground_n_m: 0.0,
            ultimate_n_m: 30.0,
        };
        close(line.equivalent_range(10.0, 15.0), 20.0);
        close(line.equivalent_range(10.0, -15.0), 10.0);
        assert_eq!(line.equivalent_range(10.0, 30.0), f64::INFINITY);
        let gusts = [10.0, 5.0, 10.0].map(moment).to_vec();
        let (reference_cycle, flight) = (
            ground_air_ground(&gusts).unwrap(),
            count_flight_cycles(&gusts),
        );
        let corrected =
            relative_damage(&flight, &reference_cycle, 3.0, Some(line), seen(0.0)).relative;
        close(
            corrected,
            1.0 + ((5.0 / 0.75) / (10.0 * 6.0 / 5.0f64)).powi(3),
        );
    }

    #[test]
    fn levels_are_crossed_upwards_and_counted() {
        let moments = [0.0, 8.0, 0.0, 8.0, 8.0, 0.0].map(moment).to_vec();
        let found = count_exceedances(&moments, 2);
        assert_eq!(
            found[0],
            Exceedance {
                level_n_m: 2.0,
                frames: 3,
                crossings: 2
            }
        );
        assert_eq!(count_exceedances(&[], 2), []);
    }
}
