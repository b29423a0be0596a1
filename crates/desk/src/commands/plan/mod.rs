//! `wingd plan` predicts the resolution and precision of an existing or planned installation.

mod draft;
mod requirement;

use std::path::PathBuf;

use crate::plan::{
    draft_installation, drafted_facts, flight_precision, plan_failure, prior_precision,
    write_layout,
};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line};
use wingd_evaluation::grid::ColumnDefinition::One;
use wingd_evaluation::grid::Grid;
use wingd_evaluation::inputs::default_paths::{load_installation, resolve_installation};
use wingd_evaluation::inputs::stopping::run_long_task;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::number::format_fixed;
use wingd_evaluation::results::table;
use wingd_measure::adjust::DeflectionReference;
use wingd_measure::plan;
use wingd_measure::plan::Requirement;
use wingd_measure::plan::{InstallationPlan, MarkerPlan, PlanOptions};
use wingd_measure::plan::{LayoutPrediction, TipSigma};
use wingd_measure::setup::Setup;

/// Predict resolution, depth of field and standard deviations of an installation.
#[derive(clap::Args)]
pub struct PlanArgs {
    /// Installation; without orientation.toml the camera is assumed to point at the middle of the wing
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    #[command(flatten)]
    draft: draft::DraftArgs,
    /// Also predict N frames of a flight, adjusted jointly
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=500))]
    frames: Option<u16>,
    /// Required standard deviation of the tip deflection, for example 5mm: prints whether the plan meets it, the
    /// uncertainty budget, and possible improvements
    #[arg(long, value_name = "LENGTH", value_parser = requirement::parse_length)]
    want: Option<f64>,
    /// Write the layout (with --want the proposed one): installation.toml, camera.toml, and a survey.csv to be replaced by
    /// the true survey
    #[arg(long, value_name = "DIR")]
    layout: Option<PathBuf>,
    /// Planned deflection of the outermost marker, m
    #[arg(long, value_name = "M", default_value_t = PlanOptions::default().tip_deflection_m, allow_negative_numbers = true)]
    tip_deflection: f64,
    /// Planned standard deviation of an image coordinate, px
    #[arg(long, value_name = "PX", default_value_t = PlanOptions::default().pixel_sigma)]
    pixel_sigma: f64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Show all columns of the tables [default: those that fit 80 characters]
    #[arg(long)]
    wide: bool,
}

/// Plans an installation or a drafted layout of markers, and proposes improvements to reach a required precision.
pub(super) fn run(args: &PlanArgs) -> TaskResult<Completion> {
    let sensible =
        args.pixel_sigma > 0.0 && args.pixel_sigma <= 100.0 && args.tip_deflection.abs() <= 100.0;
    if !sensible {
        return Err(Failure::Usage(
            "--pixel-sigma must be in (0, 100] px, --tip-deflection within 100 m".into(),
        ));
    }
    let frames = args.frames.map_or(1, usize::from);
    let draft = args
        .draft
        .reach
        .map(|_| args.draft.to_draft())
        .transpose()?;
    let installation = match &draft {
        None => load_installation(&resolve_installation(args.installation.as_deref())?)?,
        Some(draft) => draft_installation(draft, &plan_options(args, None), frames)?,
    };
    let options = plan_options(args, Some(&installation));
    let (setup, orientation) = (&installation.setup, installation.orientation.as_ref());
    let plan = plan::plan_installation(setup, orientation, &options).map_err(plan_failure)?;
    let (mut joint, mut with_prior) = (None, None);
    if plan.prediction.is_some() {
        let predict = || flight_precision(&installation, &options, frames);
        joint = run_long_task("predicting a flight", predict)?;
        with_prior = prior_precision(&installation, &options, frames)?;
    }
    let requirement = args.want.map(|sigma_m| Requirement { sigma_m, frames });
    let check = |wanted| plan::check_requirement(setup, orientation, &options, &wanted);
    let proposal =
        requirement.map(|wanted| run_long_task("looking for a layout", || check(wanted)));
    let proposal = proposal.transpose().map_err(plan_failure)?;
    if let Some(folder) = &args.layout {
        let layout = proposal.as_ref().map_or(setup, |(_, layout, _)| layout);
        let facts = match &draft {
            Some(_) => drafted_facts(layout, args.draft.wing_side()),
            None => Setup {
                markers: layout.markers.clone(),
                ..setup.clone()
            },
        };
        write_layout(folder, layout, &facts)?;
    }
    if args.json {
        print_json(&requirement::plan_json(
            &plan,
            joint.as_ref(),
            with_prior.as_ref(),
            proposal.as_ref(),
        ))?;
    } else {
        let mut out = requirement::first_line(&plan, joint.as_ref(), proposal.as_ref());
        out.push_str(&plan_text(&plan, args.wide));
        out.push_str(&requirement::precision_text(
            joint.as_ref(),
            with_prior.as_ref(),
            proposal.as_ref(),
        ));
        print_line(out.trim_end())?;
    }
    Ok(if plan.prediction.is_some() || proposal.is_some() {
        Completion::All
    } else {
        Completion::Partly
    })
}

fn plan_options(args: &PlanArgs, installation: Option<&Installation>) -> PlanOptions {
    PlanOptions {
        tip_deflection_m: args.tip_deflection,
        pixel_sigma: args.pixel_sigma,
        optics: installation.and_then(|i| i.optics),
    }
}

