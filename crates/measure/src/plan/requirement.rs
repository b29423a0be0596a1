//! Check of a required standard deviation: whether a layout meets it, an uncertainty budget, and possible improvements,
//! cheapest first.

use serde::Serialize;

use super::precision::LayoutPrecision;
use super::prediction::SimulatedFlight;
use super::{PlanOptions, fixed_targets};
use crate::adjust::flight_prior::FlightPrior;
use crate::adjust::{AdjustResult, Solution, VarianceShare};
use crate::ordering::sort_by_value;
use crate::setup::{Orientation, Setup, SurveyMarker, Width};

/// A required precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Requirement {
    /// Required standard deviation of the tip's deflection, m.
    pub sigma_m: f64,
    /// Number of frames of a flight adjusted together; 1: each frame alone.
    pub frames: usize,
}

/// A possible improvement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Remedy {
    /// Description of the improvement.
    pub remedy: String,
    /// Cost of the improvement.
    pub cost: &'static str,
    /// Standard deviation of the tip's deflection with this improvement alone, m.
    pub sigma_alone_m: Option<f64>,
    /// Standard deviation with this and the accepted improvements before it, m; `None` if it is not accepted.
    pub sigma_taken_m: Option<f64>,
}

/// Result of the check of a requirement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RequirementResult {
    /// Whether the planned layout meets the requirement and can be measured.
    pub reached: bool,
    /// Reason why the planned layout cannot be measured; `None` if it can.
    pub obstacle: Option<String>,
    /// Required standard deviation, m.
    pub want_m: f64,
    /// Number of frames adjusted together.
    pub frames: usize,
    /// Standard deviation of the planned layout, m; NaN if it cannot be adjusted.
    pub sigma_tip_deflection_m: f64,
    /// Uncertainty budget of the reported deflection of the planned layout, largest contribution first.
    pub sources: Vec<VarianceShare>,
    /// Possible improvements, cheapest first.
    pub remedies: Vec<Remedy>,
    /// Whether the proposal, with the accepted improvements, meets the requirement.
    pub proposal_reached: bool,
    pub proposal_sigma_m: f64,
    /// Number of frames that the proposal adjusts together.
    pub proposal_frames: usize,
}

/// Installation, attitude and number of frames of a possible flight.
#[derive(Clone)]
struct Campaign {
    setup: Setup,
    /// Attitude; its observations are those of exact ground frames.
    orientation: Orientation,
    frames: usize,
}

/// An improvement: returns its description and the improved campaign, or `None` if there is nothing to improve.
type RemedyAction = fn(&Campaign, &PlanOptions) -> Option<(String, Campaign)>;

/// Improvements with their costs, cheapest first.
const REMEDY_ACTIONS: [(&str, RemedyAction); 8] = [
    ("nothing", propose_more_frames),
    ("nothing", propose_keeping_camera_mounted),
    ("a drawing", propose_drawings),
    ("a thermometer", propose_measuring_temperature),
    ("two decals and their survey", propose_two_fixed_targets),
    ("two decals and their survey", propose_two_fixed_targets),
    ("half a day with the total station", propose_finer_survey),
    ("decals and their survey", add_markers),
];

/// Smallest relative decrease of the standard deviation for which an improvement is accepted.
const MIN_IMPROVEMENT: f64 = 0.02;
/// Number of frames from which on more frames hardly help; with fewer, more frames are proposed.
const FEW_FRAMES: usize = 10;
/// Standard deviations of drawings: heights, positions along span and chord, m; directions, rad.
const DRAWING_SIGMAS: (f64, f64, f64) = (0.01, 0.05, 1.75e-3);
/// Standard deviation of a measured wing temperature, K.
const MEASURED_TEMPERATURE_SIGMA_K: f64 = 3.0;
/// Standard deviation of a careful survey, m.
const FINE_SURVEY_SIGMA_M: f64 = 0.001;
/// Number of markers that are added at once.
const ADDITIONAL_MARKERS: usize = 6;

