//! What earlier flights taught, held against the frames that it is to help.

use crate::adjust::{AdjustError, GlobalTest, Options, Solution};

/// Said first of a result that does without what was learnt.
const CONTRADICTED: &str = "what earlier flights taught contradicts this, and is not used: has something of the installation \
    changed since (a marker, the window, the camera)? Survey it, or learn again without the flights before the change";

/// A solution with what earlier flights taught; where the global test rejects that, and passes without, the one without,
/// which says so.
pub fn with_prior_if_consistent<T>(
    options: &Options,
    solve: impl Fn(&Options) -> Result<T, AdjustError>,
    of: impl Fn(&mut T) -> &mut [Solution],
) -> Result<T, AdjustError> {
    let mut with = solve(options);
    let is_rejected = |solved: &mut T| of(solved).iter().any(|s| s.global_test == GlobalTest::Rejected);
    if options.flight_prior.is_none() || with.as_mut().is_ok_and(|with| !is_rejected(with)) {
        return with;
    }
    let Ok(mut without) = solve(&Options { flight_prior: None, ..options.clone() }) else { return with };
    if is_rejected(&mut without) && with.is_ok() {
        return with;
    }
    of(&mut without).iter_mut().for_each(|solution| solution.remarks.insert(0, CONTRADICTED.into()));
    Ok(without)
}
