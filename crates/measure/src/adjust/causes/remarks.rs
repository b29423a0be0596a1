//! Remarks on causes that count in a result, with the keys of their prior standard deviations.

use super::{
    AXIS_HEIGHT_STEP_M, CAUSES, NARROW_FRACTION, SENSITIVE_RATIO, WidenedPriors, WidthEvidence,
    all_evidence,
};
use crate::adjust::{VarianceBudget, VarianceShare};
use crate::estimation::{Fit, Problem};
use crate::setup::{DEFAULT_REPEATABILITY_PX, Setup};
use crate::widths::{Unknown, Width};

/// Formats a positive number with two significant digits.
fn two_digits(value: f64) -> String {
    let decimals = (1.0 - value.log10().floor()).clamp(0.0, 6.0);
    format!("{value:.0$}", decimals as usize)
}

/// Returns section and key of an unknown's prior standard deviation, its unit, value and default.
fn stated_width(setup: &Setup, unknown: Unknown, stayed: bool) -> (String, &'static str, f64, f64) {
    let mut rows = Width::ROWS.iter();
    let row = rows.find(|row| row.unknowns.contains(&unknown));
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

/// Remarks on causes that count, and on narrow priors that decide the tip's variance. `stayed`: without a remount since the
/// ground frames.
pub fn cause_remarks(
    setup: &Setup,
    stayed: bool,
    (problem, fit): (&Problem, &Fit),
    widened: &WidenedPriors,
    budget: &VarianceBudget,
) -> [Vec<String>; 2] {
    let counted = |(unknown, evidence): (Unknown, WidthEvidence)| match unknown {
        Unknown::FlightScale | Unknown::Aspect => image_remark(unknown, &evidence),
        _ => contradiction_remark(setup, stayed, unknown, &evidence),
    };
    let mut free = CAUSES.to_vec();
    free.retain(|unknown| widened.increase(*unknown) > 0.0);
    let decisive = |unknown: Unknown| {
        let (key, unit, stated, default) = stated_width(setup, unknown, stayed);
        if stated >= NARROW_FRACTION * default {
            return None;
        }
        let of_unknown = |part: &&VarianceShare| part.source == unknown.source();
        let share = budget.shares.iter().find(of_unknown)?.share;
        let most = WidthEvidence::from_fit(problem, fit, unknown, widened)
            .map_or(0.0, |evidence| evidence.most_determined());
        let determined = match unknown {
            Unknown::AxisHeight => most * (stated / AXIS_HEIGHT_STEP_M).powi(2),
            _ => most,
        };
        let more = (default / stated).powi(2) - 1.0;
        let ratio = (1.0 + share * more / (1.0 + determined * more)).sqrt();
        (ratio > SENSITIVE_RATIO).then(|| {
            format!(
                "{key} = {stated} decides this result and the images do not test it: with the default of {default} {unit} the \
                 tip's standard deviation is {ratio:.1} times larger. Make sure of it, or leave the key out"
            )
        })
    };
    [
        all_evidence(problem, fit, widened, &free)
            .map(counted)
            .collect(),
        CAUSES.into_iter().filter_map(decisive).collect(),
    ]
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