/// Checks a requirement. Returns the result with setup and attitude of the proposal.
///
/// # Errors
/// Returns an error if the layout gives no wing, or no adjustment for another reason than its obstacle.
pub fn check_requirement(
    setup: &Setup,
    orientation: Option<&Orientation>,
    options: &PlanOptions,
    requirement: &Requirement,
) -> AdjustResult<(RequirementResult, Setup, Orientation)> {
    let first = SimulatedFlight::new(setup, orientation, options)?;
    let obstacle = first.find_obstacle();
    let attitude = Orientation {
        ground: vec![],
        ..first.orientation
    };
    let planned = Campaign {
        setup: setup.clone(),
        orientation: attitude,
        frames: requirement.frames.max(1),
    };
    let (sigma_m, sources) = match planned.adjust(options) {
        Ok((sigma_m, solution)) => {
            let budget = solution.budget.map(|budget| budget.shares);
            (sigma_m, budget.unwrap_or_default())
        }
        Err(_) if obstacle.is_some() => (f64::NAN, vec![]),
        Err(error) => return Err(error),
    };
    let (remedies, proposal, proposal_m) =
        apply_remedies(&planned, options, (sigma_m, requirement.sigma_m));
    let proposal_obstacle =
        SimulatedFlight::new(&proposal.setup, Some(&proposal.orientation), options)?
            .find_obstacle();
    let answer = RequirementResult {
        reached: sigma_m <= requirement.sigma_m && obstacle.is_none(),
        obstacle,
        want_m: requirement.sigma_m,
        frames: planned.frames,
        sigma_tip_deflection_m: sigma_m,
        sources,
        remedies,
        proposal_reached: proposal_m <= requirement.sigma_m && proposal_obstacle.is_none(),
        proposal_sigma_m: proposal_m,
        proposal_frames: proposal.frames,
    };
    Ok((answer, proposal.setup, proposal.orientation))
}

/// Predicts the precision of a layout, with several frames adjusted together. Only the attitude of `orientation` is used;
/// without it the camera looks at the middle of the wing. `flight_prior`: prior from earlier flights.
///
/// # Errors
/// Returns an error if the layout gives no wing or no adjustment.
pub fn predict_precision(
    setup: &Setup,
    orientation: Option<&Orientation>,
    options: &PlanOptions,
    frames: usize,
    flight_prior: Option<&FlightPrior>,
) -> AdjustResult<LayoutPrecision> {
    let simulation = SimulatedFlight::new(setup, orientation, options)?;
    simulation.layout_precision(&simulation.adjust(frames, flight_prior)?)
}

/// Returns the attitude of the camera; without an orientation it looks at the middle of the wing, upright.
///
/// # Errors
/// Returns an error if the survey gives no wing.
pub fn assumed_attitude(
    setup: &Setup,
    orientation: Option<&Orientation>,
    options: &PlanOptions,
) -> AdjustResult<Orientation> {
    Ok(SimulatedFlight::new(setup, orientation, options)?.orientation)
}

impl Campaign {
    /// Returns the standard deviation of the tip's deflection, m, and the solution of the frame with the largest one.
    fn adjust(&self, options: &PlanOptions) -> AdjustResult<(f64, Solution)> {
        let simulation = SimulatedFlight::new(&self.setup, Some(&self.orientation), options)?;
        let solution = simulation.adjust(self.frames, None)?;
        let precision = simulation.layout_precision(&solution)?;
        Ok((precision.sigma_tip_deflection_m, solution))
    }
}

/// Evaluates each improvement alone and after those before it, and builds the proposal from as many as it needs.
fn apply_remedies(
    planned: &Campaign,
    options: &PlanOptions,
    (sigma_m, want_m): (f64, f64),
) -> (Vec<Remedy>, Campaign, f64) {
    let (mut proposal, mut reached_m) = (planned.clone(), sigma_m);
    let mut all: Vec<Remedy> = Vec::new();
    for (cost, change) in REMEDY_ACTIONS {
        let tried = change(&proposal, options);
        let Some((remedy, next)) = tried else {
            continue;
        };
        // Alone it may be another improvement: two targets if the proposal already has two.
        let change_alone = change(planned, options).filter(|(other, _)| *other == remedy);
        let alone = change_alone.and_then(|(_, campaign)| campaign.adjust(options).ok());
        let mut taken_m = None;
        if reached_m > want_m
            && let Ok((better_m, _)) = next.adjust(options)
            && better_m < (1.0 - MIN_IMPROVEMENT) * reached_m
        {
            (proposal, reached_m) = (next, better_m);
            taken_m = Some(reached_m);
        }
        let sigma_alone_m = alone.map(|(sigma_m, _)| sigma_m);
        if !all.iter().any(|known| known.remedy == remedy) {
            all.push(Remedy {
                remedy,
                cost,
                sigma_alone_m,
                sigma_taken_m: taken_m,
            });
        }
    }
    (all, proposal, reached_m)
}

fn propose_more_frames(campaign: &Campaign, _: &PlanOptions) -> Option<(String, Campaign)> {
    let frames = if campaign.frames < FEW_FRAMES {
        FEW_FRAMES
    } else {
        2 * campaign.frames
    };
    let remedy =
        format!("adjust {frames} frames of a flight jointly, with deflections from small to large");
    Some((
        remedy,
        Campaign {
            frames,
            ..campaign.clone()
        },
    ))
}

