//! Start of the live state from a first frame.

use std::sync::Arc;

use super::departure::ShapeDeparture;
use super::state::LiveState;
use crate::adjust::budget;
use crate::adjust::flight::frames::Flight;
use crate::adjust::flight::joint::JointSolution;
use crate::adjust::flight::knowledge::LiveModel;
use crate::adjust::flight::load_twist::LoadTwist;
use crate::adjust::flight::solving::SolvedFlight;
use crate::adjust::input::AdjustmentInput;
use crate::adjust::outcome::with_prior_if_consistent;
use crate::adjust::shapes::MEAN_SQUARE_BURNT;
use crate::adjust::snooping::SuspectTarget;
use crate::adjust::{AdjustResult, GlobalTest, Options, Solution};
use crate::estimation::AttributedInformation;

/// Curvature of a wing that stands on the ground with full tanks, 1/m: 0.5 m at the tip of a 32 m wing.
const STANDING_CURVATURE_PER_M: f64 = 1e-3;

/// State after one frame, with the frame's result.
pub struct InitialState {
    pub state: LiveState,
    /// Result of the frame.
    pub solution: Solution,
    /// True if the frame passes the global test with no observation removed.
    pub is_sound: bool,
}

/// Adjusts the first frame as a flight of one frame, with survey and ground frame, and with the prior from earlier flights
/// unless the frame contradicts it.
///
/// # Errors
/// Returns an error if the frame has no solution.
pub fn start_state(flight: &Flight) -> AdjustResult<InitialState> {
    let begin = |options: &Options| {
        initial_state_from_flight(Flight {
            input: AdjustmentInput {
                options,
                ..flight.input
            },
            ..flight.clone()
        })
    };
    with_prior_if_consistent(flight.input.options, begin, |initial| {
        std::slice::from_mut(&mut initial.solution)
    })
}

fn initial_state_from_flight(flight: Flight) -> AdjustResult<InitialState> {
    let joint = JointSolution::for_single_frame(flight)?;
    let solution = joint.first_solution(true);
    let JointSolution {
        solved, removed, ..
    } = joint;
    let is_sound = removed.is_empty() && solution.global_test != Some(GlobalTest::Rejected);
    let attributed = retained_information(&solved);
    let SolvedFlight {
        flight_problem,
        fit,
        ..
    } = solved;
    let amplitude_per_m = fit.groups[0].local[0].max(STANDING_CURVATURE_PER_M);
    let wrong = removed
        .iter()
        .map(|r| r.suspect)
        .filter(|s| s.target == SuspectTarget::Survey)
        .collect();
    let state = LiveState {
        known: fit.information_prior(),
        base: fit.information_prior(),
        model: LiveModel {
            layout: flight_problem.layouts[0].clone(),
            missing: flight_problem.problem.missing,
            // A gust adds lift to a weight that stays. Twice the load halves the part of all fuel in it, of which the prior
            // of burning has a random part.
            shape: flight_problem.shape.map(|shape| {
                shape.with_amplitude_range(MEAN_SQUARE_BURNT.sqrt() * amplitude_per_m)
            }),
            wrong,
        },
        attributed: Arc::new(attributed),
        local: fit.groups[0].local.clone(),
        twist: LoadTwist::default().with_frame(&flight_problem.layouts[0], &fit),
        departure: ShapeDeparture::initial(),
        frames: 1,
        accepted_frames: 1,
        rejected_frames: 0,
        rejected_s: 0.0,
        factor: 1.0,
    };
    Ok(InitialState {
        state,
        solution,
        is_sound,
    })
}

/// Information that keeps its source names in the state. Excluded are the mounting's rotation and the shape ratios, which
/// follow a random walk; the mounting's shift is included because each mounting starts with the same prior.
fn retained_information(
    SolvedFlight {
        flight_problem,
        fit,
        ..
    }: &SolvedFlight,
) -> AttributedInformation {
    let layout = &flight_problem.layouts[0];
    let rotation = layout.mounting.first..layout.mounting.first + 3;
    let shape = flight_problem.shape.as_ref();
    let ratios = shape.map_or(0..0, |shape| shape.columns.ratio_columns());
    let invariant = |column: usize| !rotation.contains(&column) && !ratios.contains(&column);
    budget::attribute_information(
        flight_problem.block_members(),
        &flight_problem.problem,
        fit,
        invariant,
    )
}
