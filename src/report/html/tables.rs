//! The report has tables of its series, of a solution, of quality and of provenance.

use maud::{Markup, html};
use serde_json::Value;

use super::super::grid::Grid;
use super::super::number::{self, NONE, count, fields, fixed, general, words};
use super::super::summary::SeriesSummary;
use super::super::{ReportData, SeriesData, ShotData, protocol, summary, table};
use crate::clock::Stamp;
use crate::record::{GlobalTest, ImageRecord, Provenance, Quality};

/// Means of the series.
pub fn series(summaries: &[SeriesSummary]) -> Markup {
    html! {
        h2 id="series" { "Series" }
        div.scroll { (table::series_grid(summaries).html()) }
        p.caption { "Mean over the solved frames of a series, deflections of the tip marker " (summaries.first().map(|s| s.reference).unwrap_or_default().words()) ". sigma: standard deviation of one frame by the adjustment; scatter: standard deviation of single frames against the series' mean. Torsion and twist: first pair of the installation." }
    }
}

/// Series up to which their results stand open.
const OPEN: usize = 12;

/// Every frame's result.
pub fn results(data: &ReportData) -> Markup {
    html! {
        h2 id="results" { "Results of every frame" }
        @if data.series.iter().all(|s| s.records.is_empty()) { p { "There are no results." } }
        @let many = data.series.len() > OPEN;
        @let reference = summary::reference(&data.series);
        p.caption { "Deflections of the tip marker " (reference.words()) "." }
        div.many[many] {
            @for s in data.series.iter().filter(|s| !s.records.is_empty()) {
                details open[!many] {
                    summary { "Series " (s.flight) "/" (s.name) @if s.interrupted { " (interrupted)" } }
                    @let rows = if s.counts.is_empty() { table::images(&s.records, reference) } else { table::images_counted(&s.records, &s.counts, reference) };
                    div.scroll { (rows.html()) }
                }
            }
        }
    }
}

/// Parameters of one solution.
pub fn solution(shown: Option<(String, &ImageRecord)>) -> Markup {
    let Some((name, record)) = shown else { return html! {} };
    let mut grid = Grid::new(&["<parameter", "value", "sigma"]);
    for term in record.model.terms() {
        let name = term.index.map_or(term.name.to_owned(), |k| format!("{} [{}]", term.name, k + 1));
        let of = |value: Option<f64>| value.map_or(NONE.to_owned(), general);
        let measured = term.measured;
        grid.push(vec![name, of(measured.map(|m| m.value)), of(measured.and_then(|m| m.sigma))]);
    }
    let quality = Quality { correlation: None, ..record.quality.clone() };
    for (name, value) in &fields(&quality) {
        parameter(&mut grid, name, value);
    }
    html! {
        @if !grid.rows.is_empty() {
            h3 { "Parameters of " (name) }
            div.scroll { (grid.html()) }
        }
        @if let Some(correlations) = protocol::correlation_grid(record) {
            details {
                summary { "Correlations of the parameters" }
                div.scroll { (correlations.html()) }
            }
        }
    }
}

/// One row per number; of the aircraft's data a value with its sigma in one row.
fn parameter(grid: &mut Grid, name: &str, value: &Value) {
    let number = |v: Option<&Value>| v.and_then(Value::as_f64).map_or(NONE.to_owned(), general);
    match value {
        Value::Object(map) if map.contains_key("value") => {
            grid.push(vec![name.to_owned(), number(map.get("value")), number(map.get("sigma"))]);
        }
        Value::Object(map) => {
            for (key, inner) in map {
                parameter(grid, &format!("{name}, {key}"), inner);
            }
        }
        Value::Array(items) => {
            for (i, inner) in items.iter().enumerate() {
                parameter(grid, &format!("{name} [{}]", i + 1), inner);
            }
        }
        Value::Number(_) => grid.push(vec![name.to_owned(), number(Some(value)), NONE.to_owned()]),
        other => grid.push(vec![name.to_owned(), shown(other), NONE.to_owned()]),
    }
}

