//! The report is one page that opens offline and prints well.

mod aircraft;
mod axis;
mod budget;
mod chart;
mod figures;
mod flights;
mod frames;
pub mod picture;
pub(in crate::report) mod plot;
mod tables;
mod views;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::number::{NONE, count, decimals_for, fixed, rounded};
use super::source::OF_PICTURES;
use super::summary::{Mean, SeriesSummary, summaries};
use super::{ReportData, SeriesData, distinct, table};
use crate::record::ImageRecord;

pub use flights::flights;
pub use plot::round_step;

/// The look of the report.
const STYLE: &str = include_str!("style.css");
/// What makes its figures answer. It calls nothing, and the page is whole without it.
pub const SCRIPT: &str = concat!(
    include_str!("script/base.js"),
    include_str!("script/chart.js"),
    include_str!("script/wing.js"),
    include_str!("script/frames.js"),
    include_str!("script/start.js")
);

/// A page that stands alone: `units` says in what it counts.
pub fn document(title: &str, main: &Markup, units: &str) -> String {
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                main {
                    (main)
                    footer { "Written by wingd " (env!("CARGO_PKG_VERSION")) ". " (units) span.printed { " Tables that are folded on the screen are not printed." } }
                }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    };
    markup.into_string()
}

/// The whole page. Nothing in it comes from outside the file.
pub fn page(data: &ReportData) -> String {
    let summaries = summaries(&data.series);
    let shown = shown_record(data);
    let named = shown.map(|(series, record)| (name(data, series, record), record));
    let main = html! {
        (head(data, &summaries))
        (contents())
        (notes(data))
        (deflection(&summaries, shown.map(|(_, record)| record)))
        (over_time(data, &summaries))
        (aircraft::section(data))
        (tables::series(&summaries))
        (budget::section(data))
        (frames::section(data))
        (orthographic(data, named.clone()))
        (frame(data, named.clone()))
        (tables::solution(named))
        (tables::quality(data))
        (tables::results(data))
        (tables::provenance(data))
    };
    document(
        &format!("Wing deflection: {}", title(data)),
        &main,
        "Lengths in metres, angles in degrees, image coordinates in pixels; sigma is one standard deviation.",
    )
}

/// The record to be looked at first, or the first one with numbers, with its series.
fn shown_record(data: &ReportData) -> Option<(&str, &ImageRecord)> {
    let ranked = data.frames.iter().map(|frame| (frame.series.as_str(), &frame.record)).take(1);
    let all = data.series.iter().flat_map(|s| s.records.iter().map(|r| (s.name.as_str(), r)));
    ranked.chain(all).find(|(_, record)| record.is_solved())
}

/// A frame's name in the report: where there are several series, with its own.
fn name(data: &ReportData, series: &str, record: &ImageRecord) -> String {
    if data.series.len() < 2 { record.image.clone() } else { format!("{series}/{}", record.image) }
}

fn title(data: &ReportData) -> String {
    let mut flights: Vec<&str> = data.series.iter().map(|s| s.flight.as_str()).collect();
    flights.dedup();
    let flights = match flights.as_slice() {
        [] => "empty store".to_owned(),
        [OF_PICTURES] => OF_PICTURES.to_owned(),
        [one] => format!("flight {one}"),
        [first, .., last] => format!("flights {first} to {last}"),
    };
    data.site.as_ref().map_or(flights.clone(), |s| format!("{}, {flights}", s.name))
}

fn head(data: &ReportData, summaries: &[SeriesSummary]) -> Markup {
    html! {
        header {
            h1 { "Wing deflection in flight" }
            p.sub { (title(data)) " | " (period(data)) }
        }
        (tiles(summaries))
    }
}

fn tiles(summaries: &[SeriesSummary]) -> Markup {
    let sum = |f: fn(&SeriesSummary) -> usize| summaries.iter().map(f).sum::<usize>();
    let (frames, solved) = (sum(|s| s.shots), sum(|s| s.solved));
    let (passed, made) = (sum(|s| s.tests_passed), sum(|s| s.tests_made));
    html! {
        div.tiles {
            (greatest(summaries))
            (change(summaries))
            div.tile.warn[solved < frames] { b { (solved) " of " (frames) } span { "frames solved, in " (summaries.len()) " series" } }
            div.tile.warn[passed < made] { b { (passed) " of " (made) } span { "global tests passed" } }
        }
    }
}

/// The greatest deflection of a single frame; nothing where no frame has one.
fn greatest(summaries: &[SeriesSummary]) -> Markup {
    let with_deflection = summaries.iter().filter_map(|s| Some((s, s.greatest.as_ref()?)));
    let Some((s, one)) = with_deflection.max_by(|a, b| a.1.deflection_m.total_cmp(&b.1.deflection_m)) else {
        return html! {};
    };
    let (deflection, sigma) = rounded(Some(one.deflection_m), one.sigma_m, 3);
    html! {
        div.tile {
            b { (deflection) @if sigma != NONE { " ± " (sigma) } " m" }
            span { "greatest tip deflection of a single frame ± 1 sigma, " (s.reference.words()) "; " (one.image) " of series " (s.name) @if s.begun.is_some() { ", begun " (s.begun_text()) " UTC" } }
        }
    }
}

