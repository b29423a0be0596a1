//! Figures of deflection and twist along the span, and of deflection and torsion over time.

use maud::Markup;

use wingd_evaluation::figures::figure::{
    Figure, FigurePoint, FigureTrack, MAIN_COLOUR, TrackStyle, all_abscissas, all_values,
};
use wingd_evaluation::figures::plot::{Axis, series_colour};
use wingd_evaluation::number::format_fixed;
use wingd_evaluation::record::{CurveRecord, ImageRecord};
use wingd_evaluation::results::SeriesData;
use wingd_evaluation::results::summary::{Mean, SeriesSummary, hours_between, solved_records};

/// Label of the axis along the span.
pub const SPAN_LABEL: &str = "span, outboard from the camera / m";

type CurveField<'a> = &'a dyn Fn(&CurveRecord) -> (f64, Option<f64>);

/// Draws the deflection of the bending axis along the span, one curve per series, with 1-sigma bands.
pub fn draw_deflection(summaries: &[SeriesSummary]) -> Markup {
    let deflection = |p: &CurveRecord| (p.deflection_m, p.sigma_deflection_m);
    draw_curves(
        summaries,
        "Deflection curves",
        "deflection of the bending axis / m",
        400.0,
        &deflection,
    )
}

/// Draws the standard deviation of the deflection along the span, mm.
pub fn draw_uncertainty(summaries: &[SeriesSummary]) -> Markup {
    let sigma = |p: &CurveRecord| (1e3 * p.sigma_deflection_m.unwrap_or(f64::NAN), None);
    draw_curves(
        summaries,
        "Standard deviation of the deflection",
        "std. dev. of the deflection / mm",
        170.0,
        &sigma,
    )
}

/// Draws the twist along the span with 1-sigma bands; `None` if no frame has a twist.
pub fn draw_twist(summaries: &[SeriesSummary]) -> Option<Markup> {
    let twist = |p: &CurveRecord| (p.twist_deg.unwrap_or(f64::NAN), p.sigma_twist_deg);
    draw_rotation(
        summaries,
        "Twist along the span",
        "twist, nose up / deg",
        &twist,
    )
}

/// Draws the streamwise twist along the span with 1-sigma bands; `None` if no frame has one.
pub fn draw_streamwise_twist(summaries: &[SeriesSummary]) -> Option<Markup> {
    let twist = |p: &CurveRecord| {
        (
            p.incidence.streamwise_twist_deg.unwrap_or(f64::NAN),
            p.incidence.sigma_streamwise_twist_deg,
        )
    };
    draw_rotation(
        summaries,
        "Streamwise twist along the span",
        "streamwise twist, nose up / deg",
        &twist,
    )
}

fn draw_rotation(
    summaries: &[SeriesSummary],
    name: &str,
    label: &str,
    column: CurveField,
) -> Option<Markup> {
    let any = summaries
        .iter()
        .flat_map(|s| &s.curve)
        .any(|p| column(p).0.is_finite());
    any.then(|| draw_curves(summaries, name, label, 260.0, column))
}

fn draw_curves(
    summaries: &[SeriesSummary],
    name: &str,
    label: &str,
    height: f64,
    column: CurveField,
) -> Markup {
    let shown: Vec<&SeriesSummary> = summaries.iter().filter(|s| !s.curve.is_empty()).collect();
    let track = |(i, s): (usize, &&SeriesSummary)| {
        FigureTrack::from_points(
            short_name(s),
            series_colour(i, shown.len()),
            curve_points(&s.curve, column),
        )
    };
    let tracks: Vec<FigureTrack> = shown.iter().enumerate().map(track).collect();
    let x = Axis::from_values(all_abscissas(&tracks), SPAN_LABEL);
    let y = Axis::from_values(all_values(&tracks).chain([0.0]), label);
    Figure {
        name: name.to_owned(),
        height,
        x,
        y,
        tracks,
    }
    .draw()
}

/// Returns a quantity along a curve, where it is finite.
pub fn curve_points(curve: &[CurveRecord], column: CurveField) -> Vec<FigurePoint> {
    let point = |p: &CurveRecord| {
        let (value, sigma) = column(p);
        (p.span_m, value, sigma)
    };
    curve
        .iter()
        .map(point)
        .filter(|p| p.1.is_finite())
        .collect()
}

/// Returns the name of a series, shortened, with its hour.
fn short_name(series: &SeriesSummary) -> String {
    let name: String = series
        .name
        .rsplit('/')
        .next()
        .unwrap_or(&series.name)
        .chars()
        .take(14)
        .collect();
    format!("{name}, {} h", format_fixed(Some(series.hour), 1))
}

