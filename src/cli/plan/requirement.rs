//! `wingd plan --want`: whether a precision is reached, its variance budget, and possible improvements.

use std::path::Path;

use serde_json::{Value, json};

use super::draft;
use crate::cli::Failure;
use crate::installation::Installation;
use crate::measure::plan::{self, InstallationPlan, LayoutPrecision, PlanOptions, Requirement, RequirementResult};
use crate::measure::setup::{Orientation, Setup};
use crate::report::grid::Grid;
use crate::report::number::{count_text, format_fixed};

/// Parses a length with its unit and returns it in metres.
pub fn parse_length(text: &str) -> Result<f64, String> {
    let units = [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)];
    let read = units.iter().find_map(|(unit, m)| Some(text.strip_suffix(unit)?.trim().parse::<f64>().ok()? * m));
    let sound = read.filter(|m| *m > 0.0 && *m <= 100.0);
    sound.ok_or_else(|| "give a length above 0 with its unit, for example 5mm".to_owned())
}

/// Predicted precision of several frames of a flight adjusted together.
pub struct FlightPrecision {
    frames: usize,
    expected: LayoutPrecision,
}

/// Predicted precision of frames with the prior from earlier flights.
pub struct PriorPrecision {
    flights: usize,
    precision: FlightPrecision,
}

/// Answer to a required precision, with the proposed layout.
pub struct PlanProposal {
    answer: RequirementResult,
    setup: Setup,
    attitude: Orientation,
}

fn plan_failure(error: &dyn std::error::Error) -> Failure {
    Failure::Failed(format!("no plan: {error}"))
}

/// Predicts the precision of several frames; `None` for a single frame.
pub fn flight_precision(
    installation: &Installation,
    options: &PlanOptions,
    frames: Option<u16>,
) -> Result<Option<FlightPrecision>, Failure> {
    let Some(frames) = frames.map(usize::from).filter(|n| *n > 1) else { return Ok(None) };
    let Installation { setup, orientation, .. } = installation;
    let expected = plan::predict_precision(setup, orientation.as_ref(), options, frames, None);
    Ok(Some(FlightPrecision { frames, expected: expected.map_err(|e| plan_failure(&e))? }))
}

/// Predicts the precision with the flight prior; `None` without a prior, or if it has another number of curvature terms.
pub fn prior_precision(
    installation: &Installation,
    options: &PlanOptions,
    frames: usize,
) -> Result<Option<PriorPrecision>, Failure> {
    let Installation { setup, orientation, flight_prior: prior, .. } = installation;
    let flight_prior = prior.as_ref().and_then(|prior| Some((prior.flights.len(), prior.prior_without(&[], setup)?)));
    let Some((flights, flight_prior)) =
        flight_prior.filter(|(_, t)| t.matches_curvature_terms(options.curvature_terms))
    else {
        return Ok(None);
    };
    let expected = plan::predict_precision(setup, orientation.as_ref(), options, frames, Some(&flight_prior));
    let joint = FlightPrecision { frames, expected: expected.map_err(|e| plan_failure(&e))? };
    Ok(Some(PriorPrecision { flights, precision: joint }))
}

/// Checks whether the planned layout reaches the required standard deviation, m.
pub fn answer_requirement(
    installation: &Installation,
    options: &PlanOptions,
    sigma_m: f64,
    frames: usize,
) -> Result<PlanProposal, Failure> {
    let requirement = Requirement { sigma_m, frames };
    let answered =
        plan::check_requirement(&installation.setup, installation.orientation.as_ref(), options, &requirement);
    let (answer, setup, attitude) = answered.map_err(|e| plan_failure(&e))?;
    Ok(PlanProposal { answer, setup, attitude })
}

/// Writes the proposed layout, or the plan's own if no precision is required.
pub fn write_layout(
    folder: &Path,
    installation: &Installation,
    options: &PlanOptions,
    proposal: Option<&PlanProposal>,
) -> Result<(), Failure> {
    match proposal {
        Some(proposal) => draft::write_layout(folder, &proposal.setup, &proposal.attitude, options.tip_deflection_m),
        None => {
            let attitude = plan::assumed_attitude(&installation.setup, installation.orientation.as_ref(), options);
            let attitude = attitude.map_err(|e| plan_failure(&e))?;
            draft::write_layout(folder, &installation.setup, &attitude, options.tip_deflection_m)
        }
    }
}

