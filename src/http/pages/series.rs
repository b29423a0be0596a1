//! Pages of a series and of a frame.

use maud::{Markup, html};

use super::read_only_page;
use crate::record::{ImageRecord, RecordStatus};
use crate::report::number::format_rounded;
use crate::report::{SeriesData, ShotData, table};

fn find_record<'a>(series: &'a SeriesData, shot: &ShotData) -> Option<&'a ImageRecord> {
    series.records.iter().find(|r| Some(&r.image) == shot.image.as_ref())
}

/// Renders a series' page: frames with their markers drawn, results, files.
pub fn series_page(series: &SeriesData, warning: Option<&str>) -> Markup {
    let base = format!("/files/{}/{}", series.flight, series.name);
    let content = html! {
        @if let Some(warning) = warning { p.warning { (warning) } }
        @if series.interrupted { p.warning { "This series was interrupted." } }
        @for remark in &series.remarks { p.warning { (remark) } }
        p { a href={ (base) "/series.json" } { "series.json" } @if !series.records.is_empty() { ", " a href={ (base) "/results.jsonl" } { "results.jsonl" } } }
        ul.cards { @for shot in &series.shots { (shot_card(series, shot)) } }
    };
    read_only_page(&format!("Series {}", series.name), &flight_trail(&series.flight), &content)
}

fn flight_trail(flight: &str) -> Markup {
    html! { a href={ "/flights/" (flight) } { "Flight " (flight) } }
}

fn shot_card(series: &SeriesData, shot: &ShotData) -> Markup {
    let place = format!("{}/{}", series.flight, series.name);
    let time = shot.stamp.as_ref().map(|s| s.utc.strftime("%Y-%m-%d %H:%M:%S UTC").to_string());
    html! { li {
        @if let Some(image) = &shot.image {
            a href={ "/frames/" (place) "/" (image) } {
                img loading="lazy" src={ "/thumb/" (place) "/" (image) ".svg" } alt={ "Shot " (shot.number) " with its markers" };
            }
        }
        h3 { "Shot " (shot.number) }
        p.soft { (time.unwrap_or_default()) }
        p.warn[shot.image.is_none()] { (shot_outcome(series, shot)) }
        @if let Some(image) = &shot.image {
            p { a href={ "/files/" (place) "/" (image) } download { (image) } }
        }
        @for failure in &shot.failures { p.warn { (failure) } }
    } }
}

fn shot_outcome(series: &SeriesData, shot: &ShotData) -> String {
    match (shot.image.as_ref(), find_record(series, shot)) {
        (None, _) => "no frame".to_owned(),
        (_, None) => "not solved yet".to_owned(),
        (_, Some(r)) if r.status == RecordStatus::Failed => r.reason.clone().unwrap_or_default(),
        (_, Some(r)) => r.tip.as_ref().map_or("solved".to_owned(), |t| {
            let reference = t.reference.unwrap_or_default();
            let (deflection_m, sigma_m) = t.deflection(reference).unzip();
            let (deflection, sigma) = format_rounded(deflection_m, sigma_m.flatten(), 3);
            format!("tip deflection {deflection} m, sigma {sigma} m, {}", reference.description())
        }),
    }
}

/// Renders one frame, large, with a table of its markers; `None` if the series has no such frame.
pub fn frame_page(series: &SeriesData, image: &str) -> Option<Markup> {
    let shot = series.shots.iter().find(|s| s.image.as_deref() == Some(image))?;
    let place = format!("{}/{}", series.flight, series.name);
    let trail = html! { (flight_trail(&series.flight)) a href={ "/flights/" (place) } { "Series " (series.name) } };
    let content = html! {
        p { (shot_outcome(series, shot)) }
        img.frame src={ "/overlay/" (place) "/" (image) ".svg" } alt="The frame with its markers";
        p { a href={ "/files/" (place) "/" (image) } download { (image) ", as the camera delivered it" } }
        @if let Some(sha256) = &shot.sha256 { p.caption { "SHA-256 " code { (sha256) } } }
        @if let Some(record) = find_record(series, shot).filter(|r| !r.markers.is_empty()) {
            h2 { "Markers" }
            div.scroll tabindex="0" { (table::marker_table(record).html()) }
        }
    };
    Some(read_only_page(&format!("{} of {}", image, series.name), &trail, &content))
}
