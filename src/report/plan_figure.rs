//! This drawing shows a plan: predicted uncertainty and resolution along the span.

use maud::{Markup, PreEscaped, html};

use super::html::plot::{Axis, Plot, px};
use crate::measure::plan::{MarkerPlan, Plan, SpanPlan};

const WIDTH: f64 = 900.0;
const LEFT: f64 = 70.0;
const PANEL: f64 = 200.0;
const GAP: f64 = 66.0;
const DARK: &str = "#17456f";
const WARM: &str = "#c2571a";
const STYLE: &str = "text{font:11.5px 'Segoe UI',Arial,'DejaVu Sans',sans-serif;fill:#333b46}\
.title{font-size:12.5px;font-weight:600}.grid{stroke:#e8ebef}.frame{fill:none;stroke:#9aa3af}\
.curve{fill:none;stroke-width:1.7}";

/// Where a value is read from a point of the span.
type Value<'a> = &'a dyn Fn(&SpanPlan) -> Option<f64>;

/// A curve of a panel, with its name.
struct Curve<'a> {
    name: &'a str,
    colour: &'a str,
    value: Value<'a>,
}

/// A complete SVG file.
pub fn figure(plan: &Plan) -> String {
    let deflection: Value = &|p| Some(1e3 * p.sigma_deflection_m?);
    let twist: Value = &|p| p.sigma_twist_deg;
    let spanwise: Value = &|p| Some(p.ground.spanwise_mm);
    let streamwise: Value = &|p| Some(p.ground.streamwise_mm);
    let deflection_title = format!(
        "Predicted standard deviation of the deflection (tip deflected {} m, image {} px)",
        plan.tip_deflection_m, plan.pixel_sigma
    );
    let panels = [
        (
            deflection_title.as_str(),
            "deflection / mm",
            vec![Curve { name: "deflection", colour: DARK, value: deflection }],
        ),
        (
            "Predicted standard deviation of the twist",
            "twist / deg",
            vec![Curve { name: "twist", colour: DARK, value: twist }],
        ),
        (
            "What one pixel covers on the skin, on ground",
            "footprint / mm",
            vec![
                Curve { name: "spanwise", colour: DARK, value: spanwise },
                Curve { name: "streamwise", colour: WARM, value: streamwise },
            ],
        ),
    ];
    let height = panels.len() as f64 * (PANEL + GAP) + 10.0;
    let content = html! {
        style { (PreEscaped(STYLE)) }
        rect width=(px(WIDTH)) height=(px(height)) fill="#fff" {}
        @for (k, (title, label, curves)) in panels.iter().enumerate() {
            (panel(plan, 26.0 + k as f64 * (PANEL + GAP), title, label, curves))
        }
    };
    let view = format!("0 0 {} {}", px(WIDTH), px(height));
    html! { svg xmlns="http://www.w3.org/2000/svg" viewBox=(view) width=(px(WIDTH)) height=(px(height)) { (content) } }
        .into_string()
}

fn panel(plan: &Plan, top: f64, title: &str, label: &str, curves: &[Curve]) -> Markup {
    let values = curves.iter().flat_map(|c| plan.span.iter().filter_map(|p| (c.value)(p)));
    let positions = plan.span.iter().map(|p| p.span_m).chain(std::iter::once(0.0));
    let plot = Plot {
        area: [LEFT, top, WIDTH - LEFT - 100.0, PANEL],
        x: Axis::over(positions, "span, outboard from the camera / m"),
        y: Axis::over(values.chain(std::iter::once(0.0)), label),
    };
    html! {
        text.title x=(px(LEFT)) y=(px(top - 9.0)) { (title) }
        (plot.frame())
        @for m in &plan.markers { (station(&plot, m)) }
        @for c in curves {
            @let points: Vec<(f64, f64)> =
                plan.span.iter().filter_map(|p| Some((p.span_m, (c.value)(p)?))).collect();
            (plot.line(&points, c.colour, false))
            @if let Some((x, y)) = points.last().map(|p| plot.at(p.0, p.1)) {
                text x=(px(x + 8.0)) y=(px(y + 4.0)) fill=(c.colour) { (c.name) }
            }
        }
    }
}

/// A tick on the axis where a marker stands; red where it is out of the picture.
fn station(plot: &Plot, marker: &MarkerPlan) -> Markup {
    let [_, top, _, height] = plot.area;
    let x = plot.at(marker.span_m, 0.0).0;
    let colour = if marker.visible { "#5b6573" } else { "#d02020" };
    html! {
        line x1=(px(x)) y1=(px(top + height - 7.0)) x2=(px(x)) y2=(px(top + height)) stroke=(colour) {
            title { (marker.id) }
        }
    }
}