/// Draws the deflection of the tip marker over time: single shots, and means with their standard deviations.
pub fn draw_tip_deflection(series: &[SeriesData], summaries: &[SeriesSummary]) -> Markup {
    let reference = summaries.first().map(|s| s.reference).unwrap_or_default();
    let shot = |r: &ImageRecord| Some(r.tip.as_ref()?.deflection(reference)?.0);
    let mean = |s: &SeriesSummary| s.tip_deflection_m;
    let track = TimeTrack {
        name: "tip deflection",
        colour: MAIN_COLOUR,
        dashed: false,
        hidden: false,
        shot: &shot,
        mean: &mean,
    };
    draw_over_time(
        series,
        summaries,
        "Tip deflection over time",
        "deflection of the tip marker / m",
        &[track],
    )
}

/// Draws torsion and twist of one pair over time.
pub fn draw_torsion(series: &[SeriesData], summaries: &[SeriesSummary], pair: &str) -> Markup {
    let pair_record = |r: &ImageRecord| r.torsion.iter().find(|t| t.name == pair).cloned();
    let mean_of = |s: &SeriesSummary| s.torsion.iter().find(|t| t.name == pair).cloned();
    let angle = |r: &ImageRecord| pair_record(r).and_then(|t| t.angle_deg);
    let twist = |r: &ImageRecord| pair_record(r).and_then(|t| t.twist_deg);
    let mean_angle = |s: &SeriesSummary| mean_of(s).and_then(|t| t.angle_deg);
    let mean_twist = |s: &SeriesSummary| mean_of(s).and_then(|t| t.twist_deg);
    let tracks = [
        TimeTrack {
            name: "torsion from the two deflections",
            colour: "#b3541e",
            dashed: true,
            hidden: true,
            shot: &angle,
            mean: &mean_angle,
        },
        TimeTrack {
            name: "twist, free of bending",
            colour: "#1d6b4f",
            dashed: false,
            hidden: false,
            shot: &twist,
            mean: &mean_twist,
        },
    ];
    draw_over_time(
        series,
        summaries,
        "Torsion over time",
        "nose up / deg",
        &tracks,
    )
}

/// Quantity over time.
struct TimeTrack<'a> {
    name: &'a str,
    colour: &'a str,
    dashed: bool,
    hidden: bool,
    shot: &'a dyn Fn(&ImageRecord) -> Option<f64>,
    mean: &'a dyn Fn(&SeriesSummary) -> Option<Mean>,
}

impl TimeTrack<'_> {
    /// Returns the means of the series, each at the mean time of its frames, and the single frames.
    fn tracks(&self, series: &[SeriesData], summaries: &[SeriesSummary]) -> [FigureTrack; 2] {
        let track = |of: &str| FigureTrack {
            hidden: self.hidden,
            ..FigureTrack::from_points(format!("{}, {of}", self.name), self.colour, Vec::new())
        };
        let mut means = FigureTrack {
            style: TrackStyle::DottedLine,
            dashed: self.dashed,
            ..track("means of the series")
        };
        let mut shots = FigureTrack {
            style: TrackStyle::SmallDots,
            ..track("single frames")
        };
        for (s, summary) in series.iter().zip(summaries) {
            let mut hours = Vec::new();
            for record in solved_records(s) {
                let Some(value) = (self.shot)(record) else {
                    continue;
                };
                let hour = shot_hour(s, summary, &record.image);
                hours.push((hour, None));
                shots.points.push((hour, value, None));
                shots.texts.push(record.image.clone());
            }
            if let Some(mean) = (self.mean)(summary) {
                let hour = Mean::from_values(&hours).map_or(summary.hour, |at| at.value);
                means.points.push((hour, mean.value, mean.sigma));
                means.texts.push(summary.name.clone());
            }
        }
        [means, shots]
    }
}

/// Returns the time of a shot, hours since the first series; if no time is known, by its position among the shots.
fn shot_hour(series: &SeriesData, summary: &SeriesSummary, image: &str) -> f64 {
    let place = series
        .shots
        .iter()
        .position(|s| s.image.as_deref() == Some(image));
    let Some(place) = place else {
        return summary.hour;
    };
    match (&series.shots[place].stamp, &series.begun) {
        (Some(at), Some(begun)) => summary.hour + hours_between(begun, at),
        _ => summary.hour + place as f64 / series.shots.len() as f64,
    }
}

fn draw_over_time(
    series: &[SeriesData],
    summaries: &[SeriesSummary],
    name: &str,
    label: &str,
    quantities: &[TimeTrack],
) -> Markup {
    let tracks: Vec<FigureTrack> = quantities
        .iter()
        .flat_map(|one| one.tracks(series, summaries))
        .collect();
    let begun = series.first().and_then(|s| s.begun.as_ref()).map(|b| b.utc);
    let x = Axis::from_hours(all_abscissas(&tracks), begun);
    let y = Axis::from_values(all_values(&tracks), label);
    Figure {
        name: name.to_owned(),
        height: 260.0,
        x,
        y,
        tracks,
    }
    .draw()
}
