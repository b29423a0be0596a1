//! Predicted standard deviations of a solution.

use serde::Serialize;

use crate::adjust::{DeflectionReference, MarkerSolution, Solution};
use crate::setup::Setup;

/// Predicted standard deviations of one marker: deflection, and position along span, flow and height, m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MarkerSigma {
    pub marker: usize,
    pub deflection_m: f64,
    pub span_m: f64,
    pub chord_m: f64,
    pub height_m: f64,
}

/// Predicted precision of a layout.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LayoutPrecision {
    /// Standard deviation of the bending axis' deflection at the tip, m.
    pub sigma_tip_deflection_m: f64,
    /// Root mean square of the standard deviation of the deflection along the span, m.
    pub sigma_mean_deflection_m: f64,
    /// Standard deviation of the twist at the tip, degrees.
    pub sigma_tip_twist_deg: Option<f64>,
    /// Largest standard deviation of a marker along the span, m.
    pub sigma_span_m: f64,
}

/// Predicted standard deviations of the outermost visible marker's deflection, relative to three references.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TipSigma {
    /// Id of the marker.
    pub marker: String,
    /// Reference of the reported deflection: the most precise one.
    pub reference: DeflectionReference,
    /// Standard deviation relative to the survey, m.
    pub deflection_m: Option<f64>,
    /// Standard deviation relative to the ground frame, m.
    pub deflection_ground_m: Option<f64>,
    /// Standard deviation relative to the root's tangent, m.
    pub deflection_root_m: Option<f64>,
}

/// Returns the standard deviations of the tip marker's deflection against each reference.
pub(super) fn tip_sigma(solution: &Solution, setup: &Setup) -> Option<TipSigma> {
    let budget = solution.budget.as_ref()?;
    let marker = &solution.markers[budget.marker];
    let sigma = |reference| marker.deflection_against(reference)?.sigma;
    Some(TipSigma {
        marker: setup.markers.get(budget.marker)?.id.clone(),
        reference: budget.reference,
        deflection_m: sigma(DeflectionReference::Survey),
        deflection_ground_m: sigma(DeflectionReference::Ground),
        deflection_root_m: sigma(DeflectionReference::Root),
    })
}

pub(super) fn marker_sigmas(solution: &Solution, setup: &Setup) -> Vec<MarkerSigma> {
    let turn = setup.wing_frame().wing_from_survey;
    let of_the_wing = |m: &&MarkerSolution| setup.markers.get(m.marker).is_some_and(|k| !k.fixed);
    let one = |m: &MarkerSolution| {
        let wing = turn * m.covariance_m2? * turn.inverse();
        let sigma = |k: usize| wing[(k, k)].max(0.0).sqrt();
        let (span_m, height_m, chord_m) = (sigma(0), sigma(1), sigma(2));
        Some(MarkerSigma {
            marker: m.marker,
            deflection_m: m.deflection_m?.sigma?,
            span_m,
            chord_m,
            height_m,
        })
    };
    solution
        .markers
        .iter()
        .filter(of_the_wing)
        .filter_map(one)
        .collect()
}

pub(super) fn layout_precision(solution: &Solution, setup: &Setup) -> Option<LayoutPrecision> {
    let tip = solution.curve.last()?;
    let sigmas: Vec<f64> = solution
        .curve
        .iter()
        .filter_map(|p| p.deflection_m.sigma)
        .collect();
    let square = sigmas.iter().map(|s| s * s).sum::<f64>() / sigmas.len().max(1) as f64;
    Some(LayoutPrecision {
        sigma_tip_deflection_m: tip.deflection_m.sigma?,
        sigma_mean_deflection_m: square.sqrt(),
        sigma_tip_twist_deg: tip.twist_rad.and_then(|t| t.sigma).map(f64::to_degrees),
        sigma_span_m: marker_sigmas(solution, setup)
            .iter()
            .fold(0.0, |m, s| m.max(s.span_m)),
    })
}
