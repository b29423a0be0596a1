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

use super::number::{NONE, fixed, rounded};
use super::source::OF_PICTURES;
use super::summary::{Mean, SeriesSummary, summaries};
use super::{ReportData, distinct, table};
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
                    footer { "Written by wingd " (env!("CARGO_PKG_VERSION")) ". " (units) }
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
    let main = html! {
        (head(data, &summaries))
        (contents())
        (notes(data))
        (deflection(&summaries, shown))
        (over_time(data, &summaries))
        (aircraft::section(data))
        (tables::series(&summaries))
        (budget::section(data))
        (frames::section(data))
        (orthographic(data, shown))
        (frame(data, shown))
        (tables::solution(shown))
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

/// The record to be looked at first, or the first one with numbers.
fn shown_record(data: &ReportData) -> Option<&ImageRecord> {
    if let Some(first) = data.frames.first().filter(|frame| frame.record.is_solved()) {
        return Some(&first.record);
    }
    data.series.iter().flat_map(|s| &s.records).find(|r| r.is_solved())
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
    let dates: Vec<_> = data.series.iter().filter_map(|s| s.begun.as_ref()).map(|s| s.utc).collect();
    let period = match (dates.iter().min(), dates.iter().max()) {
        (Some(a), Some(b)) => {
            format!("{} to {} UTC", a.strftime("%Y-%m-%d %H:%M"), b.strftime("%Y-%m-%d %H:%M"))
        }
        _ => "times unknown".to_owned(),
    };
    html! {
        header {
            h1 { "Wing deflection in flight" }
            p.sub { (title(data)) " | " (period) }
        }
        (tiles(summaries))
    }
}

fn tiles(summaries: &[SeriesSummary]) -> Markup {
    let lifts: Vec<_> = summaries.iter().filter_map(|s| s.tip_lift_m).collect();
    let with_lift = summaries.iter().filter_map(|s| Some((s, s.greatest.as_ref()?)));
    let largest = with_lift.max_by(|a, b| a.1.lift_m.total_cmp(&b.1.lift_m));
    let (lift, sigma) = rounded(largest.map(|l| l.1.lift_m), largest.and_then(|l| l.1.sigma_m), 3);
    let at = largest.map_or(String::new(), |(s, one)| {
        format!("; {} of series {}, begun {} UTC", one.image, s.name, s.begun_text())
    });
    let words = summaries.first().map(|s| s.reference).unwrap_or_default().words();
    // What both series share (survey, mounting) cancels, so the root of the squares is the most it can be.
    let ends = lifts.first().zip(lifts.last()).filter(|_| lifts.len() > 1);
    let both = ends.and_then(|(a, b)| Some(a.sigma?.hypot(b.sigma?)));
    let (change, sigma_change) = rounded(ends.map(|(a, b)| b.value - a.value), both, 3);
    let scatter = |mean: &Mean| table::scatter(Some(*mean));
    let scatters = ends.map_or(String::new(), |(a, b)| {
        format!("; single frames scatter by {} and {} m about these means", scatter(a), scatter(b))
    });
    let sum = |f: fn(&SeriesSummary) -> usize| summaries.iter().map(f).sum::<usize>();
    let (frames, solved) = (sum(|s| s.shots), sum(|s| s.solved));
    let (passed, made) = (sum(|s| s.tests_passed), sum(|s| s.tests_made));
    html! {
        div.tiles {
            div.tile { b { (lift) @if sigma != NONE { " ± " (sigma) } " m" } span { "greatest tip lift of a single frame ± 1 sigma, " (words) (at) } }
            div.tile { b { (change) @if sigma_change != NONE { " ± " (sigma_change) } " m" } span { "change of the mean tip lift from the first to the last series ± 1 sigma at most" (scatters) } }
            div.tile.warn[solved < frames] { b { (solved) " of " (frames) } span { "frames solved, in " (summaries.len()) " series" } }
            div.tile.warn[passed < made] { b { (passed) " of " (made) } span { "global tests passed" } }
        }
    }
}

fn contents() -> Markup {
    let parts = [
        ("deflection", "Deflection along the span"),
        ("time", "Lift and torsion over time"),
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
            p.caption { "Mean curve of every series, vertical lift of the bending axis against the survey. Band: 1 sigma of one frame (survey and mount are common to all frames of a series, so it does not shrink with their number); where it is narrower than the line, see the next figure." }
            @if let Some(text) = shown.and_then(marker_and_axis) { p.caption { (text) } }
        }
        figure {
            (figures::uncertainty(summaries))
            p.caption { "Standard deviation of the lift in the figure above." }
        }
        @if let Some(twist) = figures::twist(summaries) {
            figure {
                (twist)
                p.caption { "Rotation of the sections, free of bending, with 1-sigma bands." }
            }
        }
    }
}

