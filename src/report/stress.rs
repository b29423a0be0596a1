//! The moments of a flight at the stations of the structure say what it meant for wear (docs/stress.md).

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::number::general;
use crate::clock::Stamp;
use crate::measure::stress::{
    self, Curvature, Damage, Goodman, GroundAirGround, Moment, OverAFlight, SAMPLES_PER_PERIOD, Sampling,
    Section,
};
use crate::record::ImageRecord;

/// A solved frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Its series.
    pub series: String,
    /// File in the series' folder.
    pub image: String,
    /// When it was exposed; where that is not recorded, when the camera was asked.
    pub stamp: Stamp,
    /// Its bending line.
    pub curvature: Curvature,
}

/// What is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Question {
    /// Where.
    pub sections: Vec<Section>,
    /// The wing's lowest bending frequency, Hz.
    pub bending_hz: f64,
    /// Slopes of S-N curves.
    pub slopes: Vec<f64>,
    /// Correct for the mean by Goodman's line.
    pub goodman: bool,
    /// Levels of the exceedances.
    pub levels: usize,
}

/// A flight's answer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FlightLoad {
    /// Frames with a moment.
    pub frames: usize,
    /// Frames a second, by the median interval; `null` with fewer than two.
    pub rate_hz: Option<f64>,
    /// What cycles need: ten frames a period of the lowest bending.
    pub needed_hz: f64,
    /// Where frames are missing.
    pub gaps: Gaps,
    /// Why no cycles are counted; `null` where they are.
    pub no_cycles_because: Option<String>,
    /// From root to tip.
    pub stations: Vec<StationLoad>,
}

/// Where frames are missing, and what is told of cycles.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Gaps {
    /// Intervals longer than one and a half usual ones.
    pub count: usize,
    /// The longest, s; 0 without one.
    pub longest_s: f64,
    /// Time whose cycles are counted, s.
    pub told_s: f64,
    /// Time whose cycles are not, s.
    pub untold_s: f64,
}

impl Gaps {
    fn of(sampling: &Sampling) -> Self {
        let Sampling { gaps, longest_gap_s, told_s, untold_s, .. } = *sampling;
        let (told_s, untold_s) = match sampling.tells_cycles() {
            true => (told_s, untold_s),
            false => (0.0, told_s + untold_s),
        };
        Self { count: gaps, longest_s: longest_gap_s, told_s, untold_s }
    }

    /// For people; `None` without a gap.
    #[must_use]
    pub fn said(&self) -> Option<String> {
        let minutes = |s: f64| format!("{:.1} min", s / 60.0);
        let (told, untold) = (minutes(self.told_s), minutes(self.untold_s));
        (self.count > 0).then(|| {
            format!(
                "{} gaps between frames, the longest {:.1} s; cycles are told over {told}, not over {untold}: those are \
                 not in the damage, and in its standard deviation as if they were like the others",
                self.count, self.longest_s
            )
        })
    }
}

/// At one station. Moments are the change against ground, N m, positive where they bend the tip up.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StationLoad {
    /// From the bending root, m.
    pub s_m: f64,
    /// N m^2.
    pub ei_n_m2: f64,
    /// The greatest.
    pub greatest: ExtremeLoad,
    /// The smallest.
    pub smallest: ExtremeLoad,
    /// From the ground to the extreme and back.
    pub ground_air_ground: GroundAirGround,
    /// Levels from low to high.
    pub exceedances: Vec<ExceedanceLoad>,
    /// Rainflow cycles, largest first; `null` where the sampling shows none.
    pub cycles: Option<Vec<CycleLoad>>,
    /// Smallest range counted, N m.
    pub smallest_range_n_m: Option<f64>,
    /// Cycles below it.
    pub cycles_left_out: Option<f64>,
    /// One for each slope; `null` as above.
    pub damage: Option<Vec<Damage>>,
}

/// An extreme moment and its frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExtremeLoad {
    /// N m.
    pub moment_n_m: f64,
    /// N m.
    pub sigma_moment_n_m: f64,
    /// Of it, from the stiffness, N m: common to all frames.
    pub sigma_by_stiffness_n_m: f64,
    /// The frame's series.
    pub series: String,
    /// The frame.
    pub image: String,
    /// When.
    pub utc: jiff::Timestamp,
}

/// How often a level was exceeded.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ExceedanceLoad {
    /// N m.
    pub level_n_m: f64,
    /// Frames above.
    pub frames_above: usize,
    /// Upward crossings; `null` where the sampling shows none.
    pub upward_crossings: Option<usize>,
}

/// A rainflow cycle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CycleLoad {
    /// N m.
    pub range_n_m: f64,
    /// From the curvature, N m.
    pub sigma_range_n_m: f64,
    /// N m.
    pub mean_n_m: f64,
    /// 1 or 0.5.
    pub count: f64,
}

