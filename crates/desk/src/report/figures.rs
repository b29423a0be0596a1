//! Figures of deflection and twist along the span, and of deflection and torsion over time.

use maud::Markup;

use wingd_evaluation::figures::figure::{
    BREAK, Figure, FigurePoint, FigureTrack, MAIN_COLOUR, TrackStyle, all_abscissas, all_values,
};
use wingd_evaluation::figures::plot::{Axis, series_colour};
use wingd_evaluation::number::format_fixed;
use wingd_evaluation::record::{CurveRecord, ImageRecord};
use wingd_evaluation::results::summary::{Mean, SeriesSummary, hours_between, solved_records};
use wingd_evaluation::results::{ReportData, SeriesData};
use wingd_measure::adjust::DeflectionReference;

/// Label of the axis along the span.
pub const SPAN_LABEL: &str = "span, outboard from the camera / m";

type CurveField<'a> = &'a dyn Fn(&CurveRecord) -> (f64, Option<f64>);

/// Maximum number of single curves of a series: more are one area of colour.
const MAX_SINGLE_CURVES: usize = 24;

/// Curves of a series: its mean, or frames singly if they scatter by more than the band of the mean.
pub struct SeriesCurves<'a> {
    pub name: String,
    /// Number of solved frames.
    pub solved: usize,
    /// Name and curve of the frames; the mean alone has no name.
    pub frames: Vec<(&'a str, &'a [CurveRecord])>,
}

/// Selects the curves of each series that has one.
pub fn series_curves<'a>(
    data: &'a ReportData,
    summaries: &'a [SeriesSummary],
) -> Vec<SeriesCurves<'a>> {
    let select = |s: &'a SeriesSummary| {
        let is_wide = is_scattered(s);
        let of_series = data.frames.iter().filter(|f| f.series == s.name && is_wide);
        let solved = of_series.map(|f| &f.record).filter(|r| r.is_solved());
        let mut frames: Vec<(&str, &[CurveRecord])> =
            solved.map(|r| (r.image.as_str(), &r.curve[..])).collect();
        frames.sort_by_key(|(image, _)| *image);
        let step = frames.len().div_ceil(MAX_SINGLE_CURVES).max(1);
        frames = frames.into_iter().step_by(step).collect();
        if frames.len() < 2 {
            frames = vec![("", &s.curve)];
        }
        SeriesCurves {
            name: short_name(s),
            solved: s.solved,
            frames,
        }
    };
    let with_curve = summaries.iter().filter(|s| !s.curve.is_empty());
    with_curve.map(select).collect()
}

/// Returns whether frames scatter by more than the band of their mean.
pub fn is_scattered(s: &SeriesSummary) -> bool {
    let mean = s.tip_deflection_m;
    let beyond = mean.and_then(|mean| Some(mean.scatter? > mean.sigma?));
    beyond.unwrap_or(false)
}

/// Draws the deflection of the bending axis along the span with 1-sigma bands.
pub fn draw_deflection(curves: &[SeriesCurves], reference: DeflectionReference) -> Markup {
    let deflection = |p: &CurveRecord| p.deflection(reference).unwrap_or((f64::NAN, None));
    let label = format!("deflection {} / m", reference.description());
    draw_curves(curves, "Deflection curves", &label, 400.0, &deflection)
}

/// Draws the standard deviation of the deflection along the span, mm.
pub fn draw_uncertainty(curves: &[SeriesCurves], reference: DeflectionReference) -> Markup {
    let sigma = |p: &CurveRecord| {
        let sigma_m = p.deflection(reference).and_then(|(_, sigma_m)| sigma_m);
        (1e3 * sigma_m.unwrap_or(f64::NAN), None)
    };
    let label = format!("std. dev. {} / mm", reference.description());
    draw_curves(
        curves,
        "Standard deviation of the deflection",
        &label,
        170.0,
        &sigma,
    )
}

/// Draws the twist along the span with 1-sigma bands; `None` if no frame has a twist.
pub fn draw_twist(curves: &[SeriesCurves]) -> Option<Markup> {
    let twist = |p: &CurveRecord| (p.twist_deg.unwrap_or(f64::NAN), p.sigma_twist_deg);
    draw_rotation(
        curves,
        "Twist along the span",
        "twist, nose up / deg",
        &twist,
    )
}

/// Draws the streamwise twist along the span with 1-sigma bands; `None` if no frame has one.
pub fn draw_streamwise_twist(curves: &[SeriesCurves]) -> Option<Markup> {
    let twist = |p: &CurveRecord| {
        let incidence = &p.incidence;
        let value = incidence.streamwise_twist_deg.unwrap_or(f64::NAN);
        (value, incidence.sigma_streamwise_twist_deg)
    };
    let name = "Streamwise twist along the span";
    draw_rotation(curves, name, "streamwise twist, nose up / deg", &twist)
}

fn draw_rotation(
    curves: &[SeriesCurves],
    name: &str,
    label: &str,
    column: CurveField,
) -> Option<Markup> {
    let mut all = curves.iter().flat_map(|c| &c.frames).flat_map(|f| f.1);
    all.any(|p| column(p).0.is_finite())
        .then(|| draw_curves(curves, name, label, 260.0, column))
}

/// Draws one track per series; its single curves are runs of the track.
fn draw_curves(
    curves: &[SeriesCurves],
    name: &str,
    label: &str,
    height: f64,
    column: CurveField,
) -> Markup {
    let track = |(i, series): (usize, &SeriesCurves)| {
        let mut track =
            FigureTrack::from_points(&series.name, series_colour(i, curves.len()), vec![]);
        for (image, curve) in &series.frames {
            let points = curve_points(curve, column);
            let names = std::iter::repeat_n((*image).to_owned(), points.len() + 1);
            track.texts.extend(names);
            track.points.extend(points);
            track.points.push(BREAK);
        }
        track
    };
    let tracks: Vec<FigureTrack> = curves.iter().enumerate().map(track).collect();
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
        &format!("tip deflection {} / m", reference.description()),
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
