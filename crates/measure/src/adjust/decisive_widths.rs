//! Stated widths that are much narrower than the default and decide a result, which images rarely refute.

use super::VarianceBudget;
use super::causes::{SENSITIVE_RATIO, StatedWidth, TESTED, WidenedPriors, two_digits};
use super::outcome::FrameOutcome;
use super::snooping::SolvedGroup;
use crate::widths::Unknown;

/// Remarks on stated widths that are much narrower than the default and on which the tip deflection depends: the images
/// do not replace them.
pub fn decisive_width_remarks(
    outcome: &FrameOutcome,
    budget: Option<&VarianceBudget>,
    stayed: bool,
    widened: &WidenedPriors,
) -> Vec<String> {
    let setup = outcome.solved.input.setup;
    let Some(budget) = budget.filter(|_| setup.uncertainty.has_flight_effects()) else {
        return vec![];
    };
    let remark = |unknown: Unknown| {
        let width = StatedWidth::of_unknown(setup, unknown, stayed);
        let (tip, more) = tip_variance(outcome, budget, unknown, &width)?;
        let [stated, usual] =
            [tip, tip + more].map(|variance| 1e3 * outcome.scale() * variance.sqrt());
        (widened.increase(unknown) == 0.0 && usual > SENSITIVE_RATIO * stated).then(|| {
            let StatedWidth { key, unit, value, default } = width;
            format!(
                "{key} = {value} decides this result and the images do not test it: with the default of {default} {unit} the \
                 tip deflection has a standard deviation of {} mm, not {} mm. Make sure of it, or leave the key out",
                two_digits(usual),
                two_digits(stated),
            )
        })
    };
    TESTED.into_iter().filter_map(remark).collect()
}

/// Variance of the tip deflection of a budget, a priori, and what the default of an unknown's width would add to it, m^2, to
/// first order; `None` if the stated width is not narrow.
fn tip_variance(
    outcome: &FrameOutcome,
    budget: &VarianceBudget,
    unknown: Unknown,
    width: &StatedWidth,
) -> Option<(f64, f64)> {
    let SolvedGroup {
        problem,
        fit,
        group,
        ..
    } = outcome.solved;
    let (mut tip, mut more) = (0.0, None);
    for prior in problem
        .priors
        .iter()
        .filter(|prior| prior.name.unknown == unknown.name())
    {
        let increase = width.increase_to_default(unknown, &prior.covariance)?;
        let gradient = outcome.deflection_gradient(budget.marker, budget.reference);
        let covariance = fit.function_covariance(group, &gradient.with_parameters(&prior.columns));
        let n = prior.columns.len();
        // The weight that the default takes from the prior, inverted.
        let taken =
            &prior.covariance + &prior.covariance * increase.cholesky()?.solve(&prior.covariance);
        let with_tip = covariance.view((1, 0), (n, 1)).column(0).into_owned();
        let left = (taken - covariance.view((1, 1), (n, n))).cholesky()?;
        tip = covariance[(0, 0)];
        *more.get_or_insert(0.0) += with_tip.dot(&left.solve(&with_tip));
    }
    Some((tip, more?))
}
