//! Section of the report with the aircraft data and the deflection as a function of them.

use maud::{Markup, html};

use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::figures::figure::{
    Figure, FigurePoint, FigureTrack, MAIN_COLOUR, TrackStyle, all_abscissas, all_values,
};
use wingd_evaluation::figures::plot::Axis;
use wingd_evaluation::grid::Grid;
use wingd_evaluation::number::{NONE, format_measured};
use wingd_evaluation::results::{ReportData, SeriesData, summary};
use wingd_measure::adjust::DeflectionReference;

/// Quantities that affect the deflection: a higher weight increases it, fuel in the wing reduces it.
const RELATED_QUANTITIES: [(Quantity, &str, f64); 3] = [
    (Quantity::WeightKg, "weight / t", 1e-3),
    (Quantity::FuelKg, "fuel on board / t", 1e-3),
    (Quantity::LoadFactor, "load factor / g", 1.0),
];

/// Returns the section; empty without aircraft data.
pub fn aircraft_section(data: &ReportData) -> Markup {
    let Some((unused, samples)) = data.feed else {
        return html! {};
    };
    html! {
        h2 id="aircraft" { "Aircraft data" }
        @for (quantity, label, scale) in RELATED_QUANTITIES {
            @let points = deflection_points(data, quantity, scale);
            @if points.len() > 1 {
                figure {
                    (draw_deflection_against(points, label, summary::common_reference(&data.series)))
                    p.caption { "Deflection of the tip marker of each frame with its 1-sigma bar, as a function of " (label.split(" /").next().unwrap_or(label)) "." }
                }
            }
        }
        (aircraft_table(data).html())
        p.caption {
            "Values with 1 sigma at the first shot of each series that has aircraft data, interpolated by time tag. " (samples) " samples used; lines not used: "
            (unused.unread) " without data, " (unused.repeated) " repeated, " (unused.jumped) " with an implausible time."
        }
    }
}

/// Returns the scaled quantity, the deflection and its standard deviation of each frame that has both.
fn deflection_points(data: &ReportData, quantity: Quantity, scale: f64) -> Vec<FigurePoint> {
    let reference = summary::common_reference(&data.series);
    let series_points = |series: &SeriesData| {
        let one = |record: &wingd_evaluation::record::ImageRecord| {
            let (deflection_m, sigma_m) = record.tip.as_ref()?.deflection(reference)?;
            let shot = series.shot_for_record(record)?;
            Some((
                scale * shot.aircraft.get(&quantity)?.value,
                deflection_m,
                sigma_m,
            ))
        };
        series.records.iter().filter_map(one).collect::<Vec<_>>()
    };
    data.series.iter().flat_map(series_points).collect()
}

fn draw_deflection_against(
    points: Vec<FigurePoint>,
    label: &str,
    reference: DeflectionReference,
) -> Markup {
    let dots = FigureTrack::from_points("single frames", MAIN_COLOUR, points);
    let tracks = vec![FigureTrack {
        style: TrackStyle::Dots,
        ..dots
    }];
    let x = Axis::from_values(all_abscissas(&tracks), label);
    let y_label = format!("tip deflection {} / m", reference.description());
    let y = Axis::from_values(all_values(&tracks), &y_label);
    Figure {
        name: format!("Deflection against {label}"),
        height: 240.0,
        x,
        y,
        tracks,
    }
    .draw()
}

fn aircraft_table(data: &ReportData) -> Grid {
    let joined: Vec<Quantity> = Quantity::ALL
        .into_iter()
        .filter(|q| {
            data.series
                .iter()
                .flat_map(|s| &s.shots)
                .any(|shot| shot.aircraft.contains_key(q))
        })
        .collect();
    let mut titles = vec!["<series"];
    titles.extend(joined.iter().map(|q| q.name()));
    let mut grid = Grid::new(&titles);
    for series in &data.series {
        let first = series.shots.iter().find(|shot| !shot.aircraft.is_empty());
        let cell = |q: &Quantity| {
            let value = first.and_then(|shot| shot.aircraft.get(q));
            value.map_or(NONE.to_owned(), |j| {
                format_measured(Some(j.value), Some(j.sigma), 2)
            })
        };
        grid.push(
            std::iter::once(series.name.clone())
                .chain(joined.iter().map(cell))
                .collect(),
        );
    }
    grid
}
