//! The pages' texts: readable on a phone, by keyboard, in the dark; nothing of them comes from outside.

mod curve;
mod flight;
mod live;
mod mark;
mod series;

use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde::Serialize;
use serde_json::{Value, json};

use super::{Refusal, Site};
use crate::daemon::{Health, Status, StatusBoard};
use crate::record::Reference;
use crate::report::number::{count, fixed, rounded};
use crate::report::overview::{self, Overview};
use crate::report::summary::Single;
use crate::store::{RealDisk, catalogue};

pub use flight::flight;
pub use live::live;
pub use mark::mark;
pub use series::{frame, series};

const STYLE: &str = include_str!("style.css");

/// Flights whose deflections are drawn on the first page; of the others it has the name and the beginning.
const DRAWN: usize = 6;

/// Room beyond which its hours are no matter, h.
const MANY_HOURS: f64 = 1000.0;

fn page(title: &str, trail: &Markup, content: &Markup) -> Markup {
    let nav = html! { a href="/" { "All flights" } (trail) a href="/live" { "Live" } a href="/status.json" { "status.json" } };
    sheet(title, &nav, content, "read-only")
}

fn sheet(title: &str, nav: &Markup, content: &Markup, kind: &str) -> Markup {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) ", wingd" }
                link rel="icon" href="data:,";
                style { (PreEscaped(STYLE)) }
            }
            body {
                a.skip href="#content" { "To the content" }
                main {
                    header {
                        nav aria-label="Where you are" { (nav) }
                        h1 { (title) }
                    }
                    div id="content" tabindex="-1" { (content) }
                    footer { "wingd " (env!("CARGO_PKG_VERSION")) ", " (kind) }
                }
            }
        }
    }
}

/// One sentence.
pub fn message(text: &str) -> Markup {
    page("wingd", &html! {}, &html! { p.warning { (text) } })
}

/// Health, room, and the flights, the newest first.
pub fn index(site: &Site) -> Result<Markup, Refusal> {
    let disk = RealDisk;
    catalogue::check_format(&disk, &site.root)?;
    let mut flights = catalogue::list_flights(&disk, &site.root)?;
    flights.reverse();
    let drawn =
        flights.iter().take(DRAWN).map(|f| overview::flight(&disk, f)).collect::<Result<Vec<_>, _>>()?;
    let newest = drawn.first();
    let older = flights.iter().skip(DRAWN);
    let begun = |f: &catalogue::FlightRef| {
        catalogue::read_flight_manifest(&disk, f).map_or("beginning unknown".to_owned(), |m| minute(m.started.utc))
    };
    let content = html! {
        (tiles(site, newest))
        h2 { "Flights" }
        @if flights.is_empty() { p { "The store holds no flight yet." } }
        ul.cards { @for one in &drawn { (card(one)) } }
        @if flights.len() > DRAWN {
            details {
                summary { (count(flights.len() - DRAWN, "earlier flight")) }
                ul { @for f in older { li { a href={ "/flights/" (f.id) } { (f.id) } ", " (begun(f)) } } }
            }
        }
    };
    Ok(page("Recorded flights", &html! {}, &content))
}

fn minute(utc: jiff::Timestamp) -> String {
    utc.strftime("%Y-%m-%d %H:%M UTC").to_string()
}

fn card(one: &Overview) -> Markup {
    let first = one.series.first().and_then(|line| line.begun.as_ref());
    let missing = one.series.iter().filter(|line| !line.missing().is_empty()).count();
    html! {
        li {
            h3 { a href={ "/flights/" (one.flight) } { "Flight " (one.flight) } }
            p.soft {
                @if let Some(begun) = first { (minute(begun.utc)) ", " }
                (one.series.len()) " series, " (count(one.sum(|l| l.frames), "frame")) ", " (one.sum(|l| l.solved)) " solved"
            }
            (curve::deflection(one, 330.0, 110.0))
            @if let Some((line, deflection)) = one.greatest() { p { (greatest(line, deflection, one.reference)) } }
            @if missing > 0 { p.warn { "Something is missing in " (missing) " series." } }
            @if one.warning.is_some() { p.warn { "Results of several inputs." } }
        }
    }
}

