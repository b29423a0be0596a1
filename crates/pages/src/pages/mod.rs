//! Pages as HTML: readable on a phone, usable by keyboard, with a dark mode; nothing is loaded from other servers.

mod curve;
mod flight;
mod live;
mod series;

use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::{Value, json};

use super::{Refusal, Site};
use crate::recorder::RecorderState;
use wingd_base::clock::Stamp;
use wingd_evaluation::figures::FIGURE_STYLE;
use wingd_evaluation::number::{count_text, format_fixed, format_rounded};
use wingd_evaluation::results::overview;
use wingd_evaluation::results::overview::FlightOverview;
use wingd_evaluation::results::summary::FrameDeflection;
use wingd_measure::adjust::DeflectionReference;
use wingd_store::{RealDisk, catalogue};

pub use flight::flight_page;
pub use live::live_page;
pub use series::{frame_page, series_page};

const STYLE: &str = include_str!("style.css");

/// Maximum number of flights drawn on the first page; the others are listed with name and start time.
const MAX_DRAWN_FLIGHTS: usize = 6;

/// Recording time above which the exact number of hours is not shown, h.
const MAX_SHOWN_HOURS: f64 = 1000.0;

fn render_read_only_page(title: &str, trail: &Markup, content: &Markup) -> Markup {
    let nav = html! { a href="/" { "All flights" } (trail) a href="/live" { "Live" } a href="/status.json" { "status.json" } };
    render_html_page(title, &nav, content, "read-only")
}

/// Renders a page with its title, style and content.
pub fn render_html_page(title: &str, nav: &Markup, content: &Markup, kind: &str) -> Markup {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) ", wingd" }
                link rel="icon" href="data:,";
                style { (PreEscaped(FIGURE_STYLE)) (PreEscaped(STYLE)) }
            }
            body {
                a.skip href="#content" { "Skip to content" }
                main {
                    header {
                        nav aria-label="Navigation" { (nav) }
                        h1 { (title) }
                    }
                    div id="content" tabindex="-1" { (content) }
                    footer { "wingd " (env!("CARGO_PKG_VERSION")) ", " (kind) }
                }
            }
        }
    }
}

/// Renders a page with one sentence.
pub fn message_page(text: &str) -> Markup {
    render_read_only_page("wingd", &html! {}, &html! { p.warning { (text) } })
}

/// Renders the first page: health, free space, and the flights, the newest first.
pub fn index_page(site: &Site) -> Result<Markup, Refusal> {
    let disk = RealDisk;
    catalogue::check_format(&disk, &site.root)?;
    let mut flights = catalogue::list_flights(&disk, &site.root)?;
    flights.reverse();
    let drawn = flights
        .iter()
        .take(MAX_DRAWN_FLIGHTS)
        .map(|f| overview::read_overview(&disk, f))
        .collect::<Result<Vec<_>, _>>()?;
    let newest = drawn.first();
    let older = flights.iter().skip(MAX_DRAWN_FLIGHTS);
    let begun = |f: &catalogue::FlightRef| {
        catalogue::read_flight_manifest(&disk, f)
            .map_or(UNKNOWN_TIME.to_owned(), |m| format_minute(&m.started))
    };
    let content = html! {
        (status_tiles(site, newest))
        h2 { "Flights" }
        @if flights.is_empty() { p { "The store holds no flight yet." } }
        ul.cards { @for one in &drawn { (render_flight_card(one)) } }
        @if flights.len() > MAX_DRAWN_FLIGHTS {
            details {
                summary { (count_text(flights.len() - MAX_DRAWN_FLIGHTS, "earlier flight")) }
                ul { @for f in older { li { a href={ "/flights/" (f.id) } { (f.id) } ", " (begun(f)) } } }
            }
        }
    };
    Ok(render_read_only_page(
        "Recorded flights",
        &html! {},
        &content,
    ))
}

const UNKNOWN_TIME: &str = "time unknown";

fn format_minute(stamp: &Stamp) -> String {
    stamp.known_utc().map_or(UNKNOWN_TIME.to_owned(), |utc| {
        utc.strftime("%Y-%m-%d %H:%M UTC").to_string()
    })
}

fn render_flight_card(one: &FlightOverview) -> Markup {
    let first = one.series.first().and_then(|line| line.begun.as_ref());
    let missing = one
        .series
        .iter()
        .filter(|line| !line.problems().is_empty())
        .count();
    html! {
        li {
            h3 { a href={ "/flights/" (one.flight) } { "Flight " (one.flight) } }
            p.soft {
                @if let Some(begun) = first { (format_minute(begun)) ", " }
                (one.series.len()) " series, " (count_text(one.sum(|l| l.frames), "frame")) ", " (one.sum(|l| l.solved)) " solved"
            }
            (curve::deflection_curve(one, 120.0))
            @if let Some((line, deflection)) = one.greatest() { p { (greatest_deflection(line, deflection, one.reference)) } }
            @if missing > 0 { p.warn { "Frames or results are missing in " (missing) " series." } }
            @if one.warning.is_some() { p.warn { "Results from several inputs." } }
        }
    }
}

