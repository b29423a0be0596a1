//! `wingd plan` predicts the resolution and precision of an existing or planned installation.

mod draft;
mod requirement;

use std::path::PathBuf;

use serde_json::{Value, json};

use crate::plan::{
    draft_installation, drafted_facts, flight_precision, plan_failure, prior_precision,
    write_layout,
};
use crate::report::plan_figure;
use wingd_base::failure::CHECK_WRITE_ACCESS;
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line, write_output};
use wingd_evaluation::grid::ColumnDefinition::One;
use wingd_evaluation::grid::Grid;
use wingd_evaluation::inputs::default_paths::{load_installation, resolve_installation};
use wingd_evaluation::inputs::stopping::run_long_task;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::number::format_fixed;
use wingd_evaluation::results::table;
use wingd_measure::adjust::DeflectionReference;
use wingd_measure::plan;
use wingd_measure::plan::DraftVariant;
use wingd_measure::plan::Optics;
use wingd_measure::plan::Requirement;
use wingd_measure::plan::{AlternativeLayout, LayoutPrecision, LayoutPrediction, TipSigma};
use wingd_measure::plan::{InstallationPlan, MarkerPlan, PlanOptions};
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
    /// Write the layout (with --want the proposed one): installation.toml, camera.toml, a survey.csv to be replaced by the
    /// true survey, and layout.svg, a drawing to scale
    #[arg(long, value_name = "DIR")]
    layout: Option<PathBuf>,
    /// Planned deflection of the outermost marker, m
    #[arg(long, value_name = "M", default_value_t = PlanOptions::default().tip_deflection_m, allow_negative_numbers = true)]
    tip_deflection: f64,
    /// Planned standard deviation of an image coordinate, px
    #[arg(long, value_name = "PX", default_value_t = PlanOptions::default().pixel_sigma)]
    pixel_sigma: f64,
    /// Number of curvature terms, 1 to 10
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u8).range(1..=10))]
    curvature_terms: u8,
    /// Draw the plan as SVG
    #[arg(long, value_name = "FILE.svg")]
    figure: Option<PathBuf>,
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
    if let Some(file) = &args.figure {
        write_output(file, plan_figure::plan_svg(&plan), CHECK_WRITE_ACCESS)?;
    }
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
        let assumed = || plan::assumed_attitude(setup, orientation, &options).map_err(plan_failure);
        let (layout, attitude) = match &proposal {
            Some((_, layout, attitude)) => (layout, attitude.clone()),
            None => (setup, assumed()?),
        };
        let facts = match &draft {
            Some(_) => drafted_facts(layout, args.draft.wing_side()),
            None => Setup {
                markers: layout.markers.clone(),
                ..setup.clone()
            },
        };
        write_layout(folder, layout, &facts, &attitude, options.tip_deflection_m)?;
    }
    let variants = draft
        .map(|draft| {
            let predict = || plan::predict_variants(&draft, setup, &options);
            run_long_task("predicting variants", predict)
        })
        .unwrap_or_default();
    if args.json {
        let mut all = requirement::plan_json(
            &plan,
            joint.as_ref(),
            with_prior.as_ref(),
            proposal.as_ref(),
        );
        if !variants.is_empty() {
            all.insert("variants".into(), variants_json(args, &variants));
        }
        print_json(&all)?;
    } else {
        let mut out = requirement::first_line(&plan, joint.as_ref(), proposal.as_ref());
        out.push_str(&plan_text(&plan, args.wide));
        out.push_str(&requirement::precision_text(
            joint.as_ref(),
            with_prior.as_ref(),
            proposal.as_ref(),
        ));
        if !variants.is_empty() {
            out.push_str(&variants_text(args, &variants));
        }
        print_line(out.trim_end())?;
    }
    Ok(if plan.prediction.is_some() || proposal.is_some() {
        Completion::All
    } else {
        Completion::Partly
    })
}

/// Returns the focal length of a variant, mm.
fn focal_mm(args: &PlanArgs, variant: &DraftVariant) -> f64 {
    args.draft.focal.unwrap_or_default() * variant.focal_ratio
}

fn variants_json(args: &PlanArgs, variants: &[DraftVariant]) -> Value {
    let one = |v: &DraftVariant| json!({"focal_mm": focal_mm(args, v), "height_m": v.height_m, "sigma_tip_deflection_m": v.sigma_m});
    variants.iter().map(one).collect()
}

