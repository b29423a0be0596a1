//! Report as one page that opens offline and prints well.

mod aircraft;
mod answer;
mod budget;
#[cfg(feature = "boards")]
pub mod calibration;
mod figures;
mod frames;
mod tables;
mod views;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use wingd_base::clock::Stamp;
use wingd_evaluation::number::{count_text, format_fixed};
use wingd_evaluation::record::ImageRecord;
use wingd_evaluation::results::source::PICTURES_FLIGHT;
use wingd_evaluation::results::summary::{SeriesSummary, summarise_series};
use wingd_evaluation::results::{ReportBuilder, ReportData, SeriesData, distinct_values};
use wingd_measure::adjust::DeflectionReference;

pub use wingd_evaluation::figures::plot::{Axis, round_step};

/// Style sheet of the report.
const STYLE: &str = concat!(
    include_str!("../../../evaluation/src/figures/figure.css"),
    include_str!("style.css")
);
/// Script for interactive figures. It makes no requests, and the page is complete without it.
pub const SCRIPT: &str = concat!(
    include_str!("../../../evaluation/src/figures/figure.js"),
    include_str!("script/chart.js"),
    include_str!("script/frames.js"),
    include_str!("script/start.js")
);

/// Builder of reports.
pub const REPORT_BUILDER: ReportBuilder = report_page;

/// Builds a self-contained page; `units` describes its units.
pub fn standalone_page(title: &str, main: &Markup, units: &str) -> String {
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
                    footer { "Written by wingd " (env!("CARGO_PKG_VERSION")) ". " (units) span.printed { " Tables folded on the screen are not printed." } }
                }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    };
    markup.into_string()
}

/// Builds the report, without external resources.
pub fn report_page(data: &ReportData) -> String {
    let summaries = summarise_series(&data.series);
    let main = html! {
        (report_header(data))
        (answer::answer_section(data, &summaries))
        (tables::references_section(data, &summaries))
        (contents_links())
        (deflection_section(data, &summaries))
        (time_section(data, &summaries))
        (aircraft::aircraft_section(data))
        (tables::series_section(&summaries))
        (budget::budget_section(data))
        (frames::frames_section(data, &summaries))
        (tables::quality_section(data))
        (tables::results_section(data))
        (tables::provenance_section(data))
    };
    standalone_page(
        &format!("Wing deflection: {}", report_title(data)),
        &main,
        "Lengths in metres, angles in degrees, image coordinates in pixels; sigma is one standard deviation.",
    )
}

fn report_title(data: &ReportData) -> String {
    let mut flights: Vec<&str> = data.series.iter().map(|s| s.flight.as_str()).collect();
    flights.dedup();
    let flights = match flights.as_slice() {
        [] => "empty store".to_owned(),
        [PICTURES_FLIGHT] => PICTURES_FLIGHT.to_owned(),
        [one] => format!("flight {one}"),
        [first, .., last] => format!("flights {first} to {last}"),
    };
    data.site
        .as_ref()
        .map_or(flights.clone(), |s| format!("{}, {flights}", s.name))
}

fn report_header(data: &ReportData) -> Markup {
    html! {
        header {
            h1 { "Wing deflection in flight" }
            p.sub { (report_title(data)) " | " (recording_period(data)) }
            @for (name, value) in &data.fields { p.sub { (name) ": " b { (value) } } }
            @if !data.other_flights.is_empty() {
                p.sub { "Other flights of the store: " (data.other_flights.join(", ")) ". " code { "wingd report STORE --flight NAME" } " shows one." }
            }
        }
    }
}

/// Formats the period from the first shot to the last one.
fn recording_period(data: &ReportData) -> String {
    let series_times = |s: &SeriesData| {
        let shots = s
            .shots
            .iter()
            .filter(|_| s.begun.is_some())
            .filter_map(|shot| shot.stamp.as_ref());
        s.begun
            .iter()
            .chain(shots)
            .filter_map(Stamp::known_utc)
            .collect::<Vec<_>>()
    };
    let times: Vec<_> = data.series.iter().flat_map(series_times).collect();
    let Some((first, last)) = times.iter().min().zip(times.iter().max()) else {
        return "times unknown".to_owned();
    };
    let text = |format: &str| {
        (
            first.strftime(format).to_string(),
            last.strftime(format).to_string(),
        )
    };
    let ((day, last_day), (clock, last_clock)) = (text("%Y-%m-%d"), text("%H:%M"));
    match (day == last_day, clock == last_clock) {
        (true, true) => format!("{day} {clock} UTC"),
        (true, false) => format!("{day} {clock} to {last_clock} UTC"),
        (false, _) => format!("{day} {clock} to {last_day} {last_clock} UTC"),
    }
}

fn contents_links() -> Markup {
    let parts = [
        ("deflection", "Deflection along the span"),
        ("time", "Deflection and torsion over time"),
        ("series", "Series"),
        ("budget", "Uncertainty budget"),
        ("frame", "A frame and its markers"),
        ("quality", "Quality"),
        ("results", "Results"),
        ("provenance", "Provenance"),
    ];
    html! { nav aria-label="Contents" { @for (id, text) in parts { a href={ "#" (id) } { (text) } " " } } }
}

