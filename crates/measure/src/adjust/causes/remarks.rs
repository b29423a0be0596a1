//! Remarks on causes that count in a result, with the keys and defaults of their prior standard deviations.

use nalgebra::DMatrix;

use super::{
    AXIS_HEIGHT_STEP_M, IN_IMAGE, NARROW_FRACTION, TESTED, WidenedPriors, WidthEvidence,
    all_evidence, axis_height_covariance,
};
use crate::estimation::{Fit, Problem};
use crate::setup::{DEFAULT_REPEATABILITY_PX, Setup};
use crate::widths::{Unknown, Width};

/// Formats a positive number with two significant digits.
pub fn two_digits(value: f64) -> String {
    let decimals = (1.0 - value.log10().floor()).clamp(0.0, 6.0);
    format!("{value:.0$}", decimals as usize)
}

/// A width that `installation.toml` states, or its default.
pub struct StatedWidth {
    /// Section and key.
    pub key: String,
    /// Unit of the key.
    pub unit: &'static str,
    /// Stated value, in the unit of the key.
    pub value: f64,
    /// Its default.
    pub default: f64,
}

impl StatedWidth {
    /// Finds the width of an unknown. `stayed`: the camera is stated to have stayed since the ground frames.
    pub fn of_unknown(setup: &Setup, unknown: Unknown, stayed: bool) -> Self {
        let row = Width::ROWS
            .iter()
            .find(|row| row.unknowns.contains(&unknown));
        match (unknown, row) {
            (Unknown::MountingRotation, _) if !stayed => Self {
                key: "camera.mount_repeatability_px".into(),
                unit: "px",
                value: setup.mount_repeatability_px,
                default: DEFAULT_REPEATABILITY_PX,
            },
            (_, Some(row)) => Self {
                key: format!("{}.{}", row.section, row.key),
                unit: row.unit.name,
                value: setup.uncertainty[row.width] / row.unit.factor,
                default: row.default_for(setup.reach_m()) / row.unit.factor,
            },
            (_, None) => Self {
                key: "thermal.sigma_k".into(),
                unit: "times the stated value",
                value: 1.0,
                default: 1.0,
            },
        }
    }

    /// Increase of the prior's covariance from the stated width to the default; `None` if the stated one is not much narrower.
    pub fn increase_to_default(
        &self,
        unknown: Unknown,
        stated: &DMatrix<f64>,
    ) -> Option<DMatrix<f64>> {
        (self.value < NARROW_FRACTION * self.default).then(|| match unknown {
            Unknown::AxisHeight => {
                axis_height_covariance(self.default) - axis_height_covariance(self.value)
            }
            _ => stated * ((self.default / self.value).powi(2) - 1.0),
        })
    }
}

/// Remarks on the causes that count in a solution: those in the image, or else the most significant one. `stayed`: the camera
/// is stated to have stayed since the ground frames.
pub fn cause_remarks(
    setup: &Setup,
    stayed: bool,
    (problem, fit): (&Problem, &Fit),
    widened: &WidenedPriors,
) -> Vec<String> {
    let free = |unknown: &Unknown| widened.increase(*unknown) > 0.0;
    let in_image: Vec<Unknown> = IN_IMAGE.into_iter().filter(free).collect();
    let others: Vec<Unknown> = TESTED.into_iter().filter(free).collect();
    let worst = all_evidence(problem, fit, widened, &others)
        .min_by(|a, b| a.1.probability().total_cmp(&b.1.probability()));
    let images = all_evidence(problem, fit, widened, &in_image)
        .map(|(unknown, evidence)| image_remark(unknown, &evidence));
    let other =
        worst.map(|(unknown, evidence)| contradiction_remark(setup, stayed, unknown, &evidence));
    images.chain(other).collect()
}

/// Remark on another scale or aspect of the image.
fn image_remark(unknown: Unknown, evidence: &WidthEvidence) -> String {
    let (value, sigma) = evidence.first;
    let words = match (unknown, value > 0.0) {
        (Unknown::FlightScale, true) => "larger than that of the ground frames",
        (Unknown::FlightScale, false) => "smaller than that of the ground frames",
        (_, true) => "higher, relative to its width, than that of the ground frames",
        (_, false) => "lower, relative to its width, than that of the ground frames",
    };
    format!(
        "the image is {:.2} ± {:.2} % {words}: focus, zoom, stabilisation, a correction or the size of images has changed. It \
         was estimated, and the result counts with it; use the settings of the ground frames, or take new ones",
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
    let StatedWidth {
        key,
        unit,
        value: stated,
        ..
    } = StatedWidth::of_unknown(setup, unknown, stayed);
    // The rotation is named by its size, other unknowns by the root mean square of their values.
    let values = if unknown == Unknown::MountingRotation {
        3.0
    } else {
        1.0
    };
    let (step, counted) = match unknown {
        Unknown::AxisHeight => (
            AXIS_HEIGHT_STEP_M,
            stated.hypot(AXIS_HEIGHT_STEP_M * evidence.current.sqrt()),
        ),
        _ => (stated, stated * (1.0 + evidence.current).sqrt()),
    };
    let moved = if stayed && unknown == Unknown::MountingRotation {
        "; the camera did not stay as it was"
    } else {
        ""
    };
    format!(
        "{key} = {stated} is contradicted: the {} is off by about {} {unit}{moved}. The result counts with {} {unit}",
        unknown.name(),
        two_digits(step * (values * evidence.square).sqrt()),
        two_digits(counted),
    )
}
