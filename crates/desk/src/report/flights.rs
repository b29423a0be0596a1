//! Page of several flights: deflection of each over time.

use maud::{Markup, html};

use super::standalone_page;
use wingd_base::clock::Stamp;
use wingd_evaluation::figures::figure::{Figure, FigureTrack, all_abscissas, all_values};
use wingd_evaluation::figures::plot::{Axis, series_colour};
use wingd_evaluation::grid::ColumnDefinition::{One, Pair};
use wingd_evaluation::grid::Grid;
use wingd_evaluation::number::{count_text, format_measured, format_rounded};
use wingd_evaluation::results::overview::{FlightOverview, SeriesOverview};
use wingd_evaluation::results::summary::{Mean, hours_between};

/// Returns the mean of each series with its hours since the first series of the flight.
fn flight_track(flight: &FlightOverview) -> Vec<(f64, Mean)> {
    let first = flight.series.iter().find_map(|line| line.begun.as_ref());
    let hour = |(index, line): (usize, &SeriesOverview)| {
        let known = first
            .zip(line.begun.as_ref())
            .map(|(first, at)| hours_between(first, at));
        Some((known.unwrap_or(index as f64), line.tip_deflection_m?))
    };
    flight.series.iter().enumerate().filter_map(hour).collect()
}

/// Returns the complete page, without external resources.
pub fn flights_page(flights: &[FlightOverview]) -> String {
    let warnings = flights
        .iter()
        .flat_map(|f| f.warning.iter().chain(&f.notes));
    let sum =
        |count: fn(&SeriesOverview) -> usize| flights.iter().map(|f| f.sum(count)).sum::<usize>();
    let (frames, passed) = (sum(|line| line.frames), sum(|line| line.passed));
    let deflections = flights.iter().filter_map(|f| Some((f, f.greatest()?)));
    let greatest = deflections.max_by(|a, b| a.1.1.deflection_m.total_cmp(&b.1.1.deflection_m));
    let main = html! {
        header { h1 { "Wing deflection, flight by flight" } p.sub { (count_text(flights.len(), "flight")) } }
        p.answer.warning[passed < frames] {
            @if let Some((flight, (_, one))) = greatest {
                "Tip deflection (" (one.marker) ") up to " (format_measured(Some(one.deflection_m), one.sigma_m, 3)) " m "
                (flight.reference.description()) ", in flight " (flight.flight) ": "
            }
            (passed) " of " (count_text(frames, "frame")) " are solved and not rejected by their global test."
        }
        @for warning in warnings { p.warning { (warning) } }
        h2 { "Deflection over time" }
        figure {
            (deflection_figure(flights))
            p.caption { "Deflection of the outermost marker, mean of each series; bands: 1 sigma of one frame. Times start at the first series of each flight; the reference of the deflections is in the table." }
        }
        h2 { "Flights" }
        (flights_table(flights).html())
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
    let all: Vec<Vec<(f64, Mean)>> = flights.iter().map(flight_track).collect();
    let (unit, an_hour) = time_unit(all.iter().flatten().map(|p| p.0).fold(0.0, f64::max));
    let track = |(index, means): (usize, &Vec<(f64, Mean)>)| {
        let points = means
            .iter()
            .map(|(h, m)| (an_hour * h, m.value, m.sigma))
            .collect();
        let name = flights.get(index).map_or("", |f| f.flight.as_str());
        FigureTrack::from_points(name, series_colour(index, flights.len()), points)
    };
    let tracks: Vec<FigureTrack> = all
        .iter()
        .enumerate()
        .filter(|(_, means)| !means.is_empty())
        .map(track)
        .collect();
    let x = Axis::from_values(
        all_abscissas(&tracks),
        &format!("time since the flight's first series / {unit}"),
    );
    let y = Axis::from_values(all_values(&tracks), "deflection of the tip marker / m");
    Figure {
        name: "Deflection over time of each flight".to_owned(),
        height: 320.0,
        x,
        y,
        tracks,
    }
    .draw()
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
        One("<flight", &|f| f.flight.clone()),
        One("<start (UTC)", &|f| {
            begun(f).map_or("unknown".to_owned(), day)
        }),
        One("series", &|f| f.series.len().to_string()),
        One("frames", &|f| f.sum(|line| line.frames).to_string()),
        One("solved", &|f| f.sum(|line| line.solved).to_string()),
        One("not rejected", &|f| f.sum(|line| line.passed).to_string()),
        Pair("largest deflection / m", "sigma / m", &deflection),
        One("<in frame", &|f| {
            f.greatest().map_or(String::new(), |(line, deflection)| {
                format!("{}/{}", line.name, deflection.image)
            })
        }),
        One("<reference", &|f| f.reference.description().to_owned()),
    ])
}
