//! `wingd plan --want`: whether a precision is reached, its uncertainty budget, and possible improvements.

use serde_json::{Map, Value, json};

use crate::plan::FlightPrecision;
use wingd_evaluation::grid::ColumnDefinition::One;
use wingd_evaluation::grid::Grid;
use wingd_evaluation::number::{count_text, format_fixed};
use wingd_evaluation::record::json_fields;
use wingd_evaluation::results::table;
use wingd_measure::plan::InstallationPlan;
use wingd_measure::plan::RequirementResult;
use wingd_measure::setup::{Orientation, Setup};

/// Parses a length with its unit and returns it in metres.
pub fn parse_length(text: &str) -> Result<f64, String> {
    let units = [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)];
    let read = units
        .iter()
        .find_map(|(unit, m)| Some(text.strip_suffix(unit)?.trim().parse::<f64>().ok()? * m));
    let sound = read.filter(|m| *m > 0.0 && *m <= 100.0);
    sound.ok_or_else(|| "give a length above 0 with its unit, for example 5mm".to_owned())
}

/// Answer to a required precision, with the proposed layout and its attitude.
pub type PlanProposal = (RequirementResult, Setup, Orientation);

/// Returns the plan as JSON, with `flight`, `flight_prior` and, for a required precision, the fields of the answer:
/// `reached` first.
pub fn plan_json(
    plan: &InstallationPlan,
    joint: Option<&FlightPrecision>,
    with_prior: Option<&FlightPrecision>,
    proposal: Option<&PlanProposal>,
) -> Map<String, Value> {
    let mut all = Map::new();
    if let Some((answer, setup, attitude)) = proposal {
        all.extend(json_fields(answer));
        let placed = setup.markers.iter().map(|m| {
            json!({"id": m.id, "shape": m.shape.name(), "diameter_m": m.diameter_m, "fixed": m.fixed,
                "position_m": m.position_m.as_slice()})
        });
        all.insert("layout".into(), placed.collect());
        let rows = attitude.camera_from_survey.matrix();
        let rows: Vec<Vec<f64>> = rows
            .row_iter()
            .map(|r| r.iter().copied().collect())
            .collect();
        all.insert("camera_from_survey".into(), json!(rows));
    }
    all.extend(joint.map(|joint| ("flight".to_owned(), json!(joint))));
    all.extend(with_prior.map(|with_prior| ("flight_prior".to_owned(), json!(with_prior))));
    all.extend(json_fields(plan));
    all
}

fn format_mm(sigma_m: f64) -> String {
    format!("{:.1} mm", 1e3 * sigma_m)
}

/// Returns the text below the plan.
pub fn precision_text(
    joint: Option<&FlightPrecision>,
    with_prior: Option<&FlightPrecision>,
    proposal: Option<&PlanProposal>,
) -> String {
    let describe = |p: &FlightPrecision| {
        let [tip, span] = [
            p.expected.sigma_tip_deflection_m,
            p.expected.sigma_mean_deflection_m,
        ]
        .map(format_mm);
        let what = match p.flights {
            None => format!(
                "{} frames of a flight adjusted jointly (`wingd solve STORE`)",
                p.frames
            ),
            Some(flights) => {
                let (frames, flights) =
                    (count_text(p.frames, "frame"), count_text(flights, "flight"));
                format!("{frames}, with the prior from {flights} (flight_prior.json)")
            }
        };
        format!("\n{what}: tip deflection {tip}, deflection along the span {span}\n")
    };
    let mut out: String = joint.into_iter().chain(with_prior).map(describe).collect();
    out.extend(proposal.map(|(answer, setup, _)| answer_text(answer, setup)));
    out
}

fn count_frames(n: usize) -> String {
    if n == 1 {
        "one frame".to_owned()
    } else {
        format!("{n} frames jointly")
    }
}

/// Returns the answer: whether the required precision is reached, or the predicted one.
pub fn first_line(
    plan: &InstallationPlan,
    joint: Option<&FlightPrecision>,
    proposal: Option<&PlanProposal>,
) -> String {
    let Some((answer, ..)) = proposal else {
        let alone = plan
            .prediction
            .as_ref()
            .map(|p| (p.expected.sigma_tip_deflection_m, 1));
        let best = joint
            .map(|j| (j.expected.sigma_tip_deflection_m, j.frames))
            .or(alone);
        let seen = plan.markers.iter().filter(|m| m.visible).count();
        let markers = format!("{seen} of {} markers can be measured", plan.markers.len());
        return match best {
            Some((sigma_m, frames)) => {
                format!(
                    "Tip deflection: {} with {}; {markers}\n",
                    format_mm(sigma_m),
                    count_frames(frames)
                )
            }
            None => format!("No precision can be predicted; {markers}\n"),
        };
    };
    let predicted = format!(
        "{} at the tip with {}",
        format_mm(answer.sigma_tip_deflection_m),
        count_frames(answer.frames)
    );
    let required = format!("{} required", format_mm(answer.want_m));
    match (&answer.obstacle, answer.reached) {
        (Some(obstacle), _) => format!("NO: {obstacle} ({required})\n"),
        (None, true) => format!("YES: {predicted}, {required}\n"),
        (None, false) if answer.proposal_reached => {
            let (sigma, frames) = (
                format_mm(answer.proposal_sigma_m),
                count_frames(answer.proposal_frames),
            );
            format!(
                "NO: {predicted}, {required}; the proposal below reaches {sigma} with {frames}\n"
            )
        }
        (None, false) => {
            format!("NO: {predicted}, {required}; the proposal below does not reach it either\n")
        }
    }
}

fn answer_text(answer: &RequirementResult, proposal: &Setup) -> String {
    let mut out = String::new();
    if answer.frames > 1 {
        out.push_str(&format!(
            "\nUncertainty budget of the reported deflection with {}\n{}",
            count_frames(answer.frames),
            table::budget_table(&answer.sources).text()
        ));
    }
    let taken = |sigma: Option<f64>| format_fixed(sigma.map(|m| 1e3 * m), 1);
    out.push_str(&format!(
        "\nPossible improvements, cheapest first\n{}",
        Grid::for_rows(&answer.remedies)
            .columns(&[
                One("<remedy", &|r| r.remedy.clone()),
                One("<takes", &|r| r.cost.to_owned()),
                One("alone / mm", &|r| taken(r.sigma_alone_m)),
                One("proposed, with those above / mm", &|r| taken(
                    r.sigma_taken_m
                )),
            ])
            .text()
    ));
    if !answer.reached && answer.obstacle.is_none() {
        let fixed = proposal.markers.iter().filter(|m| m.fixed).count();
        let reaches = if answer.proposal_reached {
            "reaches it"
        } else {
            "does not reach it either"
        };
        out.push_str(&format!(
            "\nThe proposal {reaches}: {} with {}, {} markers and {fixed} fixed targets; --layout DIR writes it\n",
            format_mm(answer.proposal_sigma_m),
            count_frames(answer.proposal_frames),
            proposal.markers.len() - fixed
        ));
        if fixed > 0 {
            out.push_str(
                "Fixed targets: near the directions of the layout, as far from the lens as something rigid to the cabin is in view \
                 (wing-body fairing, root fillet ahead of or behind the wing); pylon and nacelle move with the wing\n",
            );
        }
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
