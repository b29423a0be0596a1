//! Where the state begins.

use std::sync::Arc;

use super::attempt::Model;
use super::departure::Departure;
use super::state::State;
use crate::adjust::budget;
use crate::adjust::flight::frames::Flight;
use crate::adjust::flight::joint::Joint;
use crate::adjust::flight::solving::Solved;
use crate::adjust::input::Input;
use crate::adjust::outcome::with_prior_if_consistent;
use crate::adjust::snooping::Target;
use crate::adjust::{AdjustError, GlobalTest, Method, Options, Solution};
use crate::estimation::AttributedInformation;

/// A gust that bends the wing by this, 1/m, as much as the usual flight does, may change the shape as much as burning
/// fuel: deflection and the weights' inertia answer it in their own times and places.
const LOAD_CURVATURE_PER_M: f64 = 5e-3;

/// A state of one frame.
pub struct InitialState {
    /// What it tells.
    pub state: State,
    /// Its result.
    pub solution: Solution,
    /// Whether it passes the global test, and nothing of it is left out.
    pub sound: bool,
}

/// The first frame is a flight of one, with survey and ground frame, and what earlier flights taught unless it contradicts
/// that.
pub fn first(flight: &Flight) -> Result<InitialState, AdjustError> {
    let begin =
        |options: &Options| begun(Flight { input: Input { options, ..flight.input }, ..flight.clone() });
    with_prior_if_consistent(flight.input.options, begin, |begun| std::slice::from_mut(&mut begun.solution))
}

fn begun(flight: Flight) -> Result<InitialState, AdjustError> {
    let joint = Joint::alone(flight)?;
    let solution = joint.solution(Method::Flight);
    let Joint { solved, removed, .. } = joint;
    let sound = removed.is_empty() && solution.global_test != GlobalTest::Rejected;
    let told = told(&solved);
    let Solved { setting, fit, .. } = solved;
    let wrong = removed.iter().map(|r| r.suspect).filter(|s| s.target == Target::Survey).collect();
    let state = State {
        known: fit.information_prior(),
        base: fit.information_prior(),
        model: Model {
            layout: setting.layouts[0].clone(),
            missing: setting.problem.missing,
            shape: setting.shape.of_amplitude(LOAD_CURVATURE_PER_M),
            wrong,
        },
        told: Arc::new(told),
        local: fit.groups[0].local.clone(),
        departure: Departure::assumed(),
        frames: 1,
        accepted_frames: 1,
        rejected_frames: 0,
        rejected_s: 0.0,
        factor: 1.0,
    };
    Ok(InitialState { state, solution, sound })
}

/// What keeps its name in the state: neither the mounting's rotation nor the shape's ratios, which walk. Its shift does: each
/// mounting begins with the same width.
fn told(Solved { setting, fit, .. }: &Solved) -> AttributedInformation {
    let (layout, shape) = (&setting.layouts[0], setting.shape.columns);
    let rotation = layout.own.first..layout.own.first + 3;
    let of_shape = shape.ratios..shape.changes;
    let lasting = |column: usize| !rotation.contains(&column) && !of_shape.contains(&column);
    budget::told(setting.blocks(), &setting.problem, fit, lasting)
}