fn plan_text(plan: &InstallationPlan, wide: bool) -> String {
    let mut out = format!(
        "\nPlanned for a tip deflection of {} m and an image sigma of {} px.\n\nField of view {:.2} x {:.2} deg, focal length {:.0} px\n",
        plan.tip_deflection_m,
        plan.pixel_sigma,
        plan.field_of_view_deg[0],
        plan.field_of_view_deg[1],
        plan.focal_px
    );
    out.push_str(&optics_text(plan));
    out.push_str(&format!(
        "\n{}",
        marker_table(&plan.markers).text_with_width(wide)
    ));
    if let Some(prediction) = &plan.prediction {
        out.push_str(&format!("\n{}", prediction_text(prediction)));
        let budget = table::budget_table(&prediction.budget);
        out.push_str(&format!(
            "\nUncertainty budget of that deflection\n{}",
            budget.text()
        ));
    }
    for remark in &plan.remarks {
        out.push_str(&format!("\n{remark}\n"));
    }
    out
}

fn optics_text(plan: &InstallationPlan) -> String {
    let Some(o) = &plan.optics else {
        return "Depth of field and diffraction: give [camera.optics] in installation.toml\n"
            .into();
    };
    let far = o
        .far_limit_m
        .map_or("infinity".to_owned(), |f| format!("{f:.1} m"));
    format!(
        "Hyperfocal distance {:.2} m; markers from {:.1} to {:.1} m: focus at {:.2} m, sharp from {:.2} m to {far} \
         (circle of confusion {:.2} um; blur at both ends {:.2} um)\nAiry disc {:.1} um = {:.1} px\n",
        o.hyperfocal_m,
        o.nearest_m,
        o.farthest_m,
        o.best_focus_m,
        o.near_limit_m,
        o.circle_of_confusion_um,
        o.blur_um,
        o.airy_um,
        o.airy_px
    )
}

fn marker_table(markers: &[MarkerPlan]) -> Grid {
    let mm = |value: Option<f64>| format_fixed(value.map(|m| 1e3 * m), 1);
    Grid::for_rows(markers).columns(&[
        One("<marker", &|m| m.id.clone()),
        One("~<shape", &|m| m.shape.to_owned()),
        One("span / m", &|m| format_fixed(Some(m.span_m), 2)),
        One("~distance / m", &|m| format_fixed(Some(m.distance_m), 2)),
        One("spanwise / (mm/px)", &|m| {
            format_fixed(Some(m.ground.spanwise_mm), 1)
        }),
        One("in flight", &|m| {
            format_fixed(Some(m.flight.spanwise_mm), 1)
        }),
        One("streamwise / (mm/px)", &|m| {
            format_fixed(Some(m.ground.streamwise_mm), 2)
        }),
        One("image / px", &|m| {
            format!("{:.1} x {:.1}", m.image_px[1], m.image_px[0])
        }),
        One("blur / px", &|m| format_fixed(m.blur_px, 1)),
        One("sigma deflection / mm", &|m| {
            mm(m.sigma.as_ref().map(|s| s.deflection_m))
        }),
        One("~sigma span / mm", &|m| {
            mm(m.sigma.as_ref().map(|s| s.span_m))
        }),
        One("<seen", &|m| {
            if m.visible { "yes" } else { "no" }.to_owned()
        }),
    ])
}

fn prediction_text(prediction: &LayoutPrediction) -> String {
    let e = &prediction.expected;
    let mut out = format!(
        "Predicted standard deviations (spatial, one frame, redundancy {}): deflection of the axis relative to the survey {:.1} mm \
         at the tip, {:.1} mm along the span (root mean square), position along the span {:.1} mm at worst, tip twist {} deg\n",
        prediction.redundancy,
        1e3 * e.sigma_tip_deflection_m,
        1e3 * e.sigma_mean_deflection_m,
        1e3 * e.sigma_span_m,
        format_fixed(e.sigma_tip_twist_deg, 3)
    );
    if let Some(tip) = &prediction.tip {
        out.push_str(&tip_deflection_text(tip));
    }
    for (name, angle, twist) in &prediction.torsion {
        let (angle, twist) = (format_fixed(*angle, 3), format_fixed(*twist, 3));
        out.push_str(&format!(
            "Torsion '{name}': angle {angle} deg, twist free of bending {twist} deg\n"
        ));
    }
    if let Some(r) = prediction.pitch_bending_correlation {
        out.push_str(&format!("Correlation of mount pitch and bending: {r:.3}\n"));
    }
    out
}

/// Lists the standard deviation of the tip marker's deflection for each reference; that of the results comes first.
fn tip_deflection_text(tip: &TipSigma) -> String {
    let shown = tip.reference;
    let sigma = |reference: DeflectionReference| match reference {
        DeflectionReference::Survey => tip.deflection_m,
        DeflectionReference::Ground => tip.deflection_ground_m,
        DeflectionReference::Root => tip.deflection_root_m,
    };
    let text = |one: DeflectionReference| {
        Some(format!("{} {:.1} mm", one.description(), 1e3 * sigma(one)?))
    };
    let others = DeflectionReference::ALL
        .into_iter()
        .filter(|one| *one != shown)
        .filter_map(text);
    let all: Vec<String> = text(shown).into_iter().chain(others).collect();
    format!(
        "Deflection of {}, first that reported in results: {}\n",
        tip.marker,
        all.join("; ")
    )
}