/// From the first series with a deflection to the last one; of one series its mean, with the scatter that the mean hides.
fn change(summaries: &[SeriesSummary]) -> Markup {
    let means: Vec<_> = summaries.iter().filter_map(|s| Some((s, s.tip_deflection_m?))).collect();
    let scatter = |mean: Mean| table::scatter(Some(mean));
    match means.as_slice() {
        [(_, mean)] if mean.count > 1 => html! {
            div.tile { b { (fixed(Some(mean.value), 3)) " m" } span { "mean tip deflection of " (mean.count) " frames, which scatter by " (scatter(*mean)) " m about it" } }
        },
        [(first, a), .., (last, b)] => {
            // What both series share (survey, mounting) cancels, so the root of the squares is the most it can be.
            let both = a.sigma.zip(b.sigma).map(|(a, b)| a.hypot(b));
            let (change, sigma) = rounded(Some(b.value - a.value), both, 3);
            let scattered = a.scatter.or(b.scatter).is_some();
            html! {
                div.tile {
                    b { (change) @if sigma != NONE { " ± " (sigma) } " m" }
                    span {
                        "change of the mean tip deflection from series " (first.name) " to " (last.name) " ± 1 sigma at most"
                        @if scattered { "; single frames scatter by " (scatter(*a)) " and " (scatter(*b)) " m about these means" }
                    }
                }
            }
        }
        _ => html! {},
    }
}

/// From the first shot to the last one.
fn period(data: &ReportData) -> String {
    let of = |s: &SeriesData| {
        let shots = s.shots.iter().filter(|_| s.begun.is_some()).filter_map(|shot| shot.stamp.as_ref());
        s.begun.iter().chain(shots).map(|s| s.utc).collect::<Vec<_>>()
    };
    let times: Vec<_> = data.series.iter().flat_map(of).collect();
    let Some((first, last)) = times.iter().min().zip(times.iter().max()) else {
        return "times unknown".to_owned();
    };
    let text = |format: &str| (first.strftime(format).to_string(), last.strftime(format).to_string());
    let ((day, last_day), (clock, last_clock)) = (text("%Y-%m-%d"), text("%H:%M"));
    match (day == last_day, clock == last_clock) {
        (true, true) => format!("{day} {clock} UTC"),
        (true, false) => format!("{day} {clock} to {last_clock} UTC"),
        (false, _) => format!("{day} {clock} to {last_day} {last_clock} UTC"),
    }
}

fn contents() -> Markup {
    let parts = [
        ("deflection", "Deflection along the span"),
        ("time", "Deflection and torsion over time"),
        ("series", "Series"),
        ("budget", "What the uncertainty comes from"),
        ("every", "Every frame"),
        ("views", "Positions"),
        ("frame", "A frame and its markers"),
        ("quality", "Quality"),
        ("results", "Results"),
        ("provenance", "Provenance"),
    ];
    html! { nav aria-label="Contents" { @for (id, text) in parts { a href={ "#" (id) } { (text) } " " } } }
}

fn notes(data: &ReportData) -> Markup {
    html! {
        @if data.series.is_empty() {
            p.warning { "The store holds no series yet." }
        } @else if !data.series.iter().flat_map(|s| &s.records).any(ImageRecord::is_solved) {
            p.warning { "No frame has been solved; the reasons stand under Quality." }
        }
        @for note in data.warnings.iter().chain(&data.notes) { p.warning { (note) } }
    }
}

fn deflection(summaries: &[SeriesSummary], shown: Option<&ImageRecord>) -> Markup {
    if summaries.iter().all(|s| s.curve.is_empty()) {
        return html! { h2 id="deflection" { "Deflection along the span" } p { "No frame has a deflection curve." } };
    }
    html! {
        h2 id="deflection" { "Deflection along the span" }
        figure {
            (figures::deflection(summaries))
            p.caption { "Mean curve of every series, vertical deflection of the bending axis against the survey. Band: 1 sigma of one frame (survey and mount are common to all frames of a series, so it does not shrink with their number); where it is narrower than the line, see the next figure." }
            @if let Some(text) = scattered(summaries) { p.caption { (text) } }
            @if let Some(text) = shown.and_then(marker_and_axis) { p.caption { (text) } }
        }
        figure {
            (figures::uncertainty(summaries))
            p.caption { "Standard deviation of the deflection in the figure above." }
        }
        @if let Some(twist) = figures::twist(summaries) {
            figure {
                (twist)
                p.caption { "Rotation of the sections, free of bending, with 1-sigma bands." }
            }
        }
    }
}

