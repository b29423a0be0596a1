//! Bending moments of a flight at structural stations: extremes, exceedances, cycles and damage (docs/stress.md).

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use wingd_base::clock::Stamp;
use wingd_evaluation::number::format_general;
use wingd_evaluation::record::ImageRecord;
use wingd_measure::ordering::sort_by_value;
use wingd_measure::setup::StiffnessSection;
use wingd_measure::stress;
use wingd_measure::stress::{BendingCurvature, BendingMoment};
use wingd_measure::stress::{Damage, FlightCycles, GoodmanLine, GroundAirGround};
use wingd_measure::stress::{SAMPLES_PER_PERIOD, Sampling};

/// Solved frame with its bending line.
#[derive(Clone, Debug, PartialEq)]
pub struct StressFrame {
    pub series: String,
    /// File name in the folder of the series.
    pub image: String,
    /// Time of the exposure; if that is not recorded, time of the camera request.
    pub stamp: Stamp,
    pub curvature: BendingCurvature,
}

/// Parameters of the load evaluation.
#[derive(Clone, Debug, PartialEq)]
pub struct StressQuery {
    /// Stations with their stiffness.
    pub sections: Vec<StiffnessSection>,
    /// Lowest bending frequency of the wing, Hz.
    pub bending_hz: f64,
    /// Slopes of the S-N curves.
    pub slopes: Vec<f64>,
    /// Correct for the mean moment with Goodman's line.
    pub goodman: bool,
    /// Number of levels of the exceedances.
    pub levels: usize,
}

/// Loads of a flight.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FlightLoad {
    /// Number of frames with a moment.
    pub frames: usize,
    /// Frame rate by the median interval; `null` with fewer than two frames.
    pub rate_hz: Option<f64>,
    /// Frame rate needed to count cycles: ten frames per period of the lowest bending mode.
    pub needed_hz: f64,
    /// Gaps between frames.
    pub gaps: FrameGaps,
    /// Reason why no cycles are counted; `null` if they are.
    pub no_cycles_because: Option<String>,
    /// Stations from root to tip.
    pub stations: Vec<StationLoad>,
}

/// Gaps between frames, and the time over which cycles were counted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameGaps {
    /// Number of intervals longer than 1.5 times the median interval.
    pub count: usize,
    /// Longest gap, s; 0 if there is none.
    pub longest_s: f64,
    /// Time over which cycles were counted, s.
    pub counted_s: f64,
    /// Time over which no cycles were counted, s.
    pub uncounted_s: f64,
}

impl FrameGaps {
    fn from_sampling(sampling: &Sampling) -> Self {
        let Sampling {
            gaps,
            longest_gap_s,
            covered_s,
            uncovered_s,
            ..
        } = *sampling;
        let (counted_s, uncounted_s) = match sampling.has_countable_cycles() {
            true => (covered_s, uncovered_s),
            false => (0.0, covered_s + uncovered_s),
        };
        Self {
            count: gaps,
            longest_s: longest_gap_s,
            counted_s,
            uncounted_s,
        }
    }

    /// Describes the gaps in a sentence; `None` if there are none.
    #[must_use]
    pub fn message(&self) -> Option<String> {
        let minutes = |s: f64| format!("{:.1} min", s / 60.0);
        let (counted, uncounted) = (minutes(self.counted_s), minutes(self.uncounted_s));
        (self.count > 0).then(|| {
            format!(
                "{} gaps between frames, longest {:.1} s. Cycles were counted over {counted}; the remaining {uncounted} is \
                 not in the damage, but the standard deviation allows for it at the same damage rate",
                self.count, self.longest_s
            )
        })
    }
}

/// Loads at one station. Moments are changes relative to the ground, N m, positive if they bend the tip up.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StationLoad {
    /// Arc length from the bending root, m.
    pub s_m: f64,
    /// Bending stiffness EI.
    pub ei_n_m2: f64,
    /// Largest moment.
    pub greatest: ExtremeLoad,
    /// Smallest moment.
    pub smallest: ExtremeLoad,
    /// Cycle from the ground to the extremes and back.
    pub ground_air_ground: GroundAirGround,
    /// Exceedances from the lowest to the highest level.
    pub exceedances: Vec<ExceedanceLoad>,
    /// Rainflow cycles, largest range first; `null` if no cycles are counted.
    pub cycles: Option<Vec<CycleLoad>>,
    /// Smallest counted range.
    pub smallest_range_n_m: Option<f64>,
    /// Number of cycles below the smallest counted range.
    pub cycles_excluded: Option<f64>,
    /// Damage for each slope; `null` if no cycles are counted.
    pub damage: Option<Vec<Damage>>,
}

