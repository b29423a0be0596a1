//! Small figure of tip deflection over time.

use maud::{Markup, html};

use wingd_evaluation::figures::axis::Axis;
use wingd_evaluation::figures::figure::{
    Figure, FigureTrack, MAIN_COLOUR, TrackStyle, all_abscissas, all_values,
};
use wingd_evaluation::results::overview::FlightOverview;
use wingd_evaluation::results::summary::hours_between;

/// Maximum number of series that are drawn with error bars of 1 sigma.
const MAX_BARS: usize = 200;

/// Draws the mean of each series with its standard deviation; a sentence if no series is solved.
pub fn deflection_curve(overview: &FlightOverview, height: f64) -> Markup {
    let begun = overview.series.iter().find_map(|line| line.begun.as_ref());
    let hour = |index: usize| match (
        begun,
        overview.series.get(index).and_then(|l| l.begun.as_ref()),
    ) {
        (Some(first), Some(at)) => hours_between(first, at),
        _ => index as f64,
    };
    let lines = overview.series.iter().enumerate();
    let points: Vec<_> = lines
        .filter_map(|(i, l)| {
            Some((
                hour(i),
                l.tip_deflection_m?.value,
                l.tip_deflection_m?.sigma,
            ))
        })
        .collect();
    if points.is_empty() {
        return html! { p.soft { "No deflection yet." } };
    }
    let name = format!("Tip deflection over time, {} series", points.len());
    let style = if points.len() <= MAX_BARS {
        TrackStyle::DottedLine
    } else {
        TrackStyle::Line
    };
    let tracks = vec![FigureTrack {
        style,
        ..FigureTrack::from_points("", MAIN_COLOUR, points)
    }];
    let x = Axis::from_hours(all_abscissas(&tracks), begun.map(|stamp| stamp.utc));
    let label = format!("tip deflection {} / m", overview.reference.description());
    let y = Axis::from_values(all_values(&tracks).chain([0.0]), &label);
    Figure {
        name,
        height,
        x,
        y,
        tracks,
    }
    .draw()
}
