//! Remarks on causes that count in a result, with the keys of their prior standard deviations.

use super::FrameOutcome;
use crate::adjust::VarianceBudget;
use crate::adjust::causes::{
    AXIS_HEIGHT_STEP_M, CAUSES, NARROW_FRACTION, SENSITIVE_RATIO, WidenedPriors, WidthEvidence,
    all_evidence, axis_height_covariance,
};
use crate::adjust::snooping::SolvedGroup;
use crate::setup::{DEFAULT_REPEATABILITY_PX, Setup};
use crate::widths::{Unknown, Width, WidthRow};

/// Formats a positive number with two significant digits.
fn two_digits(value: f64) -> String {
    let decimals = (1.0 - value.log10().floor()).clamp(0.0, 6.0);
    format!("{value:.0$}", decimals as usize)
}

/// Returns section and key of an unknown's prior standard deviation, its unit, value and default.
fn stated_width(setup: &Setup, unknown: Unknown, stayed: bool) -> (String, &'static str, f64, f64) {
    let row = match (unknown, stayed) {
        (Unknown::MountingRotation, true) => Some(Width::StayTurn.row()),
        (Unknown::MountingShift, true) => Some(Width::StayShift.row()),
        _ => Width::ROWS
            .iter()
            .find(|row| row.unknowns.contains(&unknown)),
    };
    match (unknown, row) {
        (Unknown::MountingRotation, _) if !stayed => (
            "camera.mount_repeatability_px".into(),
            "px",
            setup.mount_repeatability_px,
            DEFAULT_REPEATABILITY_PX,
        ),
        (_, Some(row)) => (
            format!("{}.{}", row.section, row.key),
            row.unit.name,
            setup.uncertainty[row.width] / row.unit.factor,
            row.default_for(setup.reach_m()) / row.unit.factor,
        ),
        (_, None) => ("thermal.sigma_k".into(), "times the stated value", 1.0, 1.0),
    }
}

/// Remarks on causes that count, and on narrow priors that decide the tip's variance and that images rarely refute. `stayed`:
/// without a remount since the ground frames.
pub fn cause_remarks(
    outcome: &FrameOutcome,
    stayed: bool,
    widened: &WidenedPriors,
    budget: &VarianceBudget,
) -> [Vec<String>; 2] {
    let SolvedGroup {
        input,
        problem,
        fit,
        ..
    } = outcome.solved;
    let setup = input.setup;
    let counted = |(unknown, evidence): (Unknown, WidthEvidence)| match unknown {
        Unknown::FlightScale | Unknown::Aspect => image_remark(unknown, &evidence),
        _ => contradiction_remark(setup, stayed, unknown, &evidence),
    };
    let (mut free, mut held) = (CAUSES.to_vec(), CAUSES.to_vec());
    free.retain(|unknown| widened.increase(*unknown) > 0.0);
    held.retain(|unknown| !free.contains(unknown) && setup.uncertainty.has_flight_effects());
    let decisive = |unknown: Unknown| {
        let (key, unit, stated, default) = stated_width(setup, unknown, stayed);
        if stated >= NARROW_FRACTION * default {
            return None;
        }
        let (tip, more) = tip_variance(outcome, budget, unknown, [stated, default])?;
        let [now, usual] = [tip, tip + more].map(|v| 1e3 * outcome.scale() * v.sqrt());
        (usual > SENSITIVE_RATIO * now).then(|| {
            format!(
                "{key} = {stated} decides this result and the images do not test it: with the default of {default} {unit} the \
                 tip deflection has a standard deviation of {} mm, not {} mm. Make sure of it, or leave the key out",
                two_digits(usual),
                two_digits(now),
            )
        })
    };
    let is_default = |row: &WidthRow| setup.uncertainty[row.width] == row.unit.factor * row.default;
    let [turn, shift] = [Width::StayTurn, Width::StayShift].map(Width::row);
    let is_unproven = is_default(turn) && is_default(shift) && stayed;
    let unproven = (is_unproven && !setup.markers.iter().any(|marker| marker.fixed)).then(|| {
        format!(
            "nothing proves that the camera stayed since the ground frames: it counts with camera.{} = {} and {} = {}. A ground \
             frame after the flight proves it: wingd mount-check",
            turn.key, turn.default, shift.key, shift.default
        )
    });
    [
        all_evidence(problem, fit, widened, &free)
            .map(counted)
            .collect(),
        held.into_iter()
            .filter_map(decisive)
            .chain(unproven)
            .collect(),
    ]
}

/// Variance of the tip deflection of a budget, a priori, and what an unknown's prior would add to it with the default standard
/// deviation instead of the stated one, m^2, to first order.
fn tip_variance(
    outcome: &FrameOutcome,
    budget: &VarianceBudget,
    unknown: Unknown,
    [stated, default]: [f64; 2],
) -> Option<(f64, f64)> {
    let SolvedGroup {
        problem,
        fit,
        group,
        ..
    } = outcome.solved;
    let (mut tip, mut more) = (0.0, None);
    let priors = &problem.priors;
    for prior in priors.iter().filter(|p| p.name.unknown == unknown.name()) {
        let increase = match unknown {
            Unknown::AxisHeight => axis_height_covariance(default) - axis_height_covariance(stated),
            _ => &prior.covariance * ((default / stated).powi(2) - 1.0),
        };
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

/// Remark on another scale or aspect of the image.
fn image_remark(unknown: Unknown, evidence: &WidthEvidence) -> String {
    let (value, sigma) = evidence.first;
    let word = match (unknown, value > 0.0) {
        (Unknown::FlightScale, true) => "larger",
        (Unknown::FlightScale, false) => "smaller",
        (_, true) => "higher for its width",
        (_, false) => "lower for its width",
    };
    format!(
        "the image is {:.2} ± {:.2} % {word} than that of the ground frames: focus, zoom, stabilisation, a correction or the size \
         of images has changed. The result counts with it; use the ground frames' settings, or take new ones",
        1e2 * value.abs(),
        1e2 * sigma
    )
}

/// Remark on a prior standard deviation that the data contradict.
fn contradiction_remark(
    setup: &Setup,
    stayed: bool,
    unknown: Unknown,
    evidence: &WidthEvidence,
) -> String {
    let (key, unit, stated, _) = stated_width(setup, unknown, stayed);
    // The rotation is named by its size, other unknowns by the root mean square of their values.
    let values = match unknown {
        Unknown::MountingRotation => 3.0,
        _ => 1.0,
    };
    let (step, counted) = match unknown {
        Unknown::AxisHeight => (
            AXIS_HEIGHT_STEP_M,
            stated.hypot(AXIS_HEIGHT_STEP_M * evidence.current.sqrt()),
        ),
        _ => (stated, stated * (1.0 + evidence.current).sqrt()),
    };
    format!(
        "{key} = {stated} is contradicted: the {} is off by about {} {unit}. The result counts with {} {unit}",
        unknown.name(),
        two_digits(step * (values * evidence.square).sqrt()),
        two_digits(counted),
    )
}
