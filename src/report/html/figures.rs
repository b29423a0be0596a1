//! Figures of deflection and twist along the span, and of deflection and torsion over time.

use maud::{Markup, html};

use super::super::SeriesData;
use super::super::number::format_fixed;
use super::super::summary::{Mean, SeriesSummary, hours_between, solved_records};
use super::chart::{Chart, HorizontalAxis, Trace, VerticalAxis, chart_point};
use super::plot::{Axis, Plot, px, series_colour, spread_labels, svg_drawing};
use crate::record::{CurveRecord, ImageRecord};

const WIDTH: f64 = 1040.0;
const LEFT: f64 = 64.0;
/// Spacing of the series names.
const NAME_SPACING: f64 = 14.0;
/// Width at the right for the series names.
const NAMES_WIDTH: f64 = 190.0;

/// Name of the figure whose curves are also shown in other figures.
const DEFLECTION: &str = "Deflection curves";

type CurveField<'a> = &'a dyn Fn(&CurveRecord) -> (f64, Option<f64>);

/// Draws the deflection of the bending axis along the span, one curve per series, with 1-sigma bands.
pub fn draw_deflection(summaries: &[SeriesSummary]) -> Markup {
    let deflection = |p: &CurveRecord| (p.deflection_m, p.sigma_deflection_m);
    draw_curves(summaries, DEFLECTION, "deflection of the bending axis / m", 400.0, &deflection, 2)
}

/// Draws the standard deviation of the deflection along the span, mm.
pub fn draw_uncertainty(summaries: &[SeriesSummary]) -> Markup {
    let sigma = |p: &CurveRecord| (1e3 * p.sigma_deflection_m.unwrap_or(f64::NAN), None);
    draw_curves(summaries, "Standard deviation of the deflection", "std. dev. of the deflection / mm", 170.0, &sigma, 1)
}

/// Draws the twist along the span with 1-sigma bands; `None` if no frame has a twist.
pub fn draw_twist(summaries: &[SeriesSummary]) -> Option<Markup> {
    let any = summaries.iter().flat_map(|s| &s.curve).any(|p| p.twist_deg.is_some());
    let twist = |p: &CurveRecord| (p.twist_deg.unwrap_or(f64::NAN), p.sigma_twist_deg);
    any.then(|| draw_curves(summaries, "Twist along the span", "twist, nose up / deg", 260.0, &twist, 2))
}

fn draw_curves(
    summaries: &[SeriesSummary],
    name: &str,
    label: &str,
    height: f64,
    column: CurveField,
    decimals: usize,
) -> Markup {
    let shown: Vec<&SeriesSummary> = summaries.iter().filter(|s| !s.curve.is_empty()).collect();
    let values = |p: &CurveRecord| {
        let (v, s) = column(p);
        [v - s.unwrap_or(0.0), v + s.unwrap_or(0.0)]
    };
    let points = || shown.iter().flat_map(|s| &s.curve);
    let zero = std::iter::once(0.0);
    let plot = Plot {
        area: [LEFT, 12.0, WIDTH - LEFT - NAMES_WIDTH, height],
        x: Axis::from_values(points().map(|p| p.span_m), "span, outboard from the camera / m"),
        y: Axis::from_values(points().flat_map(values).chain(zero), label),
    };
    let colour = |i: usize| series_colour(i, shown.len());
    let content = html! {
        (plot.frame())
        @for (i, s) in shown.iter().enumerate() {
            (plot.band(&band_points(s, column), &colour(i)))
            (plot.line(&line_points(s, column), &colour(i), false))
        }
        (draw_series_names(&plot, &shown, column, decimals))
    };
    html! {
        (svg_drawing(WIDTH, height + 60.0, name, &content))
        (curve_chart(&shown, name, label, height, column).to_script((name == DEFLECTION).then_some("deflection")))
    }
}

/// Returns the curves as data for the script of the page.
fn curve_chart(shown: &[&SeriesSummary], name: &str, label: &str, height: f64, column: CurveField) -> Chart {
    let trace = |(i, s): (usize, &&SeriesSummary)| Trace {
        name: short_name(shown, i),
        series: Some(s.name.clone()),
        colour: series_colour(i, shown.len()),
        joined: true,
        points: band_points(s, column).into_iter().map(|(x, y, sigma)| chart_point(x, y, sigma)).collect(),
        ..Trace::default()
    };
    Chart {
        name: name.to_owned(),
        height,
        x: HorizontalAxis::from_label("span, outboard from the camera / m"),
        y: VerticalAxis { label: label.to_owned(), zero: true },
        tracks: shown.iter().enumerate().map(trace).collect(),
    }
}

fn band_points(s: &SeriesSummary, column: CurveField) -> Vec<(f64, f64, Option<f64>)> {
    let point = |p: &CurveRecord| {
        let (v, sigma) = column(p);
        (p.span_m, v, sigma)
    };
    s.curve.iter().map(point).filter(|p| p.1.is_finite()).collect()
}