/// Returns the plan as JSON, with `flight`, `flight_prior` and, for a required precision, the fields of the answer:
/// `reached` first.
pub fn plan_json(
    plan: &InstallationPlan,
    joint: Option<&FlightPrecision>,
    with_prior: Option<&PriorPrecision>,
    proposal: Option<&PlanProposal>,
) -> Result<String, Failure> {
    let fault = |e: serde_json::Error| Failure::Failed(format!("the plan cannot be written as JSON: {e}"));
    let mut all = serde_json::Map::new();
    if let Some(proposal) = proposal
        && let Value::Object(answer) = serde_json::to_value(&proposal.answer).map_err(fault)?
    {
        all.extend(answer);
        let placed = proposal.setup.markers.iter().map(|m| {
            json!({"id": m.id, "shape": m.shape.name(), "diameter_m": m.diameter_m, "fixed": m.fixed,
                "position_m": m.position_m.as_slice()})
        });
        all.insert("layout".into(), placed.collect());
        let rows = proposal.attitude.camera_from_survey.matrix();
        let rows: Vec<Vec<f64>> = rows.row_iter().map(|r| r.iter().copied().collect()).collect();
        all.insert("camera_from_survey".into(), json!(rows));
    }
    if let Some(joint) = joint {
        all.insert("flight".into(), json!({"frames": joint.frames, "expected": joint.expected}));
    }
    if let Some(PriorPrecision { flights, precision: FlightPrecision { frames, expected } }) = with_prior {
        let flight_prior = json!({"flights": flights, "frames": frames, "expected": expected});
        all.insert("flight_prior".into(), flight_prior);
    }
    if let Value::Object(plan) = serde_json::to_value(plan).map_err(fault)? {
        all.extend(plan);
    }
    serde_json::to_string(&all).map_err(fault)
}

fn format_mm(sigma_m: f64) -> String {
    format!("{:.1} mm", 1e3 * sigma_m)
}

/// Returns the text below the plan.
pub fn precision_text(
    joint: Option<&FlightPrecision>,
    with_prior: Option<&PriorPrecision>,
    proposal: Option<&PlanProposal>,
) -> String {
    let mut out = String::new();
    let mut describe = |what: String, expected: &LayoutPrecision| {
        let [tip, span] = [expected.sigma_tip_deflection_m, expected.sigma_mean_deflection_m].map(format_mm);
        out.push_str(&format!("\n{what}: tip deflection {tip}, deflection along the span {span}\n"));
    };
    if let Some(FlightPrecision { frames, expected }) = joint {
        describe(format!("{frames} frames of a flight adjusted together (`wingd solve --flight`)"), expected);
    }
    if let Some(PriorPrecision { flights, precision: FlightPrecision { frames, expected } }) = with_prior {
        let (frames, flights) = (count_text(*frames, "frame"), count_text(*flights, "flight"));
        describe(format!("{frames}, with the prior from {flights} (flight_prior.json)"), expected);
    }
    if let Some(proposal) = proposal {
        out.push_str(&answer_text(&proposal.answer, &proposal.setup));
    }
    out
}

fn answer_text(answer: &RequirementResult, proposal: &Setup) -> String {
    let frames = |n: usize| if n == 1 { "one frame".to_owned() } else { format!("{n} frames together") };
    let verdict = if answer.reached { "YES" } else { "NO" };
    let mut out = format!(
        "\nRequired: {} at the tip. {verdict}: {} with {}\n\nVariance budget\n{}",
        format_mm(answer.want_m),
        format_mm(answer.sigma_tip_deflection_m),
        frames(answer.frames),
        Grid::for_rows(&answer.sources)
            .columns(&[("<source", &|s| s.source.clone()), ("share / %", &|s| format_fixed(Some(100.0 * s.share), 0)),])
            .text()
    );
    let taken = |sigma: Option<f64>| sigma.map_or_else(|| format_fixed(None, 0), |m| format!("{:.1}", 1e3 * m));
    out.push_str(&format!(
        "\nPossible improvements, cheapest first\n{}",
        Grid::for_rows(&answer.remedies)
            .columns(&[
                ("<remedy", &|r| r.remedy.clone()),
                ("<takes", &|r| r.cost.to_owned()),
                ("alone / mm", &|r| taken(r.sigma_alone_m)),
                ("proposed, with those above / mm", &|r| taken(r.sigma_taken_m)),
            ])
            .text()
    ));
    if !answer.reached {
        let fixed = proposal.markers.iter().filter(|m| m.fixed).count();
        let reaches = if answer.proposal_reached { "reaches it" } else { "does not reach it either" };
        out.push_str(&format!(
            "\nThe proposal {reaches}: {} with {}, {} markers and {fixed} fixed targets; --layout DIR writes it\n",
            format_mm(answer.proposal_sigma_m),
            frames(answer.proposal_frames),
            proposal.markers.len() - fixed
        ));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_has_its_unit() {
        assert_eq!(parse_length("5mm"), Ok(0.005));
        assert_eq!(parse_length("2.5 cm").map(|m| (m * 1e4).round()), Ok(250.0));
        for odd in ["5", "-5mm", "0mm", "mm", "5 in", "NaNmm"] {
            assert!(parse_length(odd).is_err(), "{odd}");
        }
    }
}
