//! Sections of the report with tables: series, solution, quality and provenance.

use maud::{Markup, html};
use serde_json::Value;

use wingd_base::clock::Stamp;
use wingd_evaluation::grid::ColumnDefinition::{One, Pair};
use wingd_evaluation::grid::Grid;
use wingd_evaluation::number;
use wingd_evaluation::number::{NONE, count_text, format_fixed};
use wingd_evaluation::record::{Provenance, json_fields, json_text, variant_name};
use wingd_evaluation::results::summary::{Mean, SeriesSummary};
use wingd_evaluation::results::{ReportData, SeriesData, ShotData, summary, table};
use wingd_measure::adjust::DeflectionReference;

/// Returns the section of the series means.
pub fn series_section(summaries: &[SeriesSummary]) -> Markup {
    html! {
        h2 id="series" { "Series" }
        @let reference = summaries.first().map(|s| s.reference).unwrap_or_default();
        (name_reference(table::series_table(summaries), reference).html())
        p.caption { "Mean over the solved frames of a series, deflections of the tip marker. sigma: standard deviation of one frame from the adjustment; scatter: standard deviation of single frames about the mean of the series. Torsion and twist: first pair of the installation." }
    }
}

/// Maximum number of series whose results are unfolded.
const MAX_OPEN_SERIES: usize = 12;

/// Returns the section of the results of every frame.
pub fn results_section(data: &ReportData) -> Markup {
    html! {
        h2 id="results" { "Results of every frame" }
        @if data.series.iter().all(|s| s.records.is_empty()) { p { "There are no results." } }
        @let many = data.series.len() > MAX_OPEN_SERIES;
        @let reference = summary::common_reference(&data.series);
        div {
            @for s in data.series.iter().filter(|s| !s.records.is_empty()) {
                details open[!many] {
                    summary { "Series " (s.flight) "/" (s.name) @if s.interrupted { " (interrupted)" } }
                    @let rows = table::image_table(&s.records, &s.counts, reference);
                    (name_reference(rows, reference).html())
                }
            }
        }
    }
}

/// Names the reference in the headings of deflections.
fn name_reference(mut grid: Grid, reference: DeflectionReference) -> Grid {
    let named = format!("deflection {} / m", reference.description());
    for column in &mut grid.columns {
        column.title = column.title.replace("deflection / m", &named);
    }
    grid
}

/// Returns the mean deflection of each series relative to each reference, folded.
pub fn references_section(data: &ReportData, summaries: &[SeriesSummary]) -> Markup {
    let Some(shown) = summaries.iter().find(|s| s.solved > 0).map(|s| s.reference) else {
        return html! {};
    };
    let rows = data.series.iter().flat_map(|s| {
        let mean = move |reference| {
            let tips = summary::solved_records(s).into_iter();
            let tips = tips.filter_map(|r| r.tip.as_ref()?.deflection(reference));
            Mean::from_values(&tips.collect::<Vec<_>>()).map(|mean| (s, reference, mean))
        };
        DeflectionReference::ALL.into_iter().filter_map(mean)
    });
    let rows: Vec<_> = rows.collect();
    let grid = Grid::for_rows(&rows).columns(&[
        One("<series", &|(s, ..)| s.name.clone()),
        One("<reference", &|(_, reference, _)| {
            reference.description().to_owned()
        }),
        Pair("mean tip deflection / m", "sigma / m", &|(.., mean)| {
            number::format_rounded(Some(mean.value), mean.sigma, 3)
        }),
        One("<on this page", &|(_, reference, _)| {
            if *reference == shown { "yes" } else { "" }.to_owned()
        }),
    ]);
    html! {
        details {
            summary { "All deflections of this page are " (shown.description()) "; the other references" }
            (grid.html())
        }
    }
}

fn value_text(value: &Value) -> String {
    if value.is_null() {
        NONE.to_owned()
    } else {
        json_text(value)
    }
}

/// Returns the section on the accuracy of the exposure times.
fn exposure_section(data: &ReportData) -> Markup {
    let exposures: Vec<_> = data
        .series
        .iter()
        .flat_map(|s| &s.shots)
        .filter_map(|shot| shot.exposure.as_ref())
        .collect();
    let largest = |values: Vec<f64>| values.into_iter().fold(0.0, f64::max);
    let own_ms = 1e3 * largest(exposures.iter().map(|e| e.exposure_sigma_s).collect());
    let clock: Vec<f64> = exposures.iter().filter_map(|e| e.clock_sigma_s).collect();
    let mut sources: Vec<String> = exposures
        .iter()
        .map(|e| variant_name(e.exposure_source).replace('_', " "))
        .collect();
    sources.sort_unstable();
    sources.dedup();
    html! {
        @if !exposures.is_empty() {
            h3 { "Exposure times" }
            p {
                (count_text(exposures.len(), "frame")) ", timed by " (sources.join(", ")) ": standard deviation relative to the recorder's clock at most "
                (format_fixed(Some(own_ms), 1)) " ms. "
                @if clock.is_empty() { "The offset of that clock from UTC is unknown." }
                @else { "Standard deviation of that clock relative to UTC, if synchronised (" (clock.len()) " frames): at most " (format_fixed(Some(1e3 * largest(clock.clone())), 1)) " ms." }
            }
        }
    }
}