fn line_points(s: &SeriesSummary, column: CurveField) -> Vec<(f64, f64)> {
    s.curve.iter().map(|p| (p.span_m, column(p).0)).collect()
}

/// Draws name and last value of each series at the end of its curve; if there is no room for all, of every second, third,
/// ... series.
fn draw_series_names(plot: &Plot, shown: &[&SeriesSummary], column: CurveField, decimals: usize) -> Markup {
    let last = |s: &&SeriesSummary| s.curve.iter().rev().map(|p| (p.span_m, column(p).0)).find(|p| p.1.is_finite());
    let [left, top, width, height] = plot.area;
    let room = ((height - 6.0) / NAME_SPACING).floor().max(1.0) as usize;
    let every = shown.len().div_ceil(room);
    let named = |i: usize| i.is_multiple_of(every) || i + 1 == shown.len();
    let ends: Vec<(usize, (f64, f64))> =
        shown.iter().enumerate().filter(|(i, _)| named(*i)).filter_map(|(i, s)| Some((i, last(s)?))).collect();
    let heights: Vec<f64> = ends.iter().map(|(_, (x, y))| plot.point_at(*x, *y).1).collect();
    let gap = (height / ends.len().max(1) as f64).min(NAME_SPACING);
    let placed = spread_labels(&heights, gap, top + 4.0, top + height - 2.0);
    let right = left + width;
    html! {
        @for ((i, (x, y)), at) in ends.iter().zip(&placed) {
            @let colour = series_colour(*i, shown.len());
            @let (from, level) = plot.point_at(*x, *y);
            polyline.leader points=(format!("{},{} {},{} {},{}", px(from + 2.0), px(level), px(right + 4.0), px(*at), px(right + 10.0), px(*at))) {}
            text.name x=(px(right + 13.0)) y=(px(at + 4.0)) fill=(colour) {
                (short_name(shown, *i)) ": " (format_fixed(Some(*y), decimals))
            }
        }
    }
}

/// Returns the name of a series, shortened, with its hour.
fn short_name(shown: &[&SeriesSummary], index: usize) -> String {
    shown.get(index).map_or(String::new(), |s| {
        let name: String = s.name.rsplit('/').next().unwrap_or(&s.name).chars().take(14).collect();
        format!("{name}, {:.1} h", s.hour)
    })
}

/// Draws the deflection of the tip marker over time: single shots, and means with their standard deviations.
pub fn draw_tip_deflection(series: &[SeriesData], summaries: &[SeriesSummary]) -> Markup {
    let reference = summaries.first().map(|s| s.reference).unwrap_or_default();
    let shot = |r: &ImageRecord| Some(r.tip.as_ref()?.deflection(reference)?.0);
    let mean = |s: &SeriesSummary| s.tip_deflection_m;
    let track = TimeTrack { name: "tip deflection", colour: "#17456f", dashed: false, shot: &shot, mean: &mean };
    draw_over_time(series, summaries, "Tip deflection over time", "deflection of the tip marker / m", 260.0, &[track])
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
            shot: &angle,
            mean: &mean_angle,
        },
        TimeTrack { name: "twist, free of bending", colour: "#1d6b4f", dashed: false, shot: &twist, mean: &mean_twist },
    ];
    draw_over_time(series, summaries, "Torsion over time", "nose up / deg", 240.0, &tracks)
}

/// Quantity over time.
struct TimeTrack<'a> {
    name: &'a str,
    colour: &'a str,
    dashed: bool,
    shot: &'a dyn Fn(&ImageRecord) -> Option<f64>,
    mean: &'a dyn Fn(&SeriesSummary) -> Option<Mean>,
}