/// The coefficients of a record's bending line, 1/m, with their covariance, 1/m^2.
///
/// # Errors
/// Where there are none.
pub fn coefficients(record: &ImageRecord) -> Result<(DVector<f64>, DMatrix<f64>), NoCurvature> {
    if !record.is_solved() {
        return Err(NoCurvature::Unsolved);
    }
    let terms = &record.model.curvature_per_m;
    if terms.is_empty() || terms.iter().any(|term| term.value.is_nan()) {
        return Err(NoCurvature::OtherMethod);
    }
    let place = |k: usize| format!("curvature_per_m[{k}]");
    let sigma = |k: usize| terms[k].sigma.unwrap_or(0.0);
    let entry = |i: usize, j: usize| record.quality.correlation.as_ref()?.of(&place(i), &place(j));
    let mut covariance = DMatrix::zeros(terms.len(), terms.len());
    for i in 0..terms.len() {
        for j in 0..terms.len() {
            // A coefficient that was held varies with none.
            let held = sigma(i) == 0.0 || sigma(j) == 0.0;
            let correlated = if i == j { Some(1.0) } else { entry(i, j) };
            covariance[(i, j)] = match (held, correlated) {
                (true, _) => 0.0,
                (false, Some(r)) => r * sigma(i) * sigma(j),
                (false, None) => return Err(NoCurvature::NoCorrelations),
            };
        }
    }
    Ok((DVector::from_iterator(terms.len(), terms.iter().map(|m| m.value)), covariance))
}

/// Why a result has no bending line to take moments from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoCurvature {
    /// It has no numbers.
    #[error("it was not solved")]
    Unsolved,
    /// The published parabola is no beam.
    #[error("its result has no curvature: solve it with --method spatial")]
    OtherMethod,
    /// A program that did not write them.
    #[error("its result has no correlations: solve it again")]
    NoCorrelations,
}

/// Seconds from the first frame: time since boot within a boot, UTC from boot to boot.
pub fn seconds<'a>(stamps: impl Iterator<Item = &'a Stamp>) -> Vec<f64> {
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

/// The answer for frames in order of time; `None` without one.
pub fn of(frames: &[Frame], question: &Question) -> Option<FlightLoad> {
    let times_s = seconds(frames.iter().map(|frame| &frame.stamp));
    let sampling = stress::sampling(&times_s, question.bending_hz);
    let station = |section: &Section| station(frames, section, question, &sampling);
    let stations = question.sections.iter().map(station).collect::<Option<Vec<_>>>();
    Some(FlightLoad {
        frames: frames.len(),
        rate_hz: sampling.rate_hz,
        needed_hz: sampling.needed_hz,
        gaps: Gaps::of(&sampling),
        no_cycles_because: no_cycles(&sampling, question.bending_hz),
        stations: stations?,
    })
}

fn no_cycles(sampling: &Sampling, bending_hz: f64) -> Option<String> {
    if sampling.tells_cycles() {
        return None;
    }
    let still = "extremes and the ground-air-ground cycle are of the frames there are";
    let rate = sampling.rate_hz.map(general).filter(|_| sampling.is_fast_enough());
    if let Some(rate) = rate {
        let (told, all) = (sampling.told_s, sampling.told_s + sampling.untold_s);
        return Some(format!(
            "frames come at {rate} a second over {told:.1} s of {all:.1} s only, which tells no cycles of a flight; {still}"
        ));
    }
    let rate =
        sampling.rate_hz.map_or("one frame".to_owned(), |rate| format!("{} frames a second", general(rate)));
    Some(format!(
        "{rate} tell no cycles of a wing that bends at {bending_hz} Hz and above: {} a second are needed, \
         {SAMPLES_PER_PERIOD} a period; {still}",
        sampling.needed_hz
    ))
}

fn station(
    frames: &[Frame],
    section: &Section,
    question: &Question,
    sampling: &Sampling,
) -> Option<StationLoad> {
    let moments: Vec<Moment> = frames.iter().map(|frame| frame.curvature.moment(section)).collect();
    let whole = stress::ground_air_ground(&moments)?;
    let counted = sampling.tells_cycles().then(|| stress::over_a_flight(&moments));
    Some(StationLoad {
        s_m: section.s_m,
        ei_n_m2: section.ei_n_m2,
        greatest: extreme(frames, &moments, 1.0)?,
        smallest: extreme(frames, &moments, -1.0)?,
        ground_air_ground: whole,
        exceedances: exceedances(&moments, question.levels, sampling),
        cycles: counted.as_ref().map(cycles),
        smallest_range_n_m: counted.as_ref().map(|flight| flight.gate_n_m),
        cycles_left_out: counted.as_ref().map(|flight| flight.left_out),
        damage: counted.map(|flight| damage((&flight, sampling), &whole, section, question)),
    })
}

fn extreme(frames: &[Frame], moments: &[Moment], sign: f64) -> Option<ExtremeLoad> {
    let (at, moment) = stress::extreme(moments, sign)?;
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

fn exceedances(moments: &[Moment], levels: usize, sampling: &Sampling) -> Vec<ExceedanceLoad> {
    let one = |e: stress::Exceedance| ExceedanceLoad {
        level_n_m: e.level_n_m,
        frames_above: e.frames,
        upward_crossings: sampling.tells_cycles().then_some(e.crossings),
    };
    stress::exceedances(moments, levels).into_iter().map(one).collect()
}

fn cycles(flight: &OverAFlight) -> Vec<CycleLoad> {
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
    all.sort_by(|a, b| b.range_n_m.total_cmp(&a.range_n_m));
    all
}

fn damage(
    (flight, sampling): (&OverAFlight, &Sampling),
    whole: &GroundAirGround,
    section: &Section,
    question: &Question,
) -> Vec<Damage> {
    let line = section.ultimate_n_m.filter(|_| question.goodman);
    let goodman = line.map(|ultimate_n_m| Goodman { ground_n_m: section.ground_n_m, ultimate_n_m });
    let share = (section.sigma_ei_n_m2 / section.ei_n_m2, sampling.unseen());
    question.slopes.iter().map(|slope| stress::damage(flight, whole, *slope, goodman, share)).collect()
}
