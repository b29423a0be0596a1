//! Small plot of tip deflection over time.

use maud::{Markup, html};

use crate::daemon::format_span;
use crate::report::overview::FlightOverview;
use crate::report::summary::{Mean, hours_between};

const LEFT: f64 = 46.0;
const BOTTOM: f64 = 22.0;
/// Maximum number of series that are drawn with error bars of 1 sigma.
const MAX_BARS: usize = 200;

/// Plots the mean of each series with its standard deviation; a sentence if no series is solved. `width` is that of the
/// element on a phone, so that letters keep their size there.
pub fn deflection_curve(overview: &FlightOverview, width: f64, height: f64) -> Markup {
    let begun = overview.series.iter().find_map(|line| line.begun.as_ref());
    let hour = |index: usize| match (begun, overview.series.get(index).and_then(|l| l.begun.as_ref())) {
        (Some(first), Some(at)) => hours_between(first, at),
        _ => index as f64,
    };
    let lines = overview.series.iter().enumerate();
    let points: Vec<(f64, Mean)> = lines.filter_map(|(i, l)| Some((hour(i), l.tip_deflection_m?))).collect();
    if points.is_empty() {
        return html! { p.soft { "No deflection yet." } };
    }
    let ends = || points.iter().flat_map(|(_, m)| [m.value - m.sigma.unwrap_or(0.0), m.value + m.sigma.unwrap_or(0.0)]);
    let (low, high) = (ends().fold(0.0_f64, f64::min), ends().fold(f64::MIN, f64::max));
    let step = round_step((high - low).max(1e-6) / 3.0);
    let (low, high) = ((low / step).floor() * step, ((high / step).ceil() * step).max(low + step));
    let last = points.iter().map(|p| p.0).fold(1e-9, f64::max);
    let x = |hour: f64| LEFT + hour / last * (width - LEFT - 8.0);
    let y = |deflection: f64| 6.0 + (high - deflection) / (high - low) * (height - BOTTOM - 6.0);
    let path: Vec<String> = points.iter().map(|(h, m)| format!("{:.1},{:.1}", x(*h), y(m.value))).collect();
    let ticks = (0..=((high - low) / step).round() as usize).map(|i| low + i as f64 * step);
    let end = if points.len() > 1 { format!("after {}", format_span((3600.0 * last).round())) } else { String::new() };
    html! {
        svg viewBox=(format!("0 0 {width} {height}")) role="img" aria-label=(format!("Tip deflection over time, {} series", points.len())) {
            @for v in ticks {
                line.grid x1=(LEFT) y1=(format!("{:.1}", y(v))) x2=(width - 8.0) y2=(format!("{:.1}", y(v))) {}
                text x=(LEFT - 6.0) y=(format!("{:.1}", y(v) + 4.0)) text-anchor="end" { (format!("{v:.1}")) }
            }
            text x=(LEFT) y=(height - 4.0) { "tip deflection / m" }
            text x=(width - 8.0) y=(height - 4.0) text-anchor="end" { (end) }
            polyline.curve points=(path.join(" ")) {}
            @if points.len() <= MAX_BARS {
                @for (h, m) in &points {
                    @let s = m.sigma.unwrap_or(0.0);
                    line.bar x1=(format!("{:.1}", x(*h))) x2=(format!("{:.1}", x(*h))) y1=(format!("{:.1}", y(m.value - s))) y2=(format!("{:.1}", y(m.value + s))) {}
                    circle.dot cx=(format!("{:.1}", x(*h))) cy=(format!("{:.1}", y(m.value))) r="3" {}
                }
            }
        }
    }
}

/// Returns 1, 2 or 5 times a power of ten, not below `raw`.
fn round_step(raw: f64) -> f64 {
    crate::report::html::round_step(raw)
}