/// A single frame's deflection.
fn greatest(line: &overview::Line, deflection: &Single, reference: Reference) -> String {
    let (value, sigma) = rounded(Some(deflection.deflection_m), deflection.sigma_m, 3);
    let at = line.begun.as_ref().map_or(String::new(), |b| format!(", begun {}", minute(b.utc)));
    let (image, words) = (&deflection.image, reference.words());
    format!(
        "Greatest tip deflection of a frame: {value} ± {sigma} m {words}, in {image} of series {}{at}",
        line.name
    )
}

/// As the status writes it.
fn word(value: impl Serialize) -> String {
    serde_json::to_value(value).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}

/// Health and free space.
fn tiles(site: &Site, newest: Option<&Overview>) -> Markup {
    let daemon = site.status.as_ref().map(StatusBoard::snapshot);
    let last = newest.and_then(|o| o.last_frame.as_ref());
    let room = room(site, newest, daemon.as_ref());
    let state = |d: &Status| format!("{}, {}", word(d.health), word(d.activity));
    let state = daemon.as_ref().map_or("no recorder here".to_owned(), state);
    let last = last.map_or("none".to_owned(), |stamp| minute(stamp.utc));
    let fits = |hours: Option<f64>| match hours {
        None => "room unknown".to_owned(),
        Some(h) if h >= MANY_HOURS => format!("over {MANY_HOURS:.0} h"),
        Some(h) => format!("{h:.0} h"),
    };
    let reasons = daemon.as_ref().map(|d| d.reasons.as_slice()).unwrap_or_default();
    let fault = daemon.as_ref().and_then(|d| d.last_fault.as_ref());
    let next = daemon.as_ref().and_then(|d| d.next_series_s);
    html! {
        ul.tiles {
            li.alert[daemon.as_ref().is_some_and(|d| d.health != Health::Ok)] {
                b { (state) }
                @if daemon.is_some() { "the recorder" } @else { "these pages show a store alone" }
            }
            li { b { (last) } "last frame" }
            @if let Some(next) = next { li { b { (fixed(Some(next / 60.0), 0)) " min" } "until the next series" } }
            @if let Some((hours, free_mb)) = room {
                li.alert[hours.is_some_and(|h| h < 12.0)] {
                    b { (fits(hours)) }
                    "of recording fit, " (free_mb) " MB free"
                }
            }
        }
        @for reason in reasons { p.warning { (reason) } }
        @if let Some(fault) = fault { p.warning { "Last fault: " (fault.what) } }
    }
}

/// Hours of recording that fit at the newest flight's pace, and MB free above the reserve.
fn room(site: &Site, newest: Option<&Overview>, daemon: Option<&Status>) -> Option<(Option<f64>, u64)> {
    let free = crate::store::Disk::free_bytes(&RealDisk, &site.root).ok()?;
    let reserve_mb = daemon.map_or(0, |d| d.store.reserve_mb);
    let free = free.saturating_sub(reserve_mb * 1_000_000);
    let pace = newest.and_then(Overview::bytes_per_hour).filter(|pace| *pace > 0.0);
    Some((pace.map(|pace| free as f64 / pace), free / 1_000_000))
}

/// What the store holds, and the daemon's state where one runs. Of the frames only the newest flight's
/// are counted: the answer costs the same at one flight and at a thousand.
pub fn status(site: &Site) -> Result<Value, Refusal> {
    let disk = RealDisk;
    catalogue::check_format(&disk, &site.root)?;
    let flights = catalogue::list_flights(&disk, &site.root)?;
    let newest = flights.last().map(|f| overview::flight(&disk, f)).transpose()?.unwrap_or_default();
    let daemon = site.status.as_ref().map(StatusBoard::snapshot);
    let room = room(site, Some(&newest), daemon.as_ref());
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
        "last_frame_utc": newest.last_frame.as_ref().map(|s| s.utc),
        "missing": last.map(overview::Line::missing),
        "free_mb": room.map(|r| r.1),
        "room_hours": room.and_then(|r| r.0),
        "notes": newest.warning.iter().chain(&newest.notes).collect::<Vec<_>>(),
        "daemon": daemon,
    }))
}