/// Extreme moment and its frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExtremeLoad {
    pub moment_n_m: f64,
    pub sigma_moment_n_m: f64,
    /// Part of `sigma_moment_n_m` due to the stiffness; common to all frames.
    pub sigma_by_stiffness_n_m: f64,
    pub series: String,
    /// File name of the frame.
    pub image: String,
    pub utc: jiff::Timestamp,
}

/// Number of exceedances of a level.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ExceedanceLoad {
    pub level_n_m: f64,
    /// Number of frames above the level.
    pub frames_above: usize,
    /// Number of upward crossings; `null` if no cycles are counted.
    pub upward_crossings: Option<usize>,
}

/// Rainflow cycle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CycleLoad {
    pub range_n_m: f64,
    /// Part of the standard deviation due to the curvature.
    pub sigma_range_n_m: f64,
    pub mean_n_m: f64,
    /// 1 for a full cycle, 0.5 for a half cycle.
    pub count: f64,
}

/// Returns the curvature coefficients of a record, 1/m, with their covariance, 1/m².
///
/// # Errors
/// Returns an error if the record has no curvature or no correlations.
pub fn curvature_coefficients(
    record: &ImageRecord,
) -> Result<(DVector<f64>, DMatrix<f64>), NoCurvature> {
    if !record.is_solved() {
        return Err(NoCurvature::Unsolved);
    }
    let terms = &record.model.curvature_per_m;
    if terms.is_empty() || terms.iter().any(|term| term.value.is_nan()) {
        return Err(NoCurvature::OtherMethod);
    }
    let place = |k: usize| format!("curvature_per_m[{k}]");
    let sigma = |k: usize| terms[k].sigma.unwrap_or(0.0);
    let entry = |i: usize, j: usize| {
        record
            .quality
            .correlation
            .as_ref()?
            .coefficient(&place(i), &place(j))
    };
    let mut covariance = DMatrix::zeros(terms.len(), terms.len());
    for i in 0..terms.len() {
        for j in 0..terms.len() {
            // A fixed coefficient has no covariance.
            let fixed = sigma(i) == 0.0 || sigma(j) == 0.0;
            let correlated = if i == j { Some(1.0) } else { entry(i, j) };
            covariance[(i, j)] = match (fixed, correlated) {
                (true, _) => 0.0,
                (false, Some(r)) => r * sigma(i) * sigma(j),
                (false, None) => return Err(NoCurvature::NoCorrelations),
            };
        }
    }
    Ok((
        DVector::from_iterator(terms.len(), terms.iter().map(|m| m.value)),
        covariance,
    ))
}

/// Reason why a result has no bending line from which moments can be computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoCurvature {
    /// The frame has no solution.
    #[error("the frame was not solved")]
    Unsolved,
    /// The profile method fits a parabola, which has no curvature coefficients.
    #[error("the result has no curvature: solve the frame with --method spatial")]
    OtherMethod,
    /// The result was written by a program without correlations.
    #[error("the result has no correlations: solve the frame again")]
    NoCorrelations,
}

/// Returns the seconds since the first frame: by time since boot within a boot, by UTC between boots.
pub fn seconds_since_first<'a>(stamps: impl Iterator<Item = &'a Stamp>) -> Vec<f64> {
    let mut at = Vec::new();
    let mut last: Option<(&Stamp, f64)> = None;
    for stamp in stamps {
        let time = last.map_or(0.0, |(before, time)| {
            let step = if before.boot_id == stamp.boot_id {
                stamp.since_boot_s - before.since_boot_s
            } else {
                stamp.utc.duration_since(before.utc).as_secs_f64()
            };
            time + step.max(0.0)
        });
        at.push(time);
        last = Some((stamp, time));
    }
    at
}

/// Evaluates the loads of frames in order of time; `None` without frames.
pub fn flight_load(frames: &[StressFrame], question: &StressQuery) -> Option<FlightLoad> {
    let times_s = seconds_since_first(frames.iter().map(|frame| &frame.stamp));
    let sampling = stress::analyse_sampling(&times_s, question.bending_hz);
    let station =
        |section: &StiffnessSection| load_at_station(frames, section, question, &sampling);
    let stations = question
        .sections
        .iter()
        .map(station)
        .collect::<Option<Vec<_>>>();
    Some(FlightLoad {
        frames: frames.len(),
        rate_hz: sampling.rate_hz,
        needed_hz: sampling.needed_hz,
        gaps: FrameGaps::from_sampling(&sampling),
        no_cycles_because: no_cycles_reason(&sampling, question.bending_hz),
        stations: stations?,
    })
}

