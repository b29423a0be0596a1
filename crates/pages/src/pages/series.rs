//! Pages of a series and of a frame.

use maud::{Markup, html};

use super::render_read_only_page;
use wingd_base::clock::Stamp;
use wingd_evaluation::number::format_rounded;
use wingd_evaluation::record::ImageRecord;
use wingd_evaluation::results::source::SeriesIndex;
use wingd_evaluation::results::{SeriesData, ShotData, table};

/// Renders a page of a series: shots with their results and their markers drawn, files. `page`: number and count.
pub fn series_page(
    series: &SeriesIndex,
    shots: &[(&ShotData, Option<ImageRecord>)],
    page: (usize, usize),
) -> Markup {
    let data = &series.data;
    let base = format!("/files/{}/{}", data.flight, data.name);
    let content = html! {
        @if let Some(warning) = &series.warning { p.warning { (warning) } }
        @if data.interrupted { p.warning { "This series was interrupted." } }
        @for remark in &data.remarks { p.warning { (remark) } }
        p { a href={ (base) "/series.json" } { "series.json" } @if series.has_results() { ", " a href={ (base) "/results.jsonl" } { "results.jsonl" } } }
        (page_links(page))
        ul.cards { @for (shot, record) in shots { (render_shot_card(data, shot, record.as_ref())) } }
        (page_links(page))
    };
    render_read_only_page(
        &format!("Series {}", data.name),
        &flight_link(&data.flight),
        &content,
    )
}

/// Renders links to the other pages of a long series.
fn page_links((page, pages): (usize, usize)) -> Markup {
    html! { @if pages > 1 {
        p { "Page " (page) " of " (pages)
            @if page > 1 { ", " a href={ "?page=" (page - 1) } { "previous" } }
            @if page < pages { ", " a href={ "?page=" (page + 1) } { "next" } }
        }
    } }
}

fn flight_link(flight: &str) -> Markup {
    html! { a href={ "/flights/" (flight) } { "Flight " (flight) } }
}

fn render_shot_card(series: &SeriesData, shot: &ShotData, record: Option<&ImageRecord>) -> Markup {
    let place = format!("{}/{}", series.flight, series.name);
    let time = shot
        .stamp
        .as_ref()
        .and_then(Stamp::known_utc)
        .map(|utc| utc.strftime("%Y-%m-%d %H:%M:%S UTC").to_string());
    html! { li {
        @if let Some(image) = &shot.image {
            a href={ "/frames/" (place) "/" (image) } {
                img loading="lazy" src={ "/thumb/" (place) "/" (image) ".svg" } alt={ "Shot " (shot.number) " with its markers" };
            }
        }
        h3 { "Shot " (shot.number) }
        p.soft { (time.unwrap_or_default()) }
        p.warn[shot.image.is_none()] { (shot_outcome_text(shot, record)) }
        @if let Some(image) = &shot.image {
            p { a href={ "/files/" (place) "/" (image) } download { (image) } }
        }
        @for failure in &shot.failures { p.warn { (failure) } }
    } }
}

fn shot_outcome_text(shot: &ShotData, record: Option<&ImageRecord>) -> String {
    match (shot.image.as_ref(), record) {
        (None, _) => "no frame".to_owned(),
        (_, None) => "not solved yet".to_owned(),
        (_, Some(r)) if !r.is_solved() => r.reason.clone().unwrap_or_default(),
        (_, Some(r)) => r.tip.as_ref().map_or("solved".to_owned(), |t| {
            let reference = t.reference.unwrap_or_default();
            let (deflection_m, sigma_m) = t.deflection(reference).unzip();
            let (deflection, sigma) = format_rounded(deflection_m, sigma_m.flatten(), 3);
            format!(
                "tip deflection {deflection} m, sigma {sigma} m, {}",
                reference.description()
            )
        }),
    }
}

/// Renders one frame, large, with a table of its markers.
pub fn frame_page(series: &SeriesData, shot: &ShotData, record: Option<&ImageRecord>) -> Markup {
    let image = shot.image.as_deref().unwrap_or_default();
    let place = format!("{}/{}", series.flight, series.name);
    let trail = html! { (flight_link(&series.flight)) a href={ "/flights/" (place) } { "Series " (series.name) } };
    let content = html! {
        p { (shot_outcome_text(shot, record)) }
        img.frame src={ "/overlay/" (place) "/" (image) ".svg" } alt="The frame with its markers";
        p { a href={ "/files/" (place) "/" (image) } download { (image) ", as the camera delivered it" } }
        @if let Some(sha256) = &shot.sha256 { p.caption { "SHA-256 " code { (sha256) } } }
        @if let Some(record) = record.filter(|r| !r.markers.is_empty()) {
            @let reference = record.tip.as_ref().and_then(|tip| tip.reference).unwrap_or_default();
            h2 { "Markers, deflections " (reference.description()) }
            (table::marker_table(record, reference).html())
        }
    };
    render_read_only_page(&format!("{} of {}", image, series.name), &trail, &content)
}