fn shown(value: &Value) -> String {
    if value.is_null() { NONE.to_owned() } else { words(value) }
}

/// How well it is known when the frames were exposed.
fn instants(data: &ReportData) -> Markup {
    let exposures: Vec<_> =
        data.series.iter().flat_map(|s| &s.shots).filter_map(|shot| shot.exposure.as_ref()).collect();
    let largest = |values: Vec<f64>| values.into_iter().fold(0.0, f64::max);
    let own_ms = 1e3 * largest(exposures.iter().map(|e| e.exposure_sigma_s).collect());
    let clock: Vec<f64> = exposures.iter().filter_map(|e| e.clock_sigma_s).collect();
    let mut sources: Vec<String> =
        exposures.iter().map(|e| e.exposure_source.name().replace('_', " ")).collect();
    sources.sort_unstable();
    sources.dedup();
    html! {
        @if !exposures.is_empty() {
            h3 { "Instants of exposure" }
            p {
                "Of " (count(exposures.len(), "frame")) ", told by " (sources.join(", ")) ": standard deviation against the recorder's clock at most "
                (fixed(Some(own_ms), 1)) " ms. "
                @if clock.is_empty() { "How far that clock was off UTC is not known." }
                @else { "Of that clock against UTC, where it was synchronised (" (clock.len()) " frames): at most " (fixed(Some(1e3 * largest(clock.clone())), 1)) " ms." }
            }
        }
    }
}

/// What was turned down and what failed.
pub fn quality(data: &ReportData) -> Markup {
    let records = || data.series.iter().flat_map(|s| s.records.iter().map(move |r| (s, r)));
    let unused = table::unused_of(records().map(|(s, r)| (format!("{}/", s.name), r)));
    let (failed, camera, remarks) = (failed(data), camera(data), remarks(data));
    html! {
        h2 id="quality" { "Quality" }
        (tests(records().map(|(_, r)| r)))
        (section("Markers not used", "Every marker of the survey was used in every solved frame.", &unused))
        (section("Frames without a result", "Every frame has a result.", &failed))
        (instants(data))
        (section("Camera failures", "The camera delivered every shot at the first attempt.", &camera))
        @if !remarks.rows.is_empty() {
            h3 { "Remarks" }
            div.scroll { (remarks.html()) }
        }
    }
}

fn section(title: &str, none: &str, grid: &Grid) -> Markup {
    html! {
        h3 { (title) }
        @if grid.rows.is_empty() { p { (none) } } @else { div.scroll { (grid.html()) } }
    }
}

fn tests<'a>(records: impl Iterator<Item = &'a ImageRecord>) -> Markup {
    let (mut passed, mut rejected) = (0, 0);
    for verdict in records.filter_map(|r| r.global_test) {
        passed += usize::from(verdict == GlobalTest::Passed);
        rejected += usize::from(verdict == GlobalTest::Rejected);
    }
    html! {
        @if passed + rejected == 0 {
            p { "No global test could be made." }
        } @else if rejected == 0 {
            p {
                @if passed == 1 { "The global test" } @else { "All " (passed) " global tests" } " passed: the residuals do not contradict the model and the stated standard deviations. "
                "They cannot show what leaves no residuals: an error that bending, mounting or another unknown takes up, such as a wrong root, axis, lens or window. "
                "Against that stand the standard deviations stated for it, " a href="#budget" { "share by share" } "."
            }
        } @else {
            p.warning { (rejected) " of " (passed + rejected) " global tests rejected the model or the stated standard deviations; unless fixed otherwise, the standard deviations of those frames are a posteriori." }
        }
    }
}

fn failed(data: &ReportData) -> Grid {
    let mut grid = Grid::new(&["<series", "<frame", "<reason"]);
    for s in &data.series {
        for r in s.records.iter().filter(|r| !r.is_solved()) {
            let reason = r.reason.clone().unwrap_or_else(|| "no reason recorded".to_owned());
            grid.push(vec![s.name.clone(), r.image.clone(), reason]);
        }
        for image in unsolved(s) {
            grid.push(vec![s.name.clone(), image.to_owned(), "not solved yet".to_owned()]);
        }
    }
    grid
}

