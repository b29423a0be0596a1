//! Errors of the TOML parser with their lines, and remedies of common mistakes.

use std::path::Path;

use super::fault::Fault;

/// Converts an error of the TOML parser into a fault with its line.
pub fn toml_fault(file: &Path, text: &str, error: &toml::de::Error, remedy: &str) -> Fault {
    let line = error
        .span()
        .map(|s| 1 + text.get(..s.start).map_or(0, |t| t.matches('\n').count()));
    let shown = line
        .and_then(|l| text.lines().nth(l - 1))
        .map(str::trim)
        .unwrap_or_default();
    let place = line.map_or("file".into(), |l| format!("line {l} (`{shown}`)"));
    let at = error
        .span()
        .and_then(|span| text.get(span))
        .unwrap_or_default();
    let (problem, remedy) = match common_toml_mistake(shown, at, error.message()) {
        Some((problem, remedy)) => (problem.to_owned(), remedy),
        None => (error.message().replace('\n', " "), remedy),
    };
    Fault::new(file, place, problem, remedy)
}

/// Returns problem and remedy of common mistakes in TOML: paths with backslashes, dates without quotes, decimal commas,
/// typographic quotes.
fn common_toml_mistake(
    line: &str,
    at: &str,
    message: &str,
) -> Option<(&'static str, &'static str)> {
    let value = line.split_once('=').map_or("", |(_, value)| value.trim());
    if value.starts_with('"') && message.contains("escape") {
        let remedy = "write the path with /, or in single quotes: 'C:\\data'";
        return Some((
            "has a backslash, which begins an escape within double quotes",
            remedy,
        ));
    }
    let parts = value.split_once(',').filter(|parts| {
        [parts.0, parts.1]
            .iter()
            .all(|p| p.trim().parse::<i64>().is_ok())
    });
    if parts.is_some() {
        return Some(("has a decimal comma", "use a decimal point: 0.55"));
    }
    if value.starts_with(['\u{201c}', '\u{201d}', '\u{201e}', '\u{2018}', '\u{2019}']) {
        return Some((
            "has typographic quotes",
            "use straight quotes: \"survey.csv\"",
        ));
    }
    let date = !at.is_empty() && at.trim().parse::<toml::value::Datetime>().is_ok();
    date.then_some((
        "is a date, but a text or a number is expected",
        "put a text in quotes: \"2026-06-01\"",
    ))
}
