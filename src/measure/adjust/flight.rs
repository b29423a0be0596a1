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
//! | observations, unknowns, conditions, solutions | `frames.rs`, `setting.rs`, `shape.rs`, `solving.rs` |
//! | blunders | `blunders.rs` |
//! | departure, drift, remounts and unstated widths from the data | `tuning.rs`, `widths.rs` |
//! | a frame's result | `dressing.rs` |
//! | frame by frame | `live.rs` |

mod assumed;
mod blunders;
mod dressing;
mod frames;
mod live;
mod mountings;
mod setting;
mod shape;
mod solving;
mod tuning;
mod usage;
mod widths;

pub use live::Live;

use self::assumed::Assumed;
use self::dressing::{dressed, flight_remarks, with_sources};
use self::frames::Flight;
use self::mountings::Mountings;
use super::input::Input;
use super::scene::Scene;
use super::{AdjustError, Observation, Options, Solution};
use crate::setup::{Orientation, Setup};

/// Rounds in which departure and drift settle once the mountings are found.
const DEPARTURE_ROUNDS: usize = 3;

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
    let input = Input { setup, orientation, scene: &scene, options };
    let assumed = Assumed::at_first(&input, frames.len(), Mountings::unknown(options.mountings.as_deref()));
    let mut flight = Flight::new(input, frames, assumed)?;
    let (solved, mut removed) = flight.without_blunders()?;
    let solved = flight.tune(solved, 1)?;
    flight.find_mountings(&solved);
    let solved = flight.solve(Some(&solved.fit))?;
    let solved = flight.readmit(solved, &mut removed)?;
    let rough = flight.tune(solved, DEPARTURE_ROUNDS)?;
    let solved = flight.finish(&rough.fit)?;
    Ok(with_sources(&solved, None, |sources| {
        let one = |frame: usize| {
            dressed(&flight, &solved, &removed, frame, flight_remarks(&flight, frame), sources)
        };
        (0..frames.len()).map(one).collect()
    }))
}
