//! Where the state begins.

use super::departure::Departure;
use super::{Flight, Shape, State, known_of};
use crate::measure::adjust::flight::{dress_frame, shown};
use crate::measure::adjust::gauss_helmert::Course;
use crate::measure::adjust::snooping::Target;
use crate::measure::adjust::{AdjustError, Solution};

/// The first frame is a flight of one, with survey and ground frame. With it the square of its images' residuals, and their
/// redundancy.
pub(super) fn first(
    flight: &mut Flight,
    remarks: Vec<String>,
) -> Result<((State, Solution), (f64, f64)), AdjustError> {
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
    };
    let solution = dress_frame(flight, &setting, &fit, &removed, 0, remarks);
    let images = (0..setting.members[0].len()).filter_map(|block| shown(&setting, &fit, 0, block));
    let images = images.fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
    Ok(((state, solution), images))
}
