//! `wingd plan` says what an installation will be able to see, or one that is not there yet.

mod draft;
mod want;

use std::path::PathBuf;

use super::{Done, Failure, RIGHTS, print, unwritable};
use crate::installation::Installation;
use crate::measure::plan::{
    self, Alternative, Expected, MarkerPlan, Optics, Plan, PlanOptions, Prediction, TipSigma,
};
use crate::record::{BudgetShare, Reference};
use crate::report::grid::Grid;
use crate::report::number::fixed;
use crate::report::{plan_figure, table};

/// Resolution, depth of field and predicted uncertainty of an installation.
#[derive(clap::Args)]
pub struct Args {
    /// The installation; without orientation.toml the camera is taken to look at the wing's middle
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    #[command(flatten)]
    draft: draft::DraftArgs,
    /// Also so many frames of a flight adjusted together
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=500))]
    frames: Option<u16>,
    /// The standard deviation of the tip's deflection that is wanted, for example 5mm: whether it is reached, where what is
    /// planned comes from, and what would mend it, cheapest first
    #[arg(long, value_name = "LENGTH", value_parser = want::length)]
    want: Option<f64>,
    /// Write the layout (with --want the one proposed): installation.toml, camera.toml, a survey.csv to be replaced by the
    /// true one, and layout.svg, a drawing to scale
    #[arg(long, value_name = "DIR")]
    layout: Option<PathBuf>,
    /// Deflection of the outermost marker to plan for, m
    #[arg(long, value_name = "M", default_value_t = PlanOptions::default().tip_deflection_m, allow_negative_numbers = true)]
    tip_deflection: f64,
    /// Standard deviation of an image coordinate to plan for, px
    #[arg(long, value_name = "PX", default_value_t = PlanOptions::default().pixel_sigma)]
    pixel_sigma: f64,
    /// Terms of the curvature, 1 to 10; an adjustment takes 8 or 10 where none are given
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u8).range(1..=10))]
    curvature_terms: u8,
    /// Draw the plan as SVG
    #[arg(long, value_name = "FILE.svg")]
    figure: Option<PathBuf>,
    /// One JSON object
    #[arg(long)]
    json: bool,
    /// Every column of the tables, however wide [default: those that fit 80 characters]
    #[arg(long)]
    wide: bool,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let sensible = args.pixel_sigma > 0.0 && args.pixel_sigma <= 100.0 && args.tip_deflection.abs() <= 100.0;
    if !sensible {
        return Err(Failure::Usage(
            "--pixel-sigma must be in (0, 100] px, --tip-deflection within 100 m".into(),
        ));
    }
    let frames = args.frames.map_or(1, usize::from);
    let installation = match args.draft.span {
        None => super::load_installation(&super::default_paths::installation(args.installation.as_deref())?)?,
        Some(_) => args.draft.installation(&options(args, None), frames)?,
    };
    let options = options(args, Some(&installation));
    let plan = plan::plan(&installation.setup, installation.orientation.as_ref(), &options)
        .map_err(|e| Failure::Failed(format!("no plan: {e}")))?;
    if let Some(file) = &args.figure {
        std::fs::write(file, plan_figure::figure(&plan)).map_err(unwritable(file, RIGHTS))?;
    }
    let together = want::together(&installation, &options, args.frames)?;
    let beside = want::beside(&installation, &options, frames)?;
    let asked = args.want.map(|sigma_m| want::ask(&installation, &options, sigma_m, frames)).transpose()?;
    if let Some(folder) = &args.layout {
        want::write_layout(folder, &installation, &options, asked.as_ref())?;
    }
    if args.json {
        print(&want::json(&plan, together.as_ref(), beside.as_ref(), asked.as_ref())?)?;
    } else {
        let mut out = text(&plan, args.wide);
        out.push_str(&want::text(together.as_ref(), beside.as_ref(), asked.as_ref()));
        print(out.trim_end())?;
    }
    Ok(if plan.prediction.is_some() { Done::All } else { Done::Partly })
}

