//! This section of the report shows the aircraft's data beside the deflection.

use maud::{Markup, html};

use super::super::grid::Grid;
use super::super::number::{NONE, rounded};
use super::super::{ReportData, SeriesData, summary};
use super::chart::{Across, Chart, Trace, Upright, point};
use super::plot::{Axis, Plot, drawing};
use crate::aircraft::Quantity;

const WIDTH: f64 = 1040.0;
const COLOUR: &str = "#17456f";
/// What the deflection follows: more weight asks for more deflection, a wing's own fuel relieves it.
const AGAINST: [(Quantity, &str, f64); 3] = [
    (Quantity::WeightKg, "weight / t", 1e-3),
    (Quantity::FuelKg, "fuel on board / t", 1e-3),
    (Quantity::LoadFactor, "load factor / g", 1.0),
];

/// The section; nothing where there are no aircraft data.
pub fn section(data: &ReportData) -> Markup {
    let Some((unused, samples)) = data.feed else { return html! {} };
    html! {
        h2 id="aircraft" { "The aircraft's data" }
        @for (quantity, label, scale) in AGAINST {
            @let points = points(data, quantity);
            @if points.len() > 1 {
                figure {
                    (against(&points, label, scale))
                    p.caption { "Deflection of the tip marker " (summary::reference(&data.series).words()) " of each frame with its 1-sigma bar, against " (label.split(" /").next().unwrap_or(label)) "." }
                }
            }
        }
        div.scroll { (table(data).html()) }
        p.caption {
            "At the first shot of each series that has them, joined by time tag, with 1 sigma. " (samples) " samples; lines not used: "
            (unused.unread) " that are no data, " (unused.repeated) " repeated, " (unused.jumped) " whose time cannot be true."
        }
    }
}

/// Quantity, deflection and its standard deviation of each frame that has both.
fn points(data: &ReportData, quantity: Quantity) -> Vec<(f64, f64, Option<f64>)> {
    let reference = summary::reference(&data.series);
    let of = |series: &SeriesData| {
        let one = |record: &crate::record::ImageRecord| {
            let (deflection_m, sigma_m) = record.tip.as_ref()?.deflection(reference)?;
            let shot = series.shot_of(record)?;
            Some((shot.aircraft.get(&quantity)?.value, deflection_m, sigma_m))
        };
        series.records.iter().filter_map(one).collect::<Vec<_>>()
    };
    data.series.iter().flat_map(of).collect()
}

fn against(points: &[(f64, f64, Option<f64>)], label: &str, scale: f64) -> Markup {
    let ends = |p: &(f64, f64, Option<f64>)| [p.1 - p.2.unwrap_or(0.0), p.1 + p.2.unwrap_or(0.0)];
    let plot = Plot {
        area: [64.0, 12.0, WIDTH - 100.0, 240.0],
        x: Axis::over(points.iter().map(|p| scale * p.0), label),
        y: Axis::over(points.iter().flat_map(ends), "deflection of the tip marker / m"),
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
        x: Across::plain(label),
        y: Upright { label: "deflection of the tip marker / m".to_owned(), zero: false },
        tracks: vec![Trace {
            name: "single frames".to_owned(),
            colour: COLOUR.to_owned(),
            points: points.iter().map(|(x, y, sigma)| point(scale * x, *y, *sigma)).collect(),
            ..Trace::default()
        }],
    };
    html! { (drawing(WIDTH, 300.0, &name, &content)) (chart.values(None)) }
}

fn table(data: &ReportData) -> Grid {
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
                let (value, sigma) = rounded(Some(j.value), Some(j.sigma), 2);
                format!("{value} ± {sigma}")
            })
        };
        grid.push(std::iter::once(series.name.clone()).chain(joined.iter().map(cell)).collect());
    }
    grid
}