/// Series whose frames differ by more than the band of their mean curve says.
fn scattered(summaries: &[SeriesSummary]) -> Option<String> {
    let beyond = |mean: Mean| mean.scatter.filter(|scatter| mean.sigma.is_some_and(|sigma| *scatter > sigma));
    let wide: Vec<_> = summaries.iter().filter_map(|s| Some((s, beyond(s.tip_deflection_m?)?))).collect();
    let largest = wide.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(format!(
        "Single frames of {} scatter about their mean by more than its band says, at the tip by up to {} m (series {}): each \
         frame's own curve stands under \"Every frame\".",
        count(wide.len(), "series"),
        fixed(Some(largest.1), decimals_for(largest.1)),
        largest.0.name
    ))
}

/// A marker's deflection is not the bending axis's where the section turns: said with numbers where they differ.
fn marker_and_axis(record: &ImageRecord) -> Option<String> {
    let tip = record.tip.as_ref()?;
    let axis = record.curve.last()?;
    let differ =
        (tip.deflection_m - axis.deflection_m).abs() > 3.0 * tip.sigma_deflection_m.unwrap_or(0.0).max(0.001);
    differ.then(|| {
        format!(
            "In {}, marker {} moves up by {} m against the survey and the bending axis, at the end of its curve, by {} m: a marker \
             before or behind the axis also moves by the section's twist, and the curve may end at another span.",
            record.image,
            tip.marker,
            fixed(Some(tip.deflection_m), 3),
            fixed(Some(axis.deflection_m), 3)
        )
    })
}

fn over_time(data: &ReportData, summaries: &[SeriesSummary]) -> Markup {
    if summaries.iter().all(|s| s.solved == 0) {
        return html! { h2 id="time" { "Deflection and torsion over time" } p { "No frame has been solved." } };
    }
    let pairs = distinct(summaries.iter().flat_map(|s| &s.torsion).map(|pair| pair.name.as_str()));
    html! {
        h2 id="time" { "Deflection and torsion over time" }
        figure {
            (figures::tip_deflection(&data.series, summaries))
            p.caption { "Deflection of the outermost marker " (summaries.first().map(|s| s.reference).unwrap_or_default().words()) ": single frames (circles), means of the series with 1 sigma of one frame." }
        }
        @for pair in pairs {
            figure {
                (figures::torsion(&data.series, summaries, pair))
                p.caption { "Pair '" (pair) "'. Torsion from the two deflections alone contains bending where the two markers do not share a spanwise station; twist is the adjusted rotation of the section." }
            }
        }
    }
}

fn orthographic(data: &ReportData, shown: Option<(String, &ImageRecord)>) -> Markup {
    let views = shown.and_then(|(name, r)| Some((name, views::views(r, data.site.as_ref())?)));
    html! {
        h2 id="views" { "Positions in three views" }
        @if let Some((name, views)) = views {
            figure {
                (views.drawing)
                p.caption {
                    (name) ", true scale. "
                    @if views.surveyed { "Wing frame: origin in the camera's projection centre, X outboard, Y up, Z = X x Y." }
                    @else { "Without the installation (option --installation): axes along the row of markers, ground as flight less deflection, no camera." }
                }
            }
        } @else { p { "No frame has positions." } }
    }
}

fn frame(data: &ReportData, shown: Option<(String, &ImageRecord)>) -> Markup {
    html! {
        h2 id="frame" { "A frame and its markers" }
        @if data.pictures.is_empty() { p { "No frame is at hand." } }
        @for p in &data.pictures {
            @let record = data.frames.iter().find(|f| f.series == p.series && f.record.image == p.image).map(|f| &f.record);
            div.picture data-frame={ (p.series) "/" (p.image) } { (picture::picture(p, record)) }
        }
        @if let Some((name, record)) = shown {
            h3 { "Markers of " (name) }
            div.scroll { (table::markers(record).html()) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::sample;
    use super::*;

    fn data() -> ReportData {
        let mut series = sample::series("s000001", 0, &[2.93, 2.95]);
        series.records[0].image = "<b>&\"x.jpg".to_owned();
        ReportData { series: vec![series, sample::series("s000002", 3600, &[2.5])], ..ReportData::default() }
    }

    #[test]
    fn hostile_names_are_escaped() {
        let html = page(&data());
        assert!(html.contains("&lt;b&gt;&amp;&quot;x.jpg") && !html.contains("<b>&\"x"));
    }

    #[test]
    fn empty_and_failed_stores_give_a_page_without_numbers_out_of_nothing() {
        let failed = super::super::SeriesData {
            records: vec![sample::failed("a.jpg", "too dark; set the exposure")],
            name: "s1".into(),
            ..Default::default()
        };
        for series in [vec![], vec![failed]] {
            let html = page(&ReportData { series, ..ReportData::default() });
            assert!(!html.contains("NaN") && !html.contains("inf") && html.contains("</html>"));
        }
    }
}
