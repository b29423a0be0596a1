//! Whether a layout reaches the standard deviation that is wanted, what its own comes from, and what would mend it, cheapest
//! first.

use serde::Serialize;

use super::prediction::{Expected, SimulatedFlight};
use super::{PlanOptions, fixed_marks, terms};
use crate::adjust::AdjustError;
use crate::adjust::flight_prior::FlightPrior;
use crate::setup::{Orientation, Setup, SurveyMarker};

/// What is wanted of a campaign.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Requirement {
    /// Standard deviation of the tip's deflection, m.
    pub sigma_m: f64,
    /// Frames of a flight adjusted together; 1: each by itself.
    pub frames: usize,
}

/// What a part of the variance comes from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Source {
    /// A term that the installation leaves open, or images and survey.
    pub source: String,
    /// Of the variance of the tip's deflection; together 1.
    pub share: f64,
}

/// Something that could be done.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Remedy {
    /// What.
    pub remedy: String,
    /// What it takes.
    pub cost: &'static str,
    /// The standard deviation of the tip's deflection with it alone, m.
    pub sigma_alone_m: Option<f64>,
    /// With it and those taken before it, m; `None` where it is not among those taken.
    pub sigma_taken_m: Option<f64>,
}

/// The answer to a wish.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Answer {
    /// Whether what was planned reaches it.
    pub reached: bool,
    /// What is wanted, m.
    pub want_m: f64,
    /// Frames adjusted together.
    pub frames: usize,
    /// What was planned gives, m.
    pub sigma_tip_deflection_m: f64,
    /// Where that comes from, the largest first.
    pub sources: Vec<Source>,
    /// What would lower it, cheapest first.
    pub remedies: Vec<Remedy>,
    /// Whether the proposal, with the remedies taken, reaches it.
    pub proposal_reached: bool,
    /// What the proposal gives, m.
    pub proposal_sigma_m: f64,
    /// Frames that the proposal adjusts together.
    pub proposal_frames: usize,
}

/// A campaign that may be planned.
#[derive(Clone)]
struct State {
    setup: Setup,
    /// The attitude; its sights are those of exact ground frames.
    orientation: Orientation,
    frames: usize,
}

/// A remedy gets its name from what it finds; `None` where there is nothing for it to do.
type Change = fn(&State, &PlanOptions) -> Option<(String, State)>;

/// Cheapest first; with what each takes.
const REMEDIES: [(&str, Change); 8] = [
    ("nothing", more_frames),
    ("nothing", camera_stays),
    ("a drawing", drawings),
    ("a thermometer", temperature),
    ("two decals and their survey", two_fixed_marks),
    ("two decals and their survey", two_fixed_marks),
    ("half a day with the total station", finer_survey),
    ("decals and their survey", more_markers),
];

/// A remedy that lowers the standard deviation by less is not worth its trouble, as a share of it.
const WORTH: f64 = 0.02;
/// Frames together from which on more hardly help; fewer than this are worth a remedy.
const FEW_FRAMES: usize = 10;
/// Standard deviations of what a drawing tells: heights, places along span and chord, m; directions, rad.
const DRAWN: (f64, f64, f64) = (0.01, 0.05, 1.75e-3);
/// Of a wing's temperature that is measured, K.
const MEASURED_K: f64 = 3.0;
/// Of a careful survey, m.
const FINE_SURVEY_M: f64 = 0.001;
/// Markers more, at once.
const MARKERS_MORE: usize = 6;

/// Answers a wish; the proposal's setup and attitude come back with it.
///
/// # Errors
/// Where the layout gives no wing, or no adjustment.
pub fn answer(
    setup: &Setup,
    orientation: Option<&Orientation>,
    options: &PlanOptions,
    wish: &Requirement,
) -> Result<(Answer, Setup, Orientation), AdjustError> {
    let first = SimulatedFlight::new(setup, orientation, options)?;
    let attitude = Orientation { ground: vec![], ..first.orientation };
    let planned = State { setup: setup.clone(), orientation: attitude, frames: wish.frames.max(1) };
    let sigma_m = worth(&planned, options)?.sigma_tip_deflection_m;
    let (remedies, proposal, proposal_m) = remedied(&planned, options, (sigma_m, wish.sigma_m));
    let answer = Answer {
        reached: sigma_m <= wish.sigma_m,
        want_m: wish.sigma_m,
        frames: planned.frames,
        sigma_tip_deflection_m: sigma_m,
        sources: sources(&planned, options, sigma_m),
        remedies,
        proposal_reached: proposal_m <= wish.sigma_m,
        proposal_sigma_m: proposal_m,
        proposal_frames: proposal.frames,
    };
    Ok((answer, proposal.setup, proposal.orientation))
}

