//! Page of several flights: deflection of each over time.

use maud::{Markup, html};

use super::super::grid::Grid;
use super::super::number::{count_text, format_rounded};
use super::super::overview::{FlightOverview, SeriesOverview};
use super::super::summary::{Mean, hours_between};
use super::chart::{Chart, HorizontalAxis, Trace, VerticalAxis, chart_point};
use super::plot::{Axis, Plot, px, series_colour, svg_drawing};
use super::standalone_page;
use crate::clock::Stamp;

const WIDTH: f64 = 1040.0;

/// Returns the mean of each series with its hours since the first series of the flight.
fn flight_track(flight: &FlightOverview) -> Vec<(f64, Mean)> {
    let first = flight.series.iter().find_map(|line| line.begun.as_ref());
    let hour = |(index, line): (usize, &SeriesOverview)| {
        let known = first.zip(line.begun.as_ref()).map(|(first, at)| hours_between(first, at));
        Some((known.unwrap_or(index as f64), line.tip_deflection_m?))
    };
    flight.series.iter().enumerate().filter_map(hour).collect()
}

/// Returns the complete page, without external resources.
pub fn flights_page(flights: &[FlightOverview]) -> String {
    let warnings = flights.iter().flat_map(|f| f.warning.iter().chain(&f.notes));
    let main = html! {
        header { h1 { "Wing deflection, flight by flight" } p.sub { (count_text(flights.len(), "flight")) } }
        @for warning in warnings { p.warning { (warning) } }
        h2 { "Deflection over time" }
        figure {
            (deflection_figure(flights))
            p.caption { "Deflection of the outermost marker, mean of each series; bands: 1 sigma of one frame. Times start at the first series of each flight; the reference of the deflections is in the table." }
        }
        h2 { "Flights" }
        div.scroll { (flights_table(flights).html()) }
    };
    standalone_page(
        &format!("Wing deflection: {}", count_text(flights.len(), "flight")),
        &main,
        "Lengths in metres; sigma is one standard deviation.",
    )
}

/// Returns the time unit suited to the longest of the times, and the number of these units per hour.
fn time_unit(longest_h: f64) -> (&'static str, f64) {
    match longest_h {
        h if h < 0.05 => ("s", 3600.0),
        h if h < 2.0 => ("min", 60.0),
        h if h < 72.0 => ("h", 1.0),
        _ => ("days", 1.0 / 24.0),
    }
}

fn deflection_figure(flights: &[FlightOverview]) -> Markup {
    let mut tracks: Vec<(usize, Vec<(f64, Mean)>)> =
        flights.iter().map(flight_track).enumerate().filter(|(_, track)| !track.is_empty()).collect();
    let (unit, an_hour) = time_unit(tracks.iter().flat_map(|(_, track)| track).map(|p| p.0).fold(0.0, f64::max));
    tracks.iter_mut().flat_map(|(_, track)| track).for_each(|point| point.0 *= an_hour);
    let label = format!("time since the flight's first series / {unit}");
    let points = || tracks.iter().flat_map(|(_, track)| track);
    let ends = |m: &Mean| [m.value - m.sigma.unwrap_or(0.0), m.value + m.sigma.unwrap_or(0.0)];
    let height = 320.0_f64.max(14.0 * tracks.len() as f64);
    let plot = Plot {
        area: [64.0, 12.0, WIDTH - 64.0 - 120.0, height],
        x: Axis::from_values(points().map(|p| p.0), &label),
        y: Axis::from_values(points().flat_map(|p| ends(&p.1)), "deflection of the tip marker / m"),
    };
    let content = html! {
        (plot.frame())
        @for (row, (index, track)) in tracks.iter().enumerate() {
            @let colour = series_colour(*index, flights.len());
            @let band: Vec<_> = track.iter().map(|(h, m)| (*h, m.value, m.sigma)).collect();
            @let line: Vec<_> = track.iter().map(|(h, m)| (*h, m.value)).collect();
            (plot.band(&band, &colour))
            (plot.line(&line, &colour, false))
            @let y = 24.0 + 14.0 * row as f64;
            line.curve x1=(px(WIDTH - 112.0)) y1=(px(y)) x2=(px(WIDTH - 92.0)) y2=(px(y)) stroke=(colour) {}
            text.name x=(px(WIDTH - 86.0)) y=(px(y + 4.0)) fill=(colour) { (flights.get(*index).map_or("", |f| f.flight.as_str())) }
        }
    };
    let trace = |(index, track): &(usize, Vec<(f64, Mean)>)| Trace {
        name: flights.get(*index).map_or(String::new(), |f| f.flight.clone()),
        colour: series_colour(*index, flights.len()),
        joined: true,
        points: track.iter().map(|(h, m)| chart_point(*h, m.value, m.sigma)).collect(),
        ..Trace::default()
    };
    let name = "Deflection over time of each flight";
    let chart = Chart {
        name: name.to_owned(),
        height: 380.0,
        x: HorizontalAxis::from_label(&label),
        y: VerticalAxis { label: "deflection of the tip marker / m".to_owned(), zero: false },
        tracks: tracks.iter().map(trace).collect(),
    };
    html! { (svg_drawing(WIDTH, height + 60.0, name, &content)) (chart.to_script(None)) }
}

fn flights_table(flights: &[FlightOverview]) -> Grid {
    let begun = |f: &FlightOverview| f.series.iter().find_map(|line| line.begun.clone());
    let day = |at: Stamp| at.utc.strftime("%Y-%m-%d %H:%M").to_string();
    let deflection = |f: &FlightOverview| {
        let greatest = f.greatest().map(|(_, deflection)| deflection);
        format_rounded(
            greatest.map(|deflection| deflection.deflection_m),
            greatest.and_then(|deflection| deflection.sigma_m),
            3,
        )
    };
    Grid::for_rows(flights).columns(&[
        ("<flight", &|f| f.flight.clone()),
        ("<start (UTC)", &|f| begun(f).map_or("unknown".to_owned(), day)),
        ("series", &|f| f.series.len().to_string()),
        ("frames", &|f| f.sum(|line| line.frames).to_string()),
        ("solved", &|f| f.sum(|line| line.solved).to_string()),
        ("largest deflection / m", &|f| deflection(f).0),
        ("sigma / m", &|f| deflection(f).1),
        ("<in frame", &|f| {
            f.greatest().map_or(String::new(), |(line, deflection)| format!("{}/{}", line.name, deflection.image))
        }),
        ("<reference", &|f| f.reference.description().to_owned()),
    ])
}