/// Lists other lenses and heights; recommends the most precise one that can be measured.
fn variants_text(args: &PlanArgs, variants: &[DraftVariant]) -> String {
    let rows = Grid::for_rows(variants).columns(&[
        One("focal length / mm", &|v| {
            format!("{:.1}", focal_mm(args, v))
        }),
        One("height / m", &|v| format!("{:.2}", v.height_m)),
        One("tip deflection / mm", &|v| {
            format_fixed(v.sigma_m.map(|m| 1e3 * m), 1)
        }),
    ]);
    let mut out = format!(
        "\nOther lenses and heights, one frame (- cannot be measured)\n{}",
        rows.text()
    );
    let usable = variants.iter().filter_map(|v| Some((v, v.sigma_m?)));
    if let Some((best, _)) = usable.min_by(|a, b| a.1.total_cmp(&b.1)) {
        let (focal, height) = (focal_mm(args, best), best.height_m);
        let way = if variants.first() == Some(best) {
            "None is more precise"
        } else {
            "Most precise"
        };
        out.push_str(&format!(
            "{way}: {focal:.1} mm, {height:.2} m above the skin\n"
        ));
    }
    out
}

fn plan_options(args: &PlanArgs, installation: Option<&Installation>) -> PlanOptions {
    let optics = installation
        .and_then(|i| i.optics.as_ref())
        .map(|o| Optics {
            focal_length_mm: o.focal_length_mm,
            f_number: o.f_number,
            pixel_pitch_um: o.pixel_pitch_um,
            circle_of_confusion_um: o.circle_of_confusion_um,
        });
    PlanOptions {
        tip_deflection_m: args.tip_deflection,
        pixel_sigma: args.pixel_sigma,
        optics,
        curvature_terms: usize::from(args.curvature_terms),
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
        out.push_str(&format!(
            "\nOne marker removed or added\n{}",
            marker_change_table(prediction).text()
        ));
        let marks = alternative_table(prediction, &prediction.fixed_targets);
        out.push_str(&format!(
            "\nAdditional fixed targets, rigid to the cabin, in the corners of the image\n{}",
            marks.text()
        ));
        let known = alternative_table(prediction, &prediction.terms_known);
        out.push_str(&format!(
            "\nUncertain values of the installation, if each were known exactly\n{}",
            known.text()
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

/// Returns the change of the tip deflection's standard deviation relative to the layout as surveyed, in percent.
fn relative_change(prediction: &LayoutPrediction, e: Option<LayoutPrecision>) -> String {
    let before = prediction.expected.sigma_tip_deflection_m;
    let change = e.map(|e| 100.0 * (e.sigma_tip_deflection_m / before - 1.0));
    change.map_or_else(|| format_fixed(None, 0), |c| format!("{c:+.1} %"))
}

fn format_sigma_mm(e: Option<LayoutPrecision>, pick: fn(&LayoutPrecision) -> f64) -> String {
    format_fixed(e.as_ref().map(|e| 1e3 * pick(e)), 2)
}

fn marker_change_table(prediction: &LayoutPrediction) -> Grid {
    let mut rows = vec![("as surveyed".to_owned(), None, Some(prediction.expected))];
    rows.extend(prediction.changes.iter().map(|change| {
        let name = change
            .without
            .as_ref()
            .map_or("one more".to_owned(), |id| format!("without {id}"));
        (name, Some(change.span_m), change.expected)
    }));
    Grid::for_rows(&rows).columns(&[
        One("<layout", &|(name, ..)| name.clone()),
        One("span / m", &|(_, span_m, _)| format_fixed(*span_m, 2)),
        One("tip deflection / mm", &|(.., e)| {
            format_sigma_mm(*e, |e| e.sigma_tip_deflection_m)
        }),
        One("mean deflection / mm", &|(.., e)| {
            format_sigma_mm(*e, |e| e.sigma_mean_deflection_m)
        }),
        One("tip twist / deg", &|(.., e)| {
            format_fixed(e.and_then(|e| e.sigma_tip_twist_deg), 3)
        }),
        One("along span / mm", &|(.., e)| {
            format_sigma_mm(*e, |e| e.sigma_span_m)
        }),
        One("tip deflection changes by", &|(.., e)| {
            relative_change(prediction, *e)
        }),
    ])
}

fn alternative_table(prediction: &LayoutPrediction, list: &[AlternativeLayout]) -> Grid {
    Grid::for_rows(list).columns(&[
        One("<assumed", &|one| one.name.clone()),
        One("tip deflection / mm", &|one| {
            format_sigma_mm(one.expected, |e| e.sigma_tip_deflection_m)
        }),
        One("mean deflection / mm", &|one| {
            format_sigma_mm(one.expected, |e| e.sigma_mean_deflection_m)
        }),
        One("tip deflection changes by", &|one| {
            relative_change(prediction, one.expected)
        }),
    ])
}
