//! Figure of a plan: predicted uncertainty and resolution along the span.

use maud::{Markup, PreEscaped, html};

use wingd_evaluation::figures::figure::MAIN_COLOUR;
use wingd_evaluation::figures::plot::{Axis, Plot, px};
use wingd_measure::plan::{InstallationPlan, MarkerPlan, SpanPlan};

const WIDTH: f64 = 900.0;
const LEFT: f64 = 70.0;
const PANEL: f64 = 200.0;
const GAP: f64 = 66.0;
const WARM_COLOUR: &str = "#c2571a";
const STYLE: &str = "text{font:11.5px 'Segoe UI',Arial,'DejaVu Sans',sans-serif;fill:#333b46}\
.title{font-size:12.5px;font-weight:600}.grid{stroke:#e8ebef}.frame{fill:none;stroke:#9aa3af}\
.curve{fill:none;stroke-width:1.7}";

/// Function that reads a value from a point of the span.
type SpanField<'a> = &'a dyn Fn(&SpanPlan) -> Option<f64>;

/// Curve of a panel, with its name.
struct PanelCurve<'a> {
    name: &'a str,
    colour: &'a str,
    value: SpanField<'a>,
}

/// Returns a complete SVG file.
pub fn plan_svg(plan: &InstallationPlan) -> String {
    let deflection: SpanField = &|p| Some(1e3 * p.sigma_deflection_m?);
    let twist: SpanField = &|p| p.sigma_twist_deg;
    let spanwise: SpanField = &|p| Some(p.ground.spanwise_mm);
    let streamwise: SpanField = &|p| Some(p.ground.streamwise_mm);
    let deflection_title = format!(
        "Predicted standard deviation of the deflection (tip deflected by {} m, image positions {} px)",
        plan.tip_deflection_m, plan.pixel_sigma
    );
    let panels = [
        (
            deflection_title.as_str(),
            "deflection / mm",
            vec![PanelCurve {
                name: "deflection",
                colour: MAIN_COLOUR,
                value: deflection,
            }],
        ),
        (
            "Predicted standard deviation of the twist",
            "twist / deg",
            vec![PanelCurve {
                name: "twist",
                colour: MAIN_COLOUR,
                value: twist,
            }],
        ),
        (
            "Size of one pixel on the skin, on the ground",
            "footprint / mm",
            vec![
                PanelCurve {
                    name: "spanwise",
                    colour: MAIN_COLOUR,
                    value: spanwise,
                },
                PanelCurve {
                    name: "streamwise",
                    colour: WARM_COLOUR,
                    value: streamwise,
                },
            ],
        ),
    ];
    let height = panels.len() as f64 * (PANEL + GAP) + 10.0;
    let content = html! {
        style { (PreEscaped(STYLE)) }
        rect width=(px(WIDTH)) height=(px(height)) fill="#fff" {}
        @for (k, (title, label, curves)) in panels.iter().enumerate() {
            (draw_panel(plan, 26.0 + k as f64 * (PANEL + GAP), title, label, curves))
        }
    };
    let view = format!("0 0 {} {}", px(WIDTH), px(height));
    html! { svg xmlns="http://www.w3.org/2000/svg" viewBox=(view) width=(px(WIDTH)) height=(px(height)) { (content) } }
        .into_string()
}

fn draw_panel(
    plan: &InstallationPlan,
    top: f64,
    title: &str,
    label: &str,
    curves: &[PanelCurve],
) -> Markup {
    let values = curves
        .iter()
        .flat_map(|c| plan.span.iter().filter_map(|p| (c.value)(p)));
    let positions = plan
        .span
        .iter()
        .map(|p| p.span_m)
        .chain(std::iter::once(0.0));
    let plot = Plot {
        area: [LEFT, top, WIDTH - LEFT - 100.0, PANEL],
        x: Axis::from_values(positions, "span, outboard from the camera / m"),
        y: Axis::from_values(values.chain(std::iter::once(0.0)), label),
    };
    html! {
        text.title x=(px(LEFT)) y=(px(top - 9.0)) { (title) }
        (plot.frame())
        @for m in &plan.markers { (draw_marker_tick(&plot, m)) }
        @for c in curves {
            @let points: Vec<(f64, f64)> =
                plan.span.iter().filter_map(|p| Some((p.span_m, (c.value)(p)?))).collect();
            (plot.line(&points, c.colour, false))
            @if let Some((x, y)) = points.last().map(|p| plot.point_at(p.0, p.1)) {
                text x=(px(x + 8.0)) y=(px(y + 4.0)) fill=(c.colour) { (c.name) }
            }
        }
    }
}

/// Draws a tick on the axis at a marker, red if the marker is outside the image.
fn draw_marker_tick(plot: &Plot, marker: &MarkerPlan) -> Markup {
    let [_, top, _, height] = plot.area;
    let x = plot.point_at(marker.span_m, 0.0).0;
    let colour = if marker.visible { "#5b6573" } else { "#d02020" };
    html! {
        line x1=(px(x)) y1=(px(top + height - 7.0)) x2=(px(x)) y2=(px(top + height)) stroke=(colour) {
            title { (marker.id) }
        }
    }
}