fn options(args: &Args, installation: Option<&Installation>) -> PlanOptions {
    let optics = installation.and_then(|i| i.optics.as_ref()).map(|o| Optics {
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

fn text(plan: &Plan, wide: bool) -> String {
    let mut out = format!(
        "Planned for a tip deflection of {} m and {} px in the image.\n\nField of view {:.2} x {:.2} deg, camera constant {:.0} px\n",
        plan.tip_deflection_m,
        plan.pixel_sigma,
        plan.field_of_view_deg[0],
        plan.field_of_view_deg[1],
        plan.focal_px
    );
    out.push_str(&optics(plan));
    out.push_str(&format!("\n{}", markers(&plan.markers).text_at(wide)));
    if let Some(prediction) = &plan.prediction {
        out.push_str(&format!("\n{}", predicted(prediction)));
        let shares: Vec<BudgetShare> = prediction.budget.iter().map(Into::into).collect();
        out.push_str(&format!(
            "\nWhat the variance of that deflection comes from\n{}",
            table::budget(&shares).text()
        ));
        out.push_str(&format!("\nOne marker less, one marker more\n{}", changes(prediction).text()));
        let marks = alternatives(prediction, &prediction.fixed_marks);
        out.push_str(&format!(
            "\nMarks more that are rigid to the cabin, in the frame's corners\n{}",
            marks.text()
        ));
        let known = alternatives(prediction, &prediction.terms_known);
        out.push_str(&format!("\nIf what the installation leaves open were known\n{}", known.text()));
    }
    for remark in &plan.remarks {
        out.push_str(&format!("\n{remark}\n"));
    }
    out
}

fn optics(plan: &Plan) -> String {
    let Some(o) = &plan.optics else {
        return "Depth of field and diffraction: give [camera.optics] in installation.toml\n".into();
    };
    let far = o.far_limit_m.map_or("infinity".to_owned(), |f| format!("{f:.1} m"));
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

fn markers(markers: &[MarkerPlan]) -> Grid {
    let mm = |value: Option<f64>| fixed(value.map(|m| 1e3 * m), 1);
    Grid::each(markers).columns(&[
        ("<marker", &|m| m.id.clone()),
        ("~<shape", &|m| m.shape.to_owned()),
        ("span / m", &|m| fixed(Some(m.span_m), 2)),
        ("~distance / m", &|m| fixed(Some(m.distance_m), 2)),
        ("spanwise / (mm/px)", &|m| fixed(Some(m.ground.spanwise_mm), 1)),
        ("in flight", &|m| fixed(Some(m.flight.spanwise_mm), 1)),
        ("streamwise / (mm/px)", &|m| fixed(Some(m.ground.streamwise_mm), 2)),
        ("image / px", &|m| format!("{:.1} x {:.1}", m.image_px[1], m.image_px[0])),
        ("blur / px", &|m| fixed(m.blur_px, 1)),
        ("sigma deflection / mm", &|m| mm(m.sigma.as_ref().map(|s| s.deflection_m))),
        ("~sigma span / mm", &|m| mm(m.sigma.as_ref().map(|s| s.span_m))),
        ("<seen", &|m| if m.visible { "yes" } else { "no" }.to_owned()),
    ])
}

fn predicted(prediction: &Prediction) -> String {
    let e = &prediction.expected;
    let mut out = format!(
        "Predicted standard deviations (spatial, one frame, redundancy {}): deflection of the axis against the survey {:.1} mm \
         at the tip, {:.1} mm along the span (root mean square), position along the span {:.1} mm at worst, tip twist {} deg\n",
        prediction.redundancy,
        1e3 * e.sigma_tip_deflection_m,
        1e3 * e.sigma_mean_deflection_m,
        1e3 * e.sigma_span_m,
        fixed(e.sigma_tip_twist_deg, 3)
    );
    if let Some(tip) = &prediction.tip {
        out.push_str(&tip_deflections(tip));
    }
    for (name, angle, twist) in &prediction.torsion {
        let (angle, twist) = (fixed(*angle, 3), fixed(*twist, 3));
        out.push_str(&format!("Torsion '{name}': angle {angle} deg, twist free of bending {twist} deg\n"));
    }
    if let Some(r) = prediction.pitch_bending_correlation {
        out.push_str(&format!("Correlation of the mount's pitch with bending: {r:.3}\n"));
    }
    out
}

/// Of the tip marker, each deflection; the one that results show first.
fn tip_deflections(tip: &TipSigma) -> String {
    let shown = Reference::from(tip.reference);
    let sigma = |reference: Reference| match reference {
        Reference::Survey => tip.deflection_m,
        Reference::Ground => tip.deflection_ground_m,
        Reference::Root => tip.deflection_root_m,
    };
    let text = |one: Reference| Some(format!("{} {:.1} mm", one.words(), 1e3 * sigma(one)?));
    let others = Reference::ALL.into_iter().filter(|one| *one != shown).filter_map(text);
    let all: Vec<String> = text(shown).into_iter().chain(others).collect();
    format!("Deflection of {}, the first is what results show: {}\n", tip.marker, all.join("; "))
}

/// How much larger the tip's deflection is in its standard deviation than as surveyed.
fn change(prediction: &Prediction, e: Option<Expected>) -> String {
    let before = prediction.expected.sigma_tip_deflection_m;
    let change = e.map(|e| 100.0 * (e.sigma_tip_deflection_m / before - 1.0));
    change.map_or_else(|| fixed(None, 0), |c| format!("{c:+.1} %"))
}

fn mm(e: Option<Expected>, pick: fn(&Expected) -> f64) -> String {
    fixed(e.as_ref().map(|e| 1e3 * pick(e)), 2)
}

fn changes(prediction: &Prediction) -> Grid {
    let mut rows = vec![("as surveyed".to_owned(), None, Some(prediction.expected))];
    rows.extend(prediction.changes.iter().map(|change| {
        let name = change.without.as_ref().map_or("one more".to_owned(), |id| format!("without {id}"));
        (name, Some(change.span_m), change.expected)
    }));
    Grid::each(&rows).columns(&[
        ("<layout", &|(name, ..)| name.clone()),
        ("span / m", &|(_, span_m, _)| fixed(*span_m, 2)),
        ("tip deflection / mm", &|(.., e)| mm(*e, |e| e.sigma_tip_deflection_m)),
        ("mean deflection / mm", &|(.., e)| mm(*e, |e| e.sigma_mean_deflection_m)),
        ("tip twist / deg", &|(.., e)| fixed(e.and_then(|e| e.sigma_tip_twist_deg), 3)),
        ("along span / mm", &|(.., e)| mm(*e, |e| e.sigma_span_m)),
        ("tip deflection changes by", &|(.., e)| change(prediction, *e)),
    ])
}

fn alternatives(prediction: &Prediction, list: &[Alternative]) -> Grid {
    Grid::each(list).columns(&[
        ("<assumed", &|one| one.name.clone()),
        ("tip deflection / mm", &|one| mm(one.expected, |e| e.sigma_tip_deflection_m)),
        ("mean deflection / mm", &|one| mm(one.expected, |e| e.sigma_mean_deflection_m)),
        ("tip deflection changes by", &|one| change(prediction, one.expected)),
    ])
}
