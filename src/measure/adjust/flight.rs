//! The frames of a flight adjusted together (docs/model.md).
//!
//! Shared: the markers on ground, camera and ground rotation, one rotation per mounting, the ratios
//! of the curvature's coefficients. Per frame, local to its group: coefficients of curvature and
//! twist. Until mountings are found, each frame may leave the rotation that all have in common. A
//! frame's curvature may leave the shared shape by a share of its amplitude; that share is found from
//! the data. Frames leave the normal equations by their Schur complement, so the cost is linear in
//! their number.
//!
//! | step | file |
//! |---|---|
//! | what is taken for granted until a solution shows it | `assumed.rs`, `mountings.rs` |
//! | what takes part | `usage.rs` |
//! | observations, unknowns, conditions, solutions | `frames.rs`, `setting.rs`, `shape.rs`, `solving.rs`, `joint.rs` |
//! | blunders | `blunders.rs` |
//! | departure, drift, remounts and unstated widths from the data | `tuning.rs`, `widths.rs` |
//! | a frame's result | `dressing.rs` |
//! | frame by frame | `live.rs` |
//! | what it tells later flights | `learning.rs` |

mod blunders;
mod flight_information;
mod flight_problem;
mod frame_solution;
mod frames;
mod hyperparameters;
mod joint;
mod live;
mod mountings;
mod prior_scaling;
mod shape;
mod solving;
mod tuning;
mod usage;

pub use flight_information::learn;
pub use live::Live;

use self::frames::Flight;
use self::hyperparameters::FlightHyperparameters;
use self::joint::Joint;
use self::mountings::Mountings;
use super::input::Input;
use super::outcome::with_prior_if_consistent;
use super::scene::Scene;
use super::terms::MIN_DRIFT_RAD;
use super::{AdjustError, Method, Observation, Options, Solution};
use crate::setup::{Orientation, Setup};

/// The rigid-section beam, all frames together; one solution per frame.
pub fn solve(
    setup: &Setup,
    orientation: &Orientation,
    frames: &[Vec<Observation>],
    options: &Options,
) -> Result<Vec<Solution>, AdjustError> {
    if frames.is_empty() {
        return Ok(vec![]);
    }
    let scene = Scene::new(setup, orientation)?;
    let solve = |options: &Options| {
        let joint = Joint::new(Input { setup, orientation, scene: &scene, options }, frames)?;
        Ok(joint.solutions())
    };
    with_prior_if_consistent(options, solve, |solutions| solutions)
}

/// One frame beside what earlier flights told: a flight of one.
pub fn one(input: &Input, frame: &[Observation]) -> Result<Solution, AdjustError> {
    let frames = [frame.to_vec()];
    let solve = |options: &Options| {
        let input = Input { options, ..*input };
        let mountings = Mountings::of_one(options.mountings.as_deref());
        // Its rotation is its mounting's, which has drifted since the ground frames where the camera stayed.
        let mut assumed = FlightHyperparameters::at_first(&input, 1, mountings);
        assumed.drift_rad = MIN_DRIFT_RAD;
        let joint = Joint::alone(Flight::new(input, &frames, assumed)?)?;
        Ok(joint.solution(Method::Spatial))
    };
    with_prior_if_consistent(input.options, solve, std::slice::from_mut)
}
