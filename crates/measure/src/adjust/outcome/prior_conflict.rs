//! Comparison of the prior from earlier flights with the frames to which it is applied.

use crate::adjust::{AdjustResult, GlobalTest, Options, Solution};

/// First remark of a result that does not use the prior because it conflicts.
const CONFLICT_REMARK: &str = "flight_prior.json is inconsistent with these images and was not used: check whether a marker, \
    the window or the camera has changed; if so, survey it again, or run `wingd learn` without the flights before the change";

/// Solves with the prior from earlier flights. If the global test rejects that solution or a cause counts, and
/// neither without the prior, returns the one without it, with a remark.
pub fn with_prior_if_consistent<T>(
    options: &Options,
    solve: impl Fn(&Options) -> AdjustResult<T>,
    solutions: impl Fn(&mut T) -> &mut [Solution],
) -> AdjustResult<T> {
    let mut with = solve(options);
    let is_contradictory =
        |s: &Solution| s.global_test == Some(GlobalTest::Rejected) || !s.counted_causes.is_empty();
    let is_rejected = |solved: &mut T| solutions(solved).iter().any(is_contradictory);
    if options.flight_prior.is_none() || with.as_mut().is_ok_and(|with| !is_rejected(with)) {
        return with;
    }
    let Ok(mut without) = solve(&Options {
        flight_prior: None,
        ..options.clone()
    }) else {
        return with;
    };
    if is_rejected(&mut without) && with.is_ok() {
        return with;
    }
    solutions(&mut without)
        .iter_mut()
        .for_each(|solution| solution.remarks.insert(0, CONFLICT_REMARK.into()));
    Ok(without)
}
