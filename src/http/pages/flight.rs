//! A flight's page shows its deflection, its series, what is missing, and how to take it away.

use maud::{Markup, html};

use super::{curve, greatest, minute, page};
use crate::report::number::rounded;
use crate::report::overview::{Line, Overview};
use crate::report::table;

/// `address` is how the client calls this server, for the recipes.
pub fn flight(overview: &Overview, address: &str) -> Markup {
    let id = &overview.flight;
    let missing: Vec<&Line> = overview.series.iter().filter(|line| !line.missing().is_empty()).collect();
    let content = html! {
        @if let Some(warning) = &overview.warning { p.warning { (warning) } }
        @for note in &overview.notes { p.warning { (note) } }
        p {
            a href={ "/report/" (id) } { "Report" } ", "
            a href={ "/tar/" (id) ".tar" } { "whole flight (tar)" } ", "
            a href={ "/results/" (id) ".jsonl" } { "results only" } ", "
            a href={ "/files/" (id) "/SHA256SUMS" } { "SHA256SUMS" }
        }
        div.figure { (curve::deflection(overview, 460.0, 190.0)) }
        p.caption { "Deflection of the outermost marker " (overview.reference.words()) ": mean of each series, with 1 sigma of one frame." }
        @if let Some((line, deflection)) = overview.greatest() { p { (greatest(line, deflection, overview.reference)) } }
        h2 { "What is missing" }
        @if missing.is_empty() { p { "Nothing: every shot has its frame, every frame its result." } } @else {
            details open[missing.len() <= 12] {
                summary { (missing.len()) " of " (overview.series.len()) " series" }
                ul { @for line in &missing { li {
                    a href={ "/flights/" (id) "/" (line.name) } { (line.name) } ": " (line.missing().join(", "))
                } } }
            }
        }
        h2 { "Series" }
        table.stack {
            thead { tr { th { "series" } th { "begun" } th.n { "frames" } th.n { "solved" } th.n { "mean tip deflection / m" } th.n { "sigma / m" } th.n { "scatter / m" } } }
            tbody { @for line in overview.series.iter().rev() { (row(id, line)) } }
        }
        (recipes(id, address))
    };
    page(&format!("Flight {id}"), &html! {}, &content)
}

fn row(flight: &str, line: &Line) -> Markup {
    let (deflection, sigma) =
        rounded(line.tip_deflection_m.map(|m| m.value), line.tip_deflection_m.and_then(|m| m.sigma), 3);
    html! { tr {
        td data-name="series" { a href={ "/flights/" (flight) "/" (line.name) } { (line.name) } }
        td data-name="begun" { @if let Some(begun) = &line.begun { (minute(begun.utc)) } }
        td.n data-name="frames" { (line.frames) " of " (line.planned) }
        td.n data-name="solved" { (line.solved) }
        td.n data-name="mean tip deflection / m" { (deflection) }
        td.n data-name="sigma / m" { (sigma) }
        td.n data-name="scatter / m" { (table::scatter(line.tip_deflection_m)) }
    } }
}

/// Commands that take the flight away; each goes on where it was broken off.
fn recipes(id: &str, address: &str) -> Markup {
    let plain = [
        (
            "wingd: resumes, checks every file, brings later additions",
            format!("wingd fetch {address} COPY --flight {id}"),
        ),
        ("curl: resumes", format!("curl -C - -o {id}.tar {address}/tar/{id}.tar")),
        ("wget: resumes", format!("wget -c {address}/tar/{id}.tar")),
        ("one file of it", format!("curl -O {address}/files/{id}/SERIES/0001.jpg")),
        ("over ssh", format!("rsync -a --partial HOST:STORE/flights/{id} .")),
    ];
    html! {
        h2 { "Taking it away" }
        p { "The archive holds a store: unpacked, wingd verify, report and solve work on it." }
        @for (what, command) in plain {
            p.caption { (what) }
            pre tabindex="0" { (command) }
        }
        p.caption { "Where a token is asked for: --token-file FILE; curl -H \"Authorization: Bearer $(cat FILE)\"; wget --header the same." }
    }
}