/// What a layout is worth, its frames together where they are several. `orientation` tells the attitude alone; `None`: the
/// camera looks at the middle of the wing. `taught`: beside what earlier flights told.
///
/// # Errors
/// As [`answer`].
pub fn predict_precision(
    setup: &Setup,
    orientation: Option<&Orientation>,
    options: &PlanOptions,
    frames: usize,
    taught: Option<&FlightPrior>,
) -> Result<Expected, AdjustError> {
    let rehearsal = SimulatedFlight::new(setup, orientation, options)?;
    match (frames, taught) {
        (..=1, None) => rehearsal.alone(),
        _ => rehearsal.together(frames, taught),
    }
}

/// How the camera stands where no orientation tells it: it looks at the middle of the wing, upright.
///
/// # Errors
/// Where the survey gives no wing.
pub fn attitude(
    setup: &Setup,
    orientation: Option<&Orientation>,
    options: &PlanOptions,
) -> Result<Orientation, AdjustError> {
    Ok(SimulatedFlight::new(setup, orientation, options)?.orientation)
}

fn worth(state: &State, options: &PlanOptions) -> Result<Expected, AdjustError> {
    predict_precision(&state.setup, Some(&state.orientation), options, state.frames, None)
}

/// The remedies with what each brings alone and after those before it, and the proposal that takes as many as it needs.
fn remedied(
    planned: &State,
    options: &PlanOptions,
    (sigma_m, want_m): (f64, f64),
) -> (Vec<Remedy>, State, f64) {
    let (mut proposal, mut reached_m) = (planned.clone(), sigma_m);
    let mut all: Vec<Remedy> = Vec::new();
    for (cost, change) in REMEDIES {
        let tried = change(&proposal, options);
        let Some((remedy, next)) = tried else { continue };
        // By itself it may be another: two marks where the proposal has two already.
        let by_itself = change(planned, options).filter(|(other, _)| *other == remedy);
        let alone = by_itself.and_then(|(_, state)| worth(&state, options).ok());
        let mut taken_m = None;
        if reached_m > want_m
            && let Ok(better) = worth(&next, options)
            && better.sigma_tip_deflection_m < (1.0 - WORTH) * reached_m
        {
            (proposal, reached_m) = (next, better.sigma_tip_deflection_m);
            taken_m = Some(reached_m);
        }
        let sigma_alone_m = alone.map(|e| e.sigma_tip_deflection_m);
        if !all.iter().any(|known| known.remedy == remedy) {
            all.push(Remedy { remedy, cost, sigma_alone_m, sigma_taken_m: taken_m });
        }
    }
    (all, proposal, reached_m)
}

/// Of the variance what would be gone with each open term known; the rest is images and survey. Terms that stand for each
/// other take from each other: all are scaled to add up to 1.
fn sources(planned: &State, options: &PlanOptions, sigma_m: f64) -> Vec<Source> {
    let variance = |setup: &Setup| {
        let state = State { setup: setup.clone(), ..planned.clone() };
        worth(&state, options).ok().map(|e| (e.sigma_tip_deflection_m / sigma_m).powi(2))
    };
    let mut left = 1.0;
    let mut all: Vec<Source> = Vec::new();
    for (name, setup) in terms::each_known(&planned.setup) {
        let Some(rest) = variance(&setup).map(|rest| rest.min(1.0)) else { continue };
        if name == terms::ALL {
            left = rest;
            continue;
        }
        all.push(Source { source: name.to_owned(), share: 1.0 - rest });
    }
    if all.len() == 1 {
        left = 1.0 - all[0].share;
    }
    let sum: f64 = all.iter().map(|s| s.share).sum();
    let scale = if sum > 0.0 { (1.0 - left) / sum } else { 0.0 };
    all.iter_mut().for_each(|s| s.share *= scale);
    let known: f64 = all.iter().map(|s| s.share).sum();
    all.push(Source { source: "images, survey and the mounting's rotation".to_owned(), share: 1.0 - known });
    all.sort_by(|a, b| b.share.total_cmp(&a.share));
    all
}

