//! Widths that an installation states much smaller than usual, and what they hide.

use super::{PlanOptions, predict_precision};
use crate::adjust::causes::{NARROW_FRACTION, SENSITIVE_RATIO};
use crate::setup::{DEFAULT_REPEATABILITY_PX, Setup};
use crate::widths::Width;

/// A width that is much smaller than usual and on which the predicted precision depends.
#[derive(Clone, Debug, PartialEq)]
pub struct NarrowWidth {
    /// Section and key.
    pub key: String,
    /// Unit of the key; empty for a ratio.
    pub unit: &'static str,
    /// Configured and default value, in the unit of the key.
    pub values: [f64; 2],
    /// Predicted standard deviation of the tip deflection in a single frame with each, m.
    pub tip_sigmas_m: [f64; 2],
}

/// Finds the widths whose default would make the predicted standard deviation of the tip much larger; empty if the
/// installation cannot be predicted. An installation without any effect of flight is one of a laboratory.
pub fn find_narrow_widths(setup: &Setup) -> Vec<NarrowWidth> {
    let options = PlanOptions::default();
    let tip_sigma_m = |setup: &Setup| {
        let precision = predict_precision(setup, None, &options, 1, None)?;
        Ok::<_, crate::adjust::AdjustError>(precision.sigma_tip_deflection_m)
    };
    let Ok(stated_m) = tip_sigma_m(setup) else {
        return vec![];
    };
    let compare = |key: String, unit: &'static str, values: [f64; 2], usual: Setup| {
        let usual_m = tip_sigma_m(&usual)
            .ok()
            .filter(|usual_m| *usual_m > SENSITIVE_RATIO * stated_m)?;
        Some(NarrowWidth {
            key,
            unit,
            values,
            tip_sigmas_m: [stated_m, usual_m],
        })
    };
    let flies = setup.uncertainty.has_flight_effects();
    let widths = Width::ROWS
        .iter()
        .filter(|row| flies || !row.of_flight)
        .filter_map(|row| {
            let values = [setup.uncertainty[row.width] / row.unit.factor, row.default];
            let uncertainty = setup
                .uncertainty
                .with_width(row.width, row.unit.factor * row.default);
            let usual = Setup {
                uncertainty,
                ..setup.clone()
            };
            (values[0] < NARROW_FRACTION * values[1]).then(|| {
                compare(
                    format!("{}.{}", row.section, row.key),
                    row.unit.name,
                    values,
                    usual,
                )
            })?
        });
    let values = [setup.mount_repeatability_px, DEFAULT_REPEATABILITY_PX];
    let usual = Setup {
        mount_repeatability_px: values[1],
        ..setup.clone()
    };
    let rotation = (values[0] < NARROW_FRACTION * values[1])
        .then(|| compare("camera.mount_repeatability_px".into(), "px", values, usual))
        .flatten();
    widths.chain(rotation).collect()
}
