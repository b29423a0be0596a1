//! `wingd plan --want`: yes or no, where the standard deviation comes from, and what would mend it.

use std::path::Path;

use serde_json::{Value, json};

use super::draft;
use crate::cli::Failure;
use crate::installation::Installation;
use crate::measure::plan::{self, Answer, Expected, Plan, PlanOptions, Requirement};
use crate::measure::setup::{Orientation, Setup};
use crate::report::grid::Grid;
use crate::report::number::{count, fixed};

/// A length with its unit, as m.
pub fn length(text: &str) -> Result<f64, String> {
    let units = [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)];
    let read =
        units.iter().find_map(|(unit, m)| Some(text.strip_suffix(unit)?.trim().parse::<f64>().ok()? * m));
    let sound = read.filter(|m| *m > 0.0 && *m <= 100.0);
    sound.ok_or_else(|| "give a length above 0 with its unit, as in 5mm".to_owned())
}

/// What so many frames of a flight are worth together.
pub struct FlightPrecision {
    frames: usize,
    expected: Expected,
}

/// What frames are worth beside what so many earlier flights taught.
pub struct PriorPrecision {
    flights: usize,
    together: FlightPrecision,
}

/// An answer with the layout that it proposes.
pub struct Asked {
    answer: Answer,
    setup: Setup,
    attitude: Orientation,
}

fn undone(error: &dyn std::error::Error) -> Failure {
    Failure::Failed(format!("no plan: {error}"))
}

/// `None` where a single frame is planned.
pub fn together(
    installation: &Installation,
    options: &PlanOptions,
    frames: Option<u16>,
) -> Result<Option<FlightPrecision>, Failure> {
    let Some(frames) = frames.map(usize::from).filter(|n| *n > 1) else { return Ok(None) };
    let Installation { setup, orientation, .. } = installation;
    let expected = plan::predict_precision(setup, orientation.as_ref(), options, frames, None);
    Ok(Some(FlightPrecision { frames, expected: expected.map_err(|e| undone(&e))? }))
}

/// `None` where no flight taught, or where `--curvature-terms` are others than flights have.
pub fn beside(
    installation: &Installation,
    options: &PlanOptions,
    frames: usize,
) -> Result<Option<PriorPrecision>, Failure> {
    let Installation { setup, orientation, learnt, .. } = installation;
    let taught = learnt.as_ref().and_then(|learnt| Some((learnt.sources.len(), learnt.beside(&[], setup)?)));
    let Some((flights, taught)) = taught.filter(|(_, t)| t.holds_for(options.curvature_terms)) else {
        return Ok(None);
    };
    let expected = plan::predict_precision(setup, orientation.as_ref(), options, frames, Some(&taught));
    let together = FlightPrecision { frames, expected: expected.map_err(|e| undone(&e))? };
    Ok(Some(PriorPrecision { flights, together }))
}

pub fn ask(
    installation: &Installation,
    options: &PlanOptions,
    sigma_m: f64,
    frames: usize,
) -> Result<Asked, Failure> {
    let wish = Requirement { sigma_m, frames };
    let answered = plan::answer(&installation.setup, installation.orientation.as_ref(), options, &wish);
    let (answer, setup, attitude) = answered.map_err(|e| undone(&e))?;
    Ok(Asked { answer, setup, attitude })
}

/// Writes the proposal, or what was planned where nothing is wanted.
pub fn write_layout(
    folder: &Path,
    installation: &Installation,
    options: &PlanOptions,
    asked: Option<&Asked>,
) -> Result<(), Failure> {
    match asked {
        Some(asked) => draft::write_layout(folder, &asked.setup, &asked.attitude, options.tip_deflection_m),
        None => {
            let attitude = plan::attitude(&installation.setup, installation.orientation.as_ref(), options);
            let attitude = attitude.map_err(|e| undone(&e))?;
            draft::write_layout(folder, &installation.setup, &attitude, options.tip_deflection_m)
        }
    }
}