fn propose_keeping_camera_mounted(
    campaign: &Campaign,
    _: &PlanOptions,
) -> Option<(String, Campaign)> {
    let mut next = campaign.clone();
    (next.setup.uncertainty[Width::MountShift] > 0.0).then(|| {
        next.setup.uncertainty[Width::MountShift] = 0.0;
        (
            "keep the camera mounted between the ground frame and the flight".to_owned(),
            next,
        )
    })
}

fn propose_drawings(campaign: &Campaign, _: &PlanOptions) -> Option<(String, Campaign)> {
    let mut next = campaign.clone();
    let uncertainty = &mut next.setup.uncertainty;
    let (height_m, position_m, direction) = DRAWING_SIGMAS;
    for (width, sigma) in [
        (Width::SkinHeight, height_m),
        (Width::RootOffset, position_m),
        (Width::ChordOffset, position_m),
        (Width::SpanDirection, direction),
    ] {
        uncertainty[width] = uncertainty[width].min(sigma);
    }
    let remedy = format!(
        "take the bending axis from drawings: its height to {height_m} m, root and chord offset to {position_m} m, the span's \
         direction to 0.1 deg"
    );
    (next.setup.uncertainty != campaign.setup.uncertainty).then_some((remedy, next))
}

fn propose_measuring_temperature(
    campaign: &Campaign,
    _: &PlanOptions,
) -> Option<(String, Campaign)> {
    let mut next = campaign.clone();
    let default = crate::setup::Thermal {
        expansion_per_k: 23.1e-6,
        expansion_sigma_per_k: None,
        ground_temperature_c: 15.0,
        flight_temperature_c: 15.0,
        flight_temperature_sigma_k: None,
    };
    let thermal = next.setup.thermal.get_or_insert(default);
    let is_uncertain = campaign.setup.thermal.is_none()
        || thermal
            .flight_temperature_sigma_k
            .is_some_and(|s| s > MEASURED_TEMPERATURE_SIGMA_K);
    thermal.flight_temperature_sigma_k = Some(MEASURED_TEMPERATURE_SIGMA_K);
    is_uncertain.then(|| {
        (
            format!("measure the wing's temperature to {MEASURED_TEMPERATURE_SIGMA_K} K"),
            next,
        )
    })
}

fn propose_two_fixed_targets(
    campaign: &Campaign,
    options: &PlanOptions,
) -> Option<(String, Campaign)> {
    let existing = campaign.setup.markers.iter().filter(|m| m.fixed).count();
    let taken = SimulatedFlight::new(&campaign.setup, Some(&campaign.orientation), options)
        .ok()?
        .taken_places();
    let request = (existing, 2, options.pixel_sigma);
    let (setup, orientation) =
        fixed_targets::add_fixed_targets(&campaign.setup, &campaign.orientation, request, &taken)?;
    let count = setup.markers.iter().filter(|m| m.fixed).count();
    let orientation = Orientation {
        ground: vec![],
        ..orientation
    };
    let remedy = format!("{count} fixed targets, rigid to the cabin, in the corners of the frame");
    (count > existing).then_some((
        remedy,
        Campaign {
            setup,
            orientation,
            ..campaign.clone()
        },
    ))
}

fn propose_finer_survey(campaign: &Campaign, _: &PlanOptions) -> Option<(String, Campaign)> {
    let mut next = campaign.clone();
    let reduced = |sigma: f64| sigma.min(FINE_SURVEY_SIGMA_M);
    next.setup
        .markers
        .iter_mut()
        .for_each(|m| m.sigma_m = reduced(m.sigma_m));
    next.setup.projection_centre_sigma_m = reduced(next.setup.projection_centre_sigma_m);
    let remedy = format!("survey markers and lens to {FINE_SURVEY_SIGMA_M} m");
    (next.setup != campaign.setup).then_some((remedy, next))
}

/// Adds markers in the middle of the largest gaps along the span, on the straight line between the neighbours.
fn add_markers(campaign: &Campaign, _: &PlanOptions) -> Option<(String, Campaign)> {
    let mut next = campaign.clone();
    for k in 0..ADDITIONAL_MARKERS {
        let mut wing = next.setup.wing_markers();
        sort_by_value(&mut wing, |one| one.1.x);
        let gap = |pair: &&[(usize, nalgebra::Vector3<f64>)]| pair[1].1.x - pair[0].1.x;
        let widest = wing.windows(2).max_by(|a, b| gap(a).total_cmp(&gap(b)))?;
        let (a, b) = (
            next.setup.markers.get(widest[0].0)?,
            next.setup.markers.get(widest[1].0)?,
        );
        let position_m = 0.5 * (a.position_m + b.position_m);
        let added = SurveyMarker {
            id: format!("N{:02}", k + 1),
            position_m,
            ..b.clone()
        };
        next.setup.markers.push(added);
    }
    Some((
        format!("{ADDITIONAL_MARKERS} more markers, in the largest gaps along the span"),
        next,
    ))
}