fn unsolved(s: &SeriesData) -> impl Iterator<Item = &str> {
    let images = s.shots.iter().filter_map(|shot| shot.image.as_deref());
    images.filter(|image| !s.records.iter().any(|r| r.image == *image))
}

fn camera(data: &ReportData) -> Grid {
    let mut grid = Grid::new(&["<series", "shot", "<time (UTC)", "<frame", "<what happened"]);
    for s in &data.series {
        for shot in &s.shots {
            for failure in &shot.failures {
                let time = time(s, shot);
                let image = shot.image.clone().unwrap_or_else(|| "none".to_owned());
                grid.push(vec![s.name.clone(), shot.number.to_string(), time, image, failure.clone()]);
            }
        }
    }
    grid
}

fn time(series: &SeriesData, shot: &ShotData) -> String {
    let text = |s: &Stamp| s.utc.strftime("%Y-%m-%d %H:%M:%S").to_string();
    shot.stamp.as_ref().filter(|_| series.begun.is_some()).map_or(NONE.to_owned(), text)
}

/// The same remark once, with its frames counted.
fn remarks(data: &ReportData) -> Grid {
    let mut seen: Vec<(&str, usize, String)> = Vec::new();
    for s in &data.series {
        let of_frames =
            s.records.iter().flat_map(|r| r.remarks.iter().map(move |t| (t.as_str(), r.image.as_str())));
        for (text, image) in s.remarks.iter().map(|t| (t.as_str(), "")).chain(of_frames) {
            match seen.iter_mut().find(|known| known.0 == text) {
                Some(known) => known.1 += 1,
                None => seen.push((text, 1, format!("{}/{image}", s.name))),
            }
        }
    }
    let mut grid = Grid::new(&["<remark", "times", "<first in"]);
    for (text, count, first) in seen {
        grid.push(vec![text.to_owned(), count.to_string(), first]);
    }
    grid
}

/// Inputs of the results, then every frame with its hash.
pub fn provenance(data: &ReportData) -> Markup {
    let mut sets: Vec<(Provenance, usize)> = Vec::new();
    for record in data.series.iter().flat_map(|s| &s.records) {
        let inputs = Provenance { frame_sha256: None, ..record.provenance.clone() };
        match sets.iter_mut().find(|known| known.0 == inputs) {
            Some(known) => known.1 += 1,
            None => sets.push((inputs, 1)),
        }
    }
    html! {
        h2 id="provenance" { "Provenance" }
        @if sets.is_empty() { p { "There are no results." } }
        @for (set, count) in &sets {
            h3 { "Inputs of " (number::count(*count, "result")) }
            div.scroll { (inputs(set).html()) }
        }
        @let frames = frames(data);
        @if !frames.rows.is_empty() {
            details {
                summary { "Frames, SHA-256" }
                div.scroll.hashes { (frames.html()) }
            }
        }
    }
}

fn inputs(set: &Provenance) -> Grid {
    let mut grid = Grid::new(&["<input", "<value"]);
    for (key, value) in &fields(set) {
        match value {
            Value::Object(inner) => {
                for (name, value) in inner {
                    grid.push(vec![format!("{key}, {name}"), shown(value)]);
                }
            }
            other => grid.push(vec![key.clone(), shown(other)]),
        }
    }
    grid
}

fn frames(data: &ReportData) -> Grid {
    let mut grid = Grid::new(&["<series", "<frame", "<came as", "<UTC", "<SHA-256", "solve / ms"]);
    for s in &data.series {
        for shot in &s.shots {
            let Some(image) = &shot.image else { continue };
            let ms = s.record_of(shot).map(|r| r.timing_ms.total());
            grid.push(vec![
                s.name.clone(),
                image.clone(),
                shot.source.clone().unwrap_or_else(|| NONE.to_owned()),
                time(s, shot),
                shot.sha256.clone().unwrap_or_else(|| NONE.to_owned()),
                fixed(ms, 0),
            ]);
        }
    }
    grid
}