/// A marker's lift is not the bending axis's where the section turns: said with numbers where they differ.
fn marker_and_axis(record: &ImageRecord) -> Option<String> {
    let tip = record.tip.as_ref()?;
    let axis = record.curve.last()?;
    let differ = (tip.lift_m - axis.lift_m).abs() > 3.0 * tip.sigma_lift_m.unwrap_or(0.0).max(0.001);
    differ.then(|| {
        format!(
            "In {}, marker {} lifts by {} m against the survey and the bending axis, at the end of its curve, by {} m: a marker \
             before or behind the axis also moves by the section's twist, and the curve may end at another span.",
            record.image,
            tip.marker,
            fixed(Some(tip.lift_m), 3),
            fixed(Some(axis.lift_m), 3)
        )
    })
}

fn over_time(data: &ReportData, summaries: &[SeriesSummary]) -> Markup {
    if summaries.iter().all(|s| s.solved == 0) {
        return html! { h2 id="time" { "Lift and torsion over time" } p { "No frame has been solved." } };
    }
    let pairs = distinct(summaries.iter().flat_map(|s| &s.torsion).map(|pair| pair.name.as_str()));
    html! {
        h2 id="time" { "Lift and torsion over time" }
        figure {
            (figures::tip_lift(&data.series, summaries))
            p.caption { "Lift of the outermost marker " (summaries.first().map(|s| s.reference).unwrap_or_default().words()) ": single frames (circles), means of the series with 1 sigma of one frame." }
        }
        @for pair in pairs {
            figure {
                (figures::torsion(&data.series, summaries, pair))
                p.caption { "Pair '" (pair) "'. Torsion from the two lifts alone contains bending where the two markers do not share a spanwise station; twist is the adjusted rotation of the section." }
            }
        }
    }
}

fn orthographic(data: &ReportData, shown: Option<&ImageRecord>) -> Markup {
    let views = shown.and_then(|r| Some((r, views::views(r, data.site.as_ref())?)));
    html! {
        h2 id="views" { "Positions in three views" }
        @if let Some((record, views)) = views {
            figure {
                (views.drawing)
                p.caption {
                    (record.image) ", true scale. "
                    @if views.surveyed { "Wing frame: origin in the camera's projection centre, X outboard, Y up, Z = X x Y." }
                    @else { "Without the installation (option --installation): axes along the row of markers, ground as flight less lift, no camera." }
                }
            }
        } @else { p { "No frame has positions." } }
    }
}

fn frame(data: &ReportData, shown: Option<&ImageRecord>) -> Markup {
    html! {
        h2 id="frame" { "A frame and its markers" }
        @if data.pictures.is_empty() { p { "No frame is at hand." } }
        @for p in &data.pictures {
            @let record = data.frames.iter().find(|f| f.series == p.series && f.record.image == p.image).map(|f| &f.record);
            div.picture data-frame={ (p.series) "/" (p.image) } { (picture::picture(p, record)) }
        }
        @if let Some(record) = shown {
            h3 { "Markers of " (record.image) }
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