/// Returns the section on tests, unused markers and failures of the camera.
pub fn quality_section(data: &ReportData) -> Markup {
    let records = || {
        data.series
            .iter()
            .flat_map(|s| s.records.iter().map(move |r| (s, r)))
    };
    let unused = table::unused_markers(records().map(|(s, r)| (format!("{}/", s.name), r)));
    html! {
        h2 id="quality" { "Quality" }
        p {
            "A passed global test says that the residuals are consistent with the model and the specified standard deviations. "
            "It cannot rule out errors that leave no residuals, such as a wrong root, axis, lens or window. "
            "Their specified uncertainties are in the " a href="#budget" { "uncertainty budget" } ". "
            "Unless configured otherwise, standard deviations are a posteriori where the test rejects."
        }
        @if let Some(cad) = records().filter_map(|(_, r)| r.quality.cad.as_ref()).next_back() {
            p { "CAD frame: " (cad.describe()) "." }
        }
        @if unused.rows.is_empty() { p { "Every marker of the survey was used in every solved frame." } } @else {
            details { summary { "Markers not used" } (unused.html()) }
        }
        (exposure_section(data))
        @let camera = camera_failures(data);
        @if !camera.rows.is_empty() {
            h3 { "Camera failures" }
            (camera.html())
        }
    }
}

fn camera_failures(data: &ReportData) -> Grid {
    let mut grid = Grid::new(&["<series", "shot", "<time (UTC)", "<frame", "<failure"]);
    for s in &data.series {
        for shot in &s.shots {
            for failure in &shot.failures {
                let time = shot_time(s, shot);
                let image = shot.image.clone().unwrap_or_else(|| "none".to_owned());
                grid.push(vec![
                    s.name.clone(),
                    shot.number.to_string(),
                    time,
                    image,
                    failure.clone(),
                ]);
            }
        }
    }
    grid
}

fn shot_time(series: &SeriesData, shot: &ShotData) -> String {
    let text = |s: &Stamp| s.utc.strftime("%Y-%m-%d %H:%M:%S").to_string();
    shot.stamp
        .as_ref()
        .filter(|_| series.begun.is_some())
        .map_or(NONE.to_owned(), text)
}

/// Returns the section of the inputs of the results and the hash of every frame.
pub fn provenance_section(data: &ReportData) -> Markup {
    let mut sets: Vec<(Provenance, usize)> = Vec::new();
    for record in data.series.iter().flat_map(|s| &s.records) {
        let inputs = Provenance {
            frame_sha256: None,
            ..record.provenance.clone()
        };
        match sets.iter_mut().find(|known| known.0 == inputs) {
            Some(known) => known.1 += 1,
            None => sets.push((inputs, 1)),
        }
    }
    html! {
        h2 id="provenance" { "Provenance" }
        @if sets.is_empty() { p { "There are no results." } }
        @for (set, count) in &sets {
            h3 { "Inputs of " (number::count_text(*count, "result")) }
            (input_table(set).html())
        }
        @let frames = frame_hashes(data);
        @if !frames.rows.is_empty() {
            details {
                summary { "Frames, SHA-256" }
                div.hashes { (frames.html()) }
            }
        }
    }
}

fn input_table(set: &Provenance) -> Grid {
    let mut grid = Grid::new(&["<input", "<value"]);
    for (key, value) in &json_fields(set) {
        match value {
            Value::Object(inner) => {
                for (name, value) in inner {
                    grid.push(vec![format!("{key}, {name}"), value_text(value)]);
                }
            }
            other => grid.push(vec![key.clone(), value_text(other)]),
        }
    }
    grid
}

fn frame_hashes(data: &ReportData) -> Grid {
    let mut grid = Grid::new(&[
        "<series",
        "<frame",
        "<original file",
        "<UTC",
        "<SHA-256",
        "solve / ms",
    ]);
    for s in &data.series {
        for shot in &s.shots {
            let Some(image) = &shot.image else { continue };
            let ms = s.record_for_shot(shot).map(|r| r.timing_ms.total());
            grid.push(vec![
                s.name.clone(),
                image.clone(),
                shot.source.clone().unwrap_or_else(|| NONE.to_owned()),
                shot_time(s, shot),
                shot.sha256.clone().unwrap_or_else(|| NONE.to_owned()),
                format_fixed(ms, 0),
            ]);
        }
    }
    grid
}