impl TimeTrack<'_> {
    /// Returns the mean of each series at the mean time of its frames.
    fn means(&self, series: &[SeriesData], summaries: &[SeriesSummary]) -> Vec<(f64, Mean)> {
        let series_mean = |(s, summary): (&SeriesData, &SeriesSummary)| {
            let with = solved_records(s).into_iter().filter(|r| (self.shot)(r).is_some());
            let hours: Vec<(f64, _)> = with.map(|r| (shot_hour(s, summary, &r.image), None)).collect();
            Some((Mean::from_values(&hours).map_or(summary.hour, |at| at.value), (self.mean)(summary)?))
        };
        series.iter().zip(summaries).filter_map(series_mean).collect()
    }

    fn shots(&self, series: &[SeriesData], summaries: &[SeriesSummary]) -> Vec<(f64, f64, String)> {
        let series_shots = |(s, summary): (&SeriesData, &SeriesSummary)| {
            let one = |r: &&ImageRecord| Some((shot_hour(s, summary, &r.image), (self.shot)(r)?, r.image.clone()));
            solved_records(s).iter().filter_map(one).collect::<Vec<_>>()
        };
        series.iter().zip(summaries).flat_map(series_shots).collect()
    }

    /// Returns the means and the single frames as data for the script of the page.
    fn traces(&self, summaries: &[SeriesSummary], means: &[(f64, Mean)], shots: &[(f64, f64, String)]) -> [Trace; 2] {
        let named = summaries.iter().filter(|s| (self.mean)(s).is_some()).map(|s| s.name.clone());
        let mean = Trace {
            name: format!("{}, means of the series", self.name),
            colour: self.colour.to_owned(),
            joined: true,
            dashed: self.dashed,
            dots: true,
            points: means.iter().map(|(h, m)| chart_point(*h, m.value, m.sigma)).collect(),
            texts: named.collect(),
            ..Trace::default()
        };
        let single = Trace {
            name: format!("{}, single frames", self.name),
            colour: self.colour.to_owned(),
            small: true,
            points: shots.iter().map(|(h, v, _)| chart_point(*h, *v, None)).collect(),
            texts: shots.iter().map(|(_, _, image)| image.clone()).collect(),
            ..Trace::default()
        };
        [mean, single]
    }

    fn draw(&self, plot: &Plot, means: &[(f64, Mean)], shots: &[(f64, f64, String)]) -> Markup {
        let band: Vec<_> = means.iter().map(|(h, m)| (*h, m.value, m.sigma)).collect();
        let line: Vec<_> = means.iter().map(|(h, m)| (*h, m.value)).collect();
        html! {
            (plot.band(&band, self.colour))
            (plot.line(&line, self.colour, self.dashed))
            @for (x, y, image) in shots { (plot.shot(*x, *y, self.colour, image)) }
            @for (h, m) in means {
                (plot.value(*h, m.value, m.sigma, self.colour, &format!("{:.4} after {h:.2} h", m.value)))
            }
        }
    }
}

/// Returns the time of a shot, hours since the first series; if no time is known, by its position among the shots.
fn shot_hour(series: &SeriesData, summary: &SeriesSummary, image: &str) -> f64 {
    let place = series.shots.iter().position(|s| s.image.as_deref() == Some(image));
    let Some(place) = place else { return summary.hour };
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
    height: f64,
    tracks: &[TimeTrack],
) -> Markup {
    let drawn: Vec<_> = tracks.iter().map(|t| (t, t.means(series, summaries), t.shots(series, summaries))).collect();
    let ends = |(_, m): &(f64, Mean)| [m.value - m.sigma.unwrap_or(0.0), m.value + m.sigma.unwrap_or(0.0)];
    let means = || drawn.iter().flat_map(|d| d.1.iter());
    let shots = || drawn.iter().flat_map(|d| d.2.iter());
    let hours = means().map(|m| m.0).chain(shots().map(|s| s.0));
    let plot = Plot {
        area: [LEFT, 12.0, WIDTH - LEFT - NAMES_WIDTH, height],
        x: Axis::from_hours(hours, series.first().and_then(|s| s.begun.as_ref()).map(|b| b.utc)),
        y: Axis::from_values(means().flat_map(ends).chain(shots().map(|s| s.1)), label),
    };
    let content = html! {
        (plot.frame())
        @for (track, means, shots) in &drawn { (track.draw(&plot, means, shots)) }
        (draw_key(tracks))
    };
    let chart = Chart {
        name: name.to_owned(),
        height: height + 60.0,
        x: HorizontalAxis::from_start_time(series.first().and_then(|s| s.begun.as_ref()).map(|b| b.utc)),
        y: VerticalAxis { label: label.to_owned(), zero: false },
        tracks: drawn.iter().flat_map(|(t, means, shots)| t.traces(summaries, means, shots)).collect(),
    };
    html! { (svg_drawing(WIDTH, height + 60.0, name, &content)) (chart.to_script(None)) }
}

fn draw_key(tracks: &[TimeTrack]) -> Markup {
    let x = WIDTH - NAMES_WIDTH + 14.0;
    html! {
        @for (i, t) in tracks.iter().enumerate() {
            @let y = 24.0 + 20.0 * i as f64;
            @let dash = t.dashed.then_some("5 4");
            line.curve x1=(px(x)) y1=(px(y)) x2=(px(x + 22.0)) y2=(px(y)) stroke=(t.colour) stroke-dasharray=[dash] {}
            text.name x=(px(x + 28.0)) y=(px(y + 4.0)) fill=(t.colour) { (t.name) }
        }
        @let y = 24.0 + 20.0 * tracks.len() as f64;
        circle.shot cx=(px(x + 11.0)) cy=(px(y)) r="2" stroke="#555" {}
        text.name x=(px(x + 28.0)) y=(px(y + 4.0)) fill="#555" { "single frames" }
        rect.band x=(px(x)) y=(px(y + 13.0)) width="22" height="12" fill="#555" {}
        text.name x=(px(x + 28.0)) y=(px(y + 24.0)) fill="#555" { "1 sigma of one frame" }
    }
}