/// The plan with `flight`, `taught` and, of a wish, all that the answer says: `reached` first.
pub fn json(
    plan: &Plan,
    together: Option<&FlightPrecision>,
    beside: Option<&PriorPrecision>,
    asked: Option<&Asked>,
) -> Result<String, Failure> {
    let fault = |e: serde_json::Error| Failure::Failed(format!("the plan cannot be written as JSON: {e}"));
    let mut all = serde_json::Map::new();
    if let Some(asked) = asked
        && let Value::Object(answer) = serde_json::to_value(&asked.answer).map_err(fault)?
    {
        all.extend(answer);
        let placed = asked.setup.markers.iter().map(|m| {
            json!({"id": m.id, "shape": m.shape.name(), "diameter_m": m.diameter_m, "fixed": m.fixed,
                "position_m": m.position_m.as_slice()})
        });
        all.insert("layout".into(), placed.collect());
        let rows = asked.attitude.camera_from_survey.matrix();
        let rows: Vec<Vec<f64>> = rows.row_iter().map(|r| r.iter().copied().collect()).collect();
        all.insert("camera_from_survey".into(), json!(rows));
    }
    if let Some(together) = together {
        all.insert("flight".into(), json!({"frames": together.frames, "expected": together.expected}));
    }
    if let Some(PriorPrecision { flights, together: FlightPrecision { frames, expected } }) = beside {
        let taught = json!({"flights": flights, "frames": frames, "expected": expected});
        all.insert("flight_prior".into(), taught);
    }
    if let Value::Object(plan) = serde_json::to_value(plan).map_err(fault)? {
        all.extend(plan);
    }
    serde_json::to_string(&all).map_err(fault)
}

fn mm(sigma_m: f64) -> String {
    format!("{:.1} mm", 1e3 * sigma_m)
}

/// What stands below the plan.
pub fn text(
    together: Option<&FlightPrecision>,
    beside: Option<&PriorPrecision>,
    asked: Option<&Asked>,
) -> String {
    let mut out = String::new();
    let mut worth = |what: String, expected: &Expected| {
        let [tip, span] = [expected.sigma_tip_deflection_m, expected.sigma_mean_deflection_m].map(mm);
        out.push_str(&format!("\n{what}: tip deflection {tip}, deflection along the span {span}\n"));
    };
    if let Some(FlightPrecision { frames, expected }) = together {
        worth(format!("{frames} frames of a flight adjusted together (`wingd solve --flight`)"), expected);
    }
    if let Some(PriorPrecision { flights, together: FlightPrecision { frames, expected } }) = beside {
        let (frames, flights) = (count(*frames, "frame"), count(*flights, "flight"));
        worth(format!("{frames} beside what {flights} taught (flight_prior.json)"), expected);
    }
    if let Some(asked) = asked {
        out.push_str(&answered(&asked.answer, &asked.setup));
    }
    out
}

fn answered(answer: &Answer, proposal: &Setup) -> String {
    let frames = |n: usize| if n == 1 { "one frame".to_owned() } else { format!("{n} frames together") };
    let verdict = if answer.reached { "YES" } else { "NO" };
    let mut out = format!(
        "\nWanted: {} at the tip. {verdict}: {} with {}\n\nWhere it comes from\n{}",
        mm(answer.want_m),
        mm(answer.sigma_tip_deflection_m),
        frames(answer.frames),
        Grid::each(&answer.sources)
            .columns(&[
                ("<source", &|s| s.source.clone()),
                ("share / %", &|s| fixed(Some(100.0 * s.share), 0)),
            ])
            .text()
    );
    let taken = |sigma: Option<f64>| sigma.map_or_else(|| fixed(None, 0), |m| format!("{:.1}", 1e3 * m));
    out.push_str(&format!(
        "\nWhat would mend it, cheapest first\n{}",
        Grid::each(&answer.remedies)
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
            "\nThe proposal {reaches}: {} with {}, {} markers and {fixed} fixed marks; --layout DIR writes it\n",
            mm(answer.proposal_sigma_m),
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
        assert_eq!(length("5mm"), Ok(0.005));
        assert_eq!(length("2.5 cm").map(|m| (m * 1e4).round()), Ok(250.0));
        for odd in ["5", "-5mm", "0mm", "mm", "5 in", "NaNmm"] {
            assert!(length(odd).is_err(), "{odd}");
        }
    }
}
