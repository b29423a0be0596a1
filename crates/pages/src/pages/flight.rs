//! Page of a flight: deflection, series, missing parts, and commands to download it.

use maud::{Markup, html};

use super::{curve, format_minute, greatest_deflection, render_read_only_page};
use wingd_evaluation::number::format_rounded;
use wingd_evaluation::results::overview::{FlightOverview, SeriesOverview};
use wingd_evaluation::results::table;

/// Renders a flight's page. `address` is the URL by which the client addresses this server, for the download commands.
pub fn flight_page(overview: &FlightOverview, address: &str) -> Markup {
    let id = &overview.flight;
    let missing: Vec<&SeriesOverview> = overview
        .series
        .iter()
        .filter(|line| !line.problems().is_empty())
        .collect();
    let content = html! {
        @if let Some(warning) = &overview.warning { p.warning { (warning) } }
        @for note in &overview.notes { p.warning { (note) } }
        p {
            a href={ "/tar/" (id) ".tar" } { "full flight (tar)" } ", "
            a href={ "/files/" (id) "/SHA256SUMS" } { "SHA256SUMS" }
        }
        div.figure { (curve::deflection_curve(overview, 190.0)) }
        @let deflection = format!("mean tip deflection {} / m", overview.reference.description());
        p.caption { "Deflection of the outermost marker: mean of each series, with 1 sigma of one frame." }
        @if let Some((line, deflection)) = overview.greatest() { p { (greatest_deflection(line, deflection, overview.reference)) } }
        h2 { "Missing frames and results" }
        @if missing.is_empty() { p { "Nothing: every shot has a frame, every frame a result." } } @else {
            details open[missing.len() <= 12] {
                summary { (missing.len()) " of " (overview.series.len()) " series" }
                ul { @for line in &missing { li {
                    a href={ "/flights/" (id) "/" (line.name) } { (line.name) } ": " (line.problems().join(", "))
                } } }
            }
        }
        h2 { "Series" }
        table.stack {
            thead { tr { th { "series" } th { "begun" } th.n { "frames" } th.n { "solved" } th.n { (deflection) } th.n { "sigma / m" } th.n { "scatter / m" } } }
            tbody { @for line in overview.series.iter().rev() { (render_series_row(id, line, &deflection)) } }
        }
        (download_recipes(id, address))
    };
    render_read_only_page(&format!("Flight {id}"), &html! {}, &content)
}

fn render_series_row(flight: &str, line: &SeriesOverview, title: &str) -> Markup {
    let (deflection, sigma) = format_rounded(
        line.tip_deflection_m.map(|m| m.value),
        line.tip_deflection_m.and_then(|m| m.sigma),
        3,
    );
    html! { tr {
        td data-name="series" { a href={ "/flights/" (flight) "/" (line.name) } { (line.name) } }
        td data-name="begun" { @if let Some(begun) = &line.begun { (format_minute(begun)) } }
        td.n data-name="frames" { (line.frames) " of " (line.planned) }
        td.n data-name="solved" { (line.solved) }
        td.n data-name=(title) { (deflection) }
        td.n data-name="sigma / m" { (sigma) }
        td.n data-name="scatter / m" { (table::scatter_text(line.tip_deflection_m)) }
    } }
}

/// Renders the commands that download the flight.
fn download_recipes(id: &str, address: &str) -> Markup {
    let plain = [
        (
            "wingd: resumes, verifies every file, adds later files",
            format!("wingd copy {address} COPY --flight {id}"),
        ),
        (
            "curl: resumes",
            format!("curl -C - -o {id}.tar {address}/tar/{id}.tar"),
        ),
        ("wget: resumes", format!("wget -c {address}/tar/{id}.tar")),
        (
            "a single file",
            format!("curl -O {address}/files/{id}/SERIES/0001.jpg"),
        ),
        (
            "over ssh",
            format!("rsync -a --partial HOST:STORE/flights/{id} ."),
        ),
    ];
    html! {
        h2 { "Download" }
        p { "The archive contains a store: after unpacking, wingd verify, report and solve work on it." }
        @for (label, command) in plain {
            p.caption { (label) }
            pre tabindex="0" { (command) }
        }
        p.caption { "If a token is required: wingd --token-file FILE; curl -H \"Authorization: Bearer $(cat FILE)\"; wget --header with the same value." }
    }
}
