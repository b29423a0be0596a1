//! Section of the report with the aircraft data and the deflection as a function of them.

use maud::{Markup, html};

use super::super::grid::Grid;
use super::super::number::{NONE, format_rounded};
use super::super::{ReportData, SeriesData, summary};
use super::chart::{Chart, HorizontalAxis, Trace, VerticalAxis, chart_point};
use super::plot::{Axis, Plot, svg_drawing};
use crate::aircraft::Quantity;

const WIDTH: f64 = 1040.0;
const COLOUR: &str = "#17456f";
/// Quantities that affect the deflection: a higher weight increases it, fuel in the wing reduces it.
const RELATED_QUANTITIES: [(Quantity, &str, f64); 3] = [
    (Quantity::WeightKg, "weight / t", 1e-3),
    (Quantity::FuelKg, "fuel on board / t", 1e-3),
    (Quantity::LoadFactor, "load factor / g", 1.0),
];

/// Returns the section; empty without aircraft data.
pub fn aircraft_section(data: &ReportData) -> Markup {
    let Some((unused, samples)) = data.feed else { return html! {} };
    html! {
        h2 id="aircraft" { "Aircraft data" }
        @for (quantity, label, scale) in RELATED_QUANTITIES {
            @let points = deflection_points(data, quantity);
            @if points.len() > 1 {
                figure {
                    (draw_deflection_against(&points, label, scale))
                    p.caption { "Deflection of the tip marker " (summary::common_reference(&data.series).description()) " of each frame with its 1-sigma bar, as a function of " (label.split(" /").next().unwrap_or(label)) "." }
                }
            }
        }
        div.scroll { (aircraft_table(data).html()) }
        p.caption {
            "Values with 1 sigma at the first shot of each series that has aircraft data, interpolated by time tag. " (samples) " samples used; lines not used: "
            (unused.unread) " without data, " (unused.repeated) " repeated, " (unused.jumped) " with an implausible time."
        }
    }
}

/// Returns quantity, deflection and its standard deviation of each frame that has both.
fn deflection_points(data: &ReportData, quantity: Quantity) -> Vec<(f64, f64, Option<f64>)> {
    let reference = summary::common_reference(&data.series);
    let series_points = |series: &SeriesData| {
        let one = |record: &crate::record::ImageRecord| {
            let (deflection_m, sigma_m) = record.tip.as_ref()?.deflection(reference)?;
            let shot = series.shot_for_record(record)?;
            Some((shot.aircraft.get(&quantity)?.value, deflection_m, sigma_m))
        };
        series.records.iter().filter_map(one).collect::<Vec<_>>()
    };
    data.series.iter().flat_map(series_points).collect()
}

fn draw_deflection_against(points: &[(f64, f64, Option<f64>)], label: &str, scale: f64) -> Markup {
    let ends = |p: &(f64, f64, Option<f64>)| [p.1 - p.2.unwrap_or(0.0), p.1 + p.2.unwrap_or(0.0)];
    let plot = Plot {
        area: [64.0, 12.0, WIDTH - 100.0, 240.0],
        x: Axis::from_values(points.iter().map(|p| scale * p.0), label),
        y: Axis::from_values(points.iter().flat_map(ends), "deflection of the tip marker / m"),
    };
    let content = html! {
        (plot.frame())
        @for (x, y, sigma) in points {
            (plot.value(scale * x, *y, *sigma, COLOUR, ""))
        }
    };
    let name = format!("Deflection against {label}");
    let chart = Chart {
        name: name.clone(),
        height: 300.0,
        x: HorizontalAxis::from_label(label),
        y: VerticalAxis { label: "deflection of the tip marker / m".to_owned(), zero: false },
        tracks: vec![Trace {
            name: "single frames".to_owned(),
            colour: COLOUR.to_owned(),
            points: points.iter().map(|(x, y, sigma)| chart_point(scale * x, *y, *sigma)).collect(),
            ..Trace::default()
        }],
    };
    html! { (svg_drawing(WIDTH, 300.0, &name, &content)) (chart.to_script(None)) }
}

fn aircraft_table(data: &ReportData) -> Grid {
    let joined: Vec<Quantity> = Quantity::ALL
        .into_iter()
        .filter(|q| data.series.iter().flat_map(|s| &s.shots).any(|shot| shot.aircraft.contains_key(q)))
        .collect();
    let mut titles = vec!["<series"];
    titles.extend(joined.iter().map(|q| q.name()));
    let mut grid = Grid::new(&titles);
    for series in &data.series {
        let first = series.shots.iter().find(|shot| !shot.aircraft.is_empty());
        let cell = |q: &Quantity| {
            let value = first.and_then(|shot| shot.aircraft.get(q));
            value.map_or(NONE.to_owned(), |j| {
                let (value, sigma) = format_rounded(Some(j.value), Some(j.sigma), 2);
                format!("{value} ± {sigma}")
            })
        };
        grid.push(std::iter::once(series.name.clone()).chain(joined.iter().map(cell)).collect());
    }
    grid
}