fn more_frames(state: &State, _: &PlanOptions) -> Option<(String, State)> {
    let frames = if state.frames < FEW_FRAMES { FEW_FRAMES } else { 2 * state.frames };
    let remedy = format!("adjust {frames} frames of a flight together, with deflections from small to large");
    Some((remedy, State { frames, ..state.clone() }))
}

fn camera_stays(state: &State, _: &PlanOptions) -> Option<(String, State)> {
    let mut next = state.clone();
    (next.setup.uncertainty.mount_shift_m > 0.0).then(|| {
        next.setup.uncertainty.mount_shift_m = 0.0;
        ("leave the camera mounted from the ground frame to the flight".to_owned(), next)
    })
}

fn drawings(state: &State, _: &PlanOptions) -> Option<(String, State)> {
    let mut next = state.clone();
    let own = &mut next.setup.uncertainty;
    let (height_m, place_m, direction) = DRAWN;
    own.skin_height_sigma_m = own.skin_height_sigma_m.min(height_m);
    own.root_offset_m = own.root_offset_m.min(place_m);
    own.axis_chord_offset_m = own.axis_chord_offset_m.min(place_m);
    own.span_direction_rad = own.span_direction_rad.min(direction);
    let remedy = format!(
        "take the bending axis from drawings: its height to {height_m} m, root and chord offset to {place_m} m, the span's \
         direction to 0.1 deg"
    );
    (next.setup.uncertainty != state.setup.uncertainty).then_some((remedy, next))
}

fn temperature(state: &State, _: &PlanOptions) -> Option<(String, State)> {
    let mut next = state.clone();
    let usual = crate::setup::Thermal {
        expansion_per_k: 23.1e-6,
        expansion_sigma_per_k: None,
        ground_temperature_c: 15.0,
        flight_temperature_c: 15.0,
        flight_temperature_sigma_k: None,
    };
    let own = next.setup.thermal.get_or_insert(usual);
    let wide =
        state.setup.thermal.is_none() || own.flight_temperature_sigma_k.is_some_and(|s| s > MEASURED_K);
    own.flight_temperature_sigma_k = Some(MEASURED_K);
    wide.then(|| (format!("measure the wing's temperature to {MEASURED_K} K"), next))
}

fn two_fixed_marks(state: &State, options: &PlanOptions) -> Option<(String, State)> {
    let there = state.setup.markers.iter().filter(|m| m.fixed).count();
    let (setup, orientation) =
        fixed_marks::with_marks(&state.setup, &state.orientation, (there, 2, options.pixel_sigma))?;
    let count = setup.markers.iter().filter(|m| m.fixed).count();
    let orientation = Orientation { ground: vec![], ..orientation };
    let remedy = format!("{count} marks that are rigid to the cabin, in the frame's corners");
    (count > there).then_some((remedy, State { setup, orientation, ..state.clone() }))
}

fn finer_survey(state: &State, _: &PlanOptions) -> Option<(String, State)> {
    let mut next = state.clone();
    let finer = |sigma: f64| sigma.min(FINE_SURVEY_M);
    next.setup.markers.iter_mut().for_each(|m| m.sigma_m = finer(m.sigma_m));
    next.setup.projection_centre_sigma_m = finer(next.setup.projection_centre_sigma_m);
    let remedy = format!("survey markers and lens to {FINE_SURVEY_M} m");
    (next.setup != state.setup).then_some((remedy, next))
}

/// In the middle of the largest gaps along the span, on the straight line between the neighbours.
fn more_markers(state: &State, _: &PlanOptions) -> Option<(String, State)> {
    let mut next = state.clone();
    for k in 0..MARKERS_MORE {
        let mut wing = next.setup.on_the_wing();
        wing.sort_by(|a, b| a.1.x.total_cmp(&b.1.x));
        let gap = |pair: &&[(usize, nalgebra::Vector3<f64>)]| pair[1].1.x - pair[0].1.x;
        let widest = wing.windows(2).max_by(|a, b| gap(a).total_cmp(&gap(b)))?;
        let (a, b) = (next.setup.markers.get(widest[0].0)?, next.setup.markers.get(widest[1].0)?);
        let position_m = 0.5 * (a.position_m + b.position_m);
        let added = SurveyMarker { id: format!("N{:02}", k + 1), position_m, ..b.clone() };
        next.setup.markers.push(added);
    }
    Some((format!("{MARKERS_MORE} more markers, in the largest gaps along the span"), next))
}
