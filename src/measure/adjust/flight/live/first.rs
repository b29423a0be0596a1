//! Where the state begins.

use super::departure::Departure;
use super::{Flight, Shape, State, known_of};
use crate::measure::adjust::flight::dress_frame;
use crate::measure::adjust::gauss_helmert::Course;
use crate::measure::adjust::snooping::Target;
use crate::measure::adjust::{AdjustError, GlobalTest, Solution};

/// The first frame is a flight of one, with survey and ground frame. Whether it is sound: it passes the global test, and nothing
/// of it is left out.
pub(super) fn first(flight: &mut Flight) -> Result<(State, Solution, bool), AdjustError> {
    let last = flight.solve(None)?;
    let snooped = flight.snoop(last)?;
    let (setting, fit, mut removed) = flight.snoop_again(snooped)?;
    let (_, rough) = flight.readmit((setting, fit), &mut removed)?;
    let setting = flight.setting(Some(&rough));
    let fit = setting.solve(flight.input.scene, &Course { rough: false, residuals: Some(&rough) })?;
    let (ratios, changes, lever) = (setting.ratios, setting.changes, setting.lever);
    let shape = Shape { ratios, changes, lever, shortening: setting.shortening, middle: setting.middle };
    let wrong = removed.iter().map(|(_, s)| *s).filter(|s| s.target == Target::Survey).collect();
    let state = State {
        known: known_of(&fit),
        base: known_of(&fit),
        layout: setting.layouts[0],
        missing: setting.problem.missing.clone(),
        shape,
        local: fit.groups[0].local.clone(),
        departure: Departure::assumed(),
        wrong,
        frames: 1,
        learnt: 1,
        doubts: 0,
        doubted_s: 0.0,
        factor: 1.0,
    };
    let solution = dress_frame(flight, &setting, &fit, &removed, 0, vec![]);
    let sound = removed.is_empty() && solution.global_test != GlobalTest::Rejected;
    Ok((state, solution, sound))
}