fn deflection_section(data: &ReportData, summaries: &[SeriesSummary]) -> Markup {
    if summaries.iter().all(|s| s.curve.is_empty()) {
        return html! { h2 id="deflection" { "Deflection along the span" } p { "No frame has a deflection curve." } };
    }
    let curves = figures::series_curves(data, summaries);
    let reference = summaries.first().map(|s| s.reference).unwrap_or_default();
    html! {
        h2 id="deflection" { "Deflection along the span" }
        figure {
            (figures::draw_deflection(&curves, reference))
            p.caption {
                "Vertical deflection of the bending axis " (reference.description()) ", mean of a series whose frames agree within the band. Band: 1 sigma of one frame; errors of survey and mounting are common to all frames, so it does not decrease with their number. If the band is narrower than the line, see the next figure."
                @for curve in curves.iter().filter(|c| c.frames.len() > 1) {
                    " " (curve.name) ": " (curve.frames.len()) " of " (count_text(curve.solved, "frame")) " singly, because frames scatter by more than the band."
                }
            }
            @if let Some(text) = data.frames.first().and_then(|frame| marker_and_axis_note(&frame.record, reference)) { p.caption { (text) } }
        }
        figure {
            (figures::draw_uncertainty(&curves, reference))
            p.caption { "Standard deviation of the deflection in the figure above." }
        }
        @if let Some(twist) = figures::draw_twist(&curves) {
            figure {
                (twist)
                p.caption { "Rotation of the sections relative to the survey, free of bending, with 1-sigma bands." }
            }
        }
        @if let Some(streamwise) = figures::draw_streamwise_twist(&curves) {
            figure {
                (streamwise)
                p.caption { "Change of the angle of attack in the vertical plane of the flow, with 1-sigma bands: twist and, on a swept wing, bending." }
            }
        }
    }
}

/// Explains with numbers a difference between the deflections of the tip marker and of the bending axis, due to twist;
/// `None` if they agree.
fn marker_and_axis_note(record: &ImageRecord, reference: DeflectionReference) -> Option<String> {
    let tip = record.tip.as_ref()?;
    let (of_tip_m, sigma_m) = tip.deflection(reference)?;
    let (of_axis_m, _) = record.curve.last()?.deflection(reference)?;
    let differ = (of_tip_m - of_axis_m).abs() > 3.0 * sigma_m.unwrap_or(0.0).max(0.001);
    differ.then(|| {
        format!(
            "In {}, the deflection of marker {} is {} m; that of the bending axis, at the end of its curve, is {} m. \
             The twist also displaces a marker in front of or behind the axis, and the curve may end at a different span.",
            record.image,
            tip.marker,
            format_fixed(Some(of_tip_m), 3),
            format_fixed(Some(of_axis_m), 3)
        )
    })
}

fn time_section(data: &ReportData, summaries: &[SeriesSummary]) -> Markup {
    if summaries.iter().all(|s| s.solved == 0) {
        return html! { h2 id="time" { "Deflection and torsion over time" } p { "No frame has been solved." } };
    }
    let pairs = distinct_values(
        summaries
            .iter()
            .flat_map(|s| &s.torsion)
            .map(|pair| pair.name.as_str()),
    );
    html! {
        h2 id="time" { "Deflection and torsion over time" }
        figure {
            (figures::draw_tip_deflection(&data.series, summaries))
            p.caption { "Deflection of the outermost marker " (summaries.first().map(|s| s.reference).unwrap_or_default().description()) ". Large dots: means of the series with 1 sigma of one frame. Small dots: single frames." }
        }
        @for pair in pairs {
            figure {
                (figures::draw_torsion(&data.series, summaries, pair))
                p.caption { "Pair '" (pair) "'. Twist is the adjusted rotation of the section. Torsion computed from the two deflections, hidden at first, includes bending if the markers are at different spanwise stations." }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wingd_evaluation::results::sample;

    fn data() -> ReportData {
        let mut series = sample::series("s000001", 0, &[2.93, 2.95]);
        series.records[0].image = "<b>&\"x.jpg".to_owned();
        ReportData {
            series: vec![series, sample::series("s000002", 3600, &[2.5])],
            ..ReportData::default()
        }
    }

    #[test]
    fn hostile_names_are_escaped() {
        let html = report_page(&data());
        assert!(html.contains("&lt;b&gt;&amp;&quot;x.jpg") && !html.contains("<b>&\"x"));
    }

    #[test]
    fn empty_and_failed_stores_give_a_page_without_invalid_numbers() {
        let failed = wingd_evaluation::results::SeriesData {
            records: vec![sample::failed("a.jpg", "too dark; set the exposure")],
            name: "s1".into(),
            ..Default::default()
        };
        for series in [vec![], vec![failed]] {
            let html = report_page(&ReportData {
                series,
                ..ReportData::default()
            });
            assert!(!html.contains("NaN") && !html.contains("inf") && html.contains("</html>"));
        }
    }
}
