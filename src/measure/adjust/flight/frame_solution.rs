//! A frame's result from a flight's solution.

use super::frames::Flight;
use super::solving::Solved;
use super::tuning::STEADY_RAD;
use super::usage::Removed;
use crate::adjust::budget;
use crate::adjust::outcome::Outcome;
use crate::adjust::snooping::{Target, widened_marks};
use crate::adjust::terms::stated_drift_rad;
use crate::adjust::{Estimate, Method, Parameter, Solution};
use crate::estimation::{AttributedInformation, Sources};

/// A drift so many times what is stated is remarked.
const DOUBTED_DRIFT: f64 = 3.0;

/// One frame's part of a solution, with what was removed from it or from all frames, after what else is remarked.
pub fn frame_solution(
    flight: &Flight,
    solved: &Solved,
    removed: &[Removed],
    frame: usize,
    remarks: Vec<String>,
    sources: &Sources,
) -> Solution {
    let mut solution =
        single_frame_solution(flight, solved, removed, (frame, Method::Flight), remarks, sources);
    let unmeasured = |name, value| Parameter { name, values: vec![Estimate { value, sigma: None }] };
    solution.parameters.push(unmeasured("shape_departure", flight.assumed.departure));
    solution.parameters.push(unmeasured("mount_drift_rad", flight.assumed.drift_rad));
    solution
}

/// The same without what frames show of one another.
pub fn single_frame_solution(
    flight: &Flight,
    Solved { setting, fit, judged }: &Solved,
    removed: &[Removed],
    (frame, method): (usize, Method),
    mut remarks: Vec<String>,
    sources: &Sources,
) -> Solution {
    let (layout, members) = (&setting.layouts[frame], &setting.members[frame]);
    let outcome = Outcome::new(&flight.input, layout, &setting.problem, fit, frame, members).judged(*judged);
    let of_frame = removed.iter().filter(|r| r.group == frame || r.suspect.target == Target::Survey);
    let solution = outcome.solution(method, of_frame.map(|r| &r.suspect), sources);
    remarks.extend(solution.remarks);
    remarks.extend(widened_marks(flight.factors.marks));
    let caused = flight.cause.as_ref().zip(setting.cause);
    remarks.extend(caused.map(|(cause, column)| cause.sentence(fit.global[column])));
    remarks.extend(flight.exceedance_remarks());
    Solution { remarks, ..solution }
}

/// Calls `with` with all that a flight's solution rests on.
pub fn with_sources<T>(
    Solved { setting, fit, .. }: &Solved,
    told: Option<&AttributedInformation>,
    with: impl FnOnce(&Sources) -> T,
) -> T {
    budget::with_sources(setting.blocks(), &setting.problem, fit, told, with)
}

/// What is remarked of what earlier flights taught.
pub fn beside(flight: &Flight, solved: &Solved) -> Vec<String> {
    let taught = flight.input.options.flight_prior.as_deref();
    taught.map(|taught| taught.remark(solved.setting.problem.known.is_some())).into_iter().collect()
}

/// What is remarked of a frame among the others.
pub fn flight_remarks(flight: &Flight, frame: usize) -> Vec<String> {
    let assumed = &flight.assumed;
    let mountings = &assumed.mountings;
    let by = if mountings.are_stated() { "as stated" } else { "by evidence" };
    let mut remarks = vec![format!(
        "adjusted with {} frames in {} mounting(s), {by}, this one in mounting {}; shapes depart from the shared one by {:.1} % of the usual spread",
        flight.frames.len(),
        mountings.count(),
        mountings.of(frame) + 1,
        1e2 * assumed.departure
    )];
    let stated = stated_drift_rad(flight.input.setup);
    if assumed.drift_rad > DOUBTED_DRIFT * stated.max(STEADY_RAD) {
        remarks.push(format!(
            "the camera turned by {:.3} mrad from frame to frame within its mountings, {:.3} are stated \
             (camera.mount_drift_mrad): {}",
            1e3 * assumed.drift_rad,
            1e3 * stated,
            if mountings.are_stated() { "was it remounted within one of them?" } else { "look at its mount" }
        ));
    }
    remarks
}