/// Describes the greatest tip deflection of a single frame.
fn greatest_deflection(
    line: &overview::SeriesOverview,
    deflection: &FrameDeflection,
    reference: DeflectionReference,
) -> String {
    let (value, sigma) = format_rounded(Some(deflection.deflection_m), deflection.sigma_m, 3);
    let at = line
        .begun
        .as_ref()
        .map_or(String::new(), |b| format!(", started {}", format_minute(b)));
    let (FrameDeflection { image, marker, .. }, words) = (deflection, reference.description());
    format!(
        "Greatest tip deflection ({marker}) of a frame: {value} ± {sigma} m {words}, in {image} of series {}{at}",
        line.name
    )
}

/// Renders health and free space.
fn status_tiles(site: &Site, newest: Option<&FlightOverview>) -> Markup {
    let daemon = site.recorder.as_ref().map(|recorder| recorder.state());
    let last = newest.and_then(|o| o.last_frame.as_ref());
    let room = remaining_recording(site, newest, daemon.as_ref());
    let state = |d: &RecorderState| format!("{}, {}", d.health, d.activity);
    let state = daemon.as_ref().map_or("no recorder".to_owned(), state);
    let last = last.map_or("none".to_owned(), format_minute);
    let fits = |hours: f64| match hours {
        h if h >= MAX_SHOWN_HOURS => format!("over {MAX_SHOWN_HOURS:.0} h"),
        h => format!("{h:.0} h"),
    };
    let reasons = daemon
        .as_ref()
        .map(|d| d.reasons.as_slice())
        .unwrap_or_default();
    let fault = daemon.as_ref().and_then(|d| d.last_fault.as_deref());
    let next = daemon.as_ref().and_then(|d| d.next_series_s);
    html! {
        ul.tiles {
            li.alert[daemon.as_ref().is_some_and(|d| !d.is_healthy)] {
                b { (state) }
                @if daemon.is_some() { "the recorder" } @else { "is attached to this page" }
            }
            li { b { (last) } "last frame" }
            @if let Some(next) = next { li { b { (format_fixed(Some(next / 60.0), 0)) " min" } "until the next series" } }
            @if let Some((hours, free_mb)) = room {
                @if let Some(hours) = hours {
                    li.alert[hours < 12.0] { b { (fits(hours)) } "of recording time left, " (free_mb) " MB free" }
                } @else { li { b { (free_mb) " MB" } "free" } }
            }
        }
        @for reason in reasons { p.warning { (reason) } }
        @if let Some(fault) = fault { p.warning { "Last error: " (fault) } }
    }
}

/// Returns the hours of recording that fit at the newest flight's rate, if a recorder runs, and the free space above the
/// reserve, MB.
fn remaining_recording(
    site: &Site,
    newest: Option<&FlightOverview>,
    daemon: Option<&RecorderState>,
) -> Option<(Option<f64>, u64)> {
    let free = wingd_store::Disk::free_bytes(&RealDisk, &site.root).ok()?;
    let reserve_mb = daemon.map_or(0, |d| d.reserve_mb);
    let free = free.saturating_sub(reserve_mb * 1_000_000);
    let pace = newest
        .filter(|_| daemon.is_some())
        .and_then(FlightOverview::bytes_per_hour)
        .filter(|pace| *pace > 0.0);
    Some((pace.map(|pace| free as f64 / pace), free / 1_000_000))
}

/// Returns the contents of the store, and the daemon's state if one runs, as JSON. Only frames of the newest flight are
/// counted, so the response time does not depend on the number of flights.
pub fn status_json(site: &Site) -> Result<Value, Refusal> {
    let disk = RealDisk;
    catalogue::check_format(&disk, &site.root)?;
    let flights = catalogue::list_flights(&disk, &site.root)?;
    let newest = flights
        .last()
        .map(|f| overview::read_overview(&disk, f))
        .transpose()?
        .unwrap_or_default();
    let daemon = site.recorder.as_ref().map(|recorder| recorder.state());
    let room = remaining_recording(site, Some(&newest), daemon.as_ref());
    let last = newest.series.last();
    Ok(json!({
        "program": format!("wingd {}", env!("CARGO_PKG_VERSION")),
        "store_id": catalogue::store_id(&disk, &site.root),
        "flights": flights.iter().map(|f| &f.id).collect::<Vec<_>>(),
        "flight": flights.last().map(|f| &f.id),
        "series": newest.series.len(),
        "shots": newest.sum(|l| l.planned),
        "frames": newest.sum(|l| l.frames),
        "solved": newest.sum(|l| l.solved),
        "failed": newest.sum(|l| l.failed),
        "last_series": last.map(|l| &l.name),
        "last_frame_utc": newest.last_frame.as_ref().and_then(Stamp::known_utc),
        "missing": last.map(overview::SeriesOverview::problems),
        "free_mb": room.map(|r| r.1),
        "room_hours": room.and_then(|r| r.0),
        "notes": newest.warning.iter().chain(&newest.notes).collect::<Vec<_>>(),
        "daemon": daemon.map(|d| d.status),
    }))
}
