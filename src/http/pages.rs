//! The pages' texts.

use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::{Value, json};

use super::{Refusal, Site};
use crate::record::Status;
use crate::report::html::STYLE;
use crate::report::{ReportData, SeriesData, ShotData, source, summary, table};
use crate::store::{RealDisk, catalogue};

fn page(title: &str, content: &Markup) -> Markup {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width";
                title { (title) ", wingd" }
                style { (PreEscaped(STYLE)) }
            }
            body { main {
                header { h1 { (title) } p.sub { a href="/" { "All flights" } " | " a href="/status.json" { "status" } } }
                (content)
                footer { "wingd " (env!("CARGO_PKG_VERSION")) ", read-only" }
            } }
        }
    }
}

/// One sentence.
pub fn message(text: &str) -> Markup {
    page("wingd", &html! { p.warning { (text) } })
}

/// The flights, the newest first.
pub fn index(site: &Site) -> Result<Markup, Refusal> {
    let disk = RealDisk;
    catalogue::check_format(&disk, &site.root)?;
    let flights = catalogue::flights(&disk, &site.root)?;
    let row = |f: &catalogue::FlightRef| {
        let started = catalogue::flight_manifest(&disk, f).map(|m| m.started.utc);
        let started = started.map_or("unknown".to_owned(), |t| t.strftime("%Y-%m-%d %H:%M").to_string());
        (f.id.clone(), started, catalogue::series(&disk, f).map_or(0, |s| s.len()))
    };
    let rows: Vec<_> = flights.iter().rev().map(row).collect();
    Ok(page(
        "Flights",
        &html! {
            @if rows.is_empty() { p { "The store holds no flight yet." } } @else {
                table {
                    thead { tr { th { "flight" } th { "begun (UTC)" } th.n { "series" } th { "whole flight" } } }
                    tbody { @for (id, started, count) in &rows { tr {
                        td { a href={ "/flights/" (id) } { (id) } }
                        td { (started) }
                        td.n { (count) }
                        td { a href={ "/report/" (id) } { "report" } ", " a href={ "/tar/" (id) ".tar" } { "archive (tar)" } }
                    } } }
                }
            }
        },
    ))
}

/// A flight's series.
pub fn flight(id: &str, data: &ReportData) -> Markup {
    let summaries = summary::summaries(&data.series);
    page(
        &format!("Flight {id}"),
        &html! {
            p { a href={ "/report/" (id) } { "Report" } ", " a href={ "/tar/" (id) ".tar" } { "whole flight (tar)" } ", " a href={ "/files/" (id) "/flight.json" } { "flight.json" } }
            @for note in &data.notes { p.warning { (note) } }
            p { "Series: " @for s in &data.series { a href={ "/flights/" (id) "/" (s.name) } { (s.name) } " " } }
            div.scroll { (table::series_grid(&summaries).html()) }
        },
    )
}

/// A series' frames with their results; `None` where the flight has no such series.
pub fn series(data: &ReportData, id: &str) -> Option<Markup> {
    let series = data.series.iter().find(|s| s.name == id)?;
    let base = format!("/files/{}/{}", series.flight, series.name);
    let content = html! {
        p { a href={ "/flights/" (series.flight) } { "Flight " (series.flight) } ", "
            a href={ (base) "/series.json" } { "series.json" } ", " a href={ (base) "/results.jsonl" } { "results.jsonl" } }
        @if series.interrupted { p.warning { "This series was interrupted." } }
        table {
            thead { tr { th.n { "shot" } th { "time (UTC)" } th { "frame" } th { "result" } th { "SHA-256" } } }
            tbody { @for shot in &series.shots { (shot_row(series, shot, &base)) } }
        }
    };
    Some(page(&format!("Series {id}"), &content))
}

fn shot_row(series: &SeriesData, shot: &ShotData, base: &str) -> Markup {
    let record = series.records.iter().find(|r| Some(&r.image) == shot.image.as_ref());
    let result = match record {
        None => "not solved yet".to_owned(),
        Some(r) if r.status == Status::Failed => r.reason.clone().unwrap_or_default(),
        Some(r) => r.tip.as_ref().map_or("solved".to_owned(), |t| {
            let (lift, sigma) = crate::report::number::rounded(Some(t.lift_m), t.sigma_lift_m, 3);
            format!("tip lift {lift} m, sigma {sigma} m")
        }),
    };
    let time = shot.stamp.as_ref().map(|s| s.utc.strftime("%Y-%m-%d %H:%M:%S").to_string());
    html! { tr {
        td.n { (shot.number) }
        td { (time.unwrap_or_default()) }
        td { @match &shot.image {
            Some(name) => a href={ (base) "/" (name) } { (name) },
            None => (shot.failures.join("; ")),
        } }
        td { @if shot.image.is_some() { (result) } }
        td { small { (shot.sha256.as_deref().unwrap_or_default()) } }
    } }
}

/// What the store holds, and the daemon's state where one runs.
pub fn status(site: &Site) -> Result<Value, Refusal> {
    let data = source::all(&site.root)?;
    let records = || data.series.iter().flat_map(|s| &s.records);
    let shots = || data.series.iter().flat_map(|s| &s.shots);
    let frames = || shots().filter(|s| s.image.is_some());
    let mut flights: Vec<&str> = data.series.iter().map(|s| s.flight.as_str()).collect();
    flights.dedup();
    Ok(json!({
        "program": format!("wingd {}", env!("CARGO_PKG_VERSION")),
        "flights": flights,
        "series": data.series.len(),
        "shots": shots().count(),
        "frames": frames().count(),
        "solved": records().filter(|r| r.status == Status::Ok).count(),
        "failed": records().filter(|r| r.status == Status::Failed).count(),
        "last_frame_utc": frames().next_back().and_then(|s| s.stamp.as_ref()).map(|s| s.utc),
        "notes": data.notes,
        "daemon": site.status.as_ref().map(|ask| ask()),
    }))
}