fn no_cycles_reason(sampling: &Sampling, bending_hz: f64) -> Option<String> {
    if sampling.has_countable_cycles() {
        return None;
    }
    let remaining = "extremes and the ground-air-ground cycle are from the available frames";
    let rate = sampling
        .rate_hz
        .map(format_general)
        .filter(|_| sampling.is_fast_enough());
    if let Some(rate) = rate {
        let (covered_s, total_s) = (
            sampling.covered_s,
            sampling.covered_s + sampling.uncovered_s,
        );
        return Some(format!(
            "the rate of {rate} frames per second covers only {covered_s:.1} s of {total_s:.1} s, too little to count the cycles of \
             a flight; {remaining}"
        ));
    }
    let rate = sampling
        .rate_hz
        .map_or("one frame is too few".to_owned(), |rate| {
            format!("{} frames per second is too low", format_general(rate))
        });
    Some(format!(
        "{rate} to count cycles of a {bending_hz} Hz bending mode; at least {} per second ({SAMPLES_PER_PERIOD} per \
         period) are needed; {remaining}",
        sampling.needed_hz
    ))
}

fn load_at_station(
    frames: &[StressFrame],
    section: &StiffnessSection,
    question: &StressQuery,
    sampling: &Sampling,
) -> Option<StationLoad> {
    let moments: Vec<BendingMoment> = frames
        .iter()
        .map(|frame| frame.curvature.bending_moment(section))
        .collect();
    let whole = stress::ground_air_ground(&moments)?;
    let counted = sampling
        .has_countable_cycles()
        .then(|| stress::count_flight_cycles(&moments));
    Some(StationLoad {
        s_m: section.s_m,
        ei_n_m2: section.ei_n_m2,
        greatest: find_extreme_load(frames, &moments, 1.0)?,
        smallest: find_extreme_load(frames, &moments, -1.0)?,
        ground_air_ground: whole,
        exceedances: exceedance_loads(&moments, question.levels, sampling),
        cycles: counted.as_ref().map(list_cycle_loads),
        smallest_range_n_m: counted.as_ref().map(|flight| flight.gate_n_m),
        cycles_excluded: counted.as_ref().map(|flight| flight.excluded),
        damage: counted
            .map(|flight| damage_at_station((&flight, sampling), &whole, section, question)),
    })
}

fn find_extreme_load(
    frames: &[StressFrame],
    moments: &[BendingMoment],
    sign: f64,
) -> Option<ExtremeLoad> {
    let (at, moment) = stress::extreme_moment(moments, sign)?;
    let frame = frames.get(at)?;
    Some(ExtremeLoad {
        moment_n_m: moment.value,
        sigma_moment_n_m: moment.sigma,
        sigma_by_stiffness_n_m: moment.sigma_by_stiffness,
        series: frame.series.clone(),
        image: frame.image.clone(),
        utc: frame.stamp.utc,
    })
}

fn exceedance_loads(
    moments: &[BendingMoment],
    levels: usize,
    sampling: &Sampling,
) -> Vec<ExceedanceLoad> {
    let one = |e: stress::Exceedance| ExceedanceLoad {
        level_n_m: e.level_n_m,
        frames_above: e.frames,
        upward_crossings: sampling.has_countable_cycles().then_some(e.crossings),
    };
    stress::count_exceedances(moments, levels)
        .into_iter()
        .map(one)
        .collect()
}

fn list_cycle_loads(flight: &FlightCycles) -> Vec<CycleLoad> {
    let mut all: Vec<CycleLoad> = flight
        .cycles
        .iter()
        .zip(&flight.sigmas_n_m)
        .map(|(cycle, sigma)| CycleLoad {
            range_n_m: cycle.range,
            sigma_range_n_m: *sigma,
            mean_n_m: cycle.mean,
            count: cycle.count,
        })
        .collect();
    sort_by_value(&mut all, |one| -one.range_n_m);
    all
}

fn damage_at_station(
    (flight, sampling): (&FlightCycles, &Sampling),
    whole: &GroundAirGround,
    section: &StiffnessSection,
    question: &StressQuery,
) -> Vec<Damage> {
    let line = section.ultimate_n_m.filter(|_| question.goodman);
    let goodman = line.map(|ultimate_n_m| GoodmanLine {
        ground_n_m: section.ground_n_m,
        ultimate_n_m,
    });
    let share = (
        section.sigma_ei_n_m2 / section.ei_n_m2,
        sampling.unseen_fractions(),
    );
    question
        .slopes
        .iter()
        .map(|slope| stress::relative_damage(flight, whole, *slope, goodman, share))
        .collect()
}
