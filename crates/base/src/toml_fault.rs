//! Errors of the TOML parser with their lines, and remedies of common mistakes.

use std::ops::Range;
use std::path::Path;

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::fault::Fault;

/// Parses a TOML file.
///
/// `tagged` names the tables whose key `kind` chooses the variant of an enum. They are read by its external tag: with an
/// internal one, serde would lose the place of every error in the table.
///
/// # Errors
/// Returns the first error with its line. For a value of the wrong type it shows the expected one.
pub fn parse_toml<T: DeserializeOwned>(
    file: &Path,
    text: &str,
    tagged: &[&[&str]],
    remedy: &str,
) -> Result<T, Fault> {
    let error = match read_toml(text, tagged) {
        Ok(read) => return Ok(read),
        Err(error) => error,
    };
    let (span, message) = match &error {
        TomlError::Syntax(error) | TomlError::Value(error) => {
            (error.span(), error.message().replace('\n', " "))
        }
        TomlError::NoKind(span) => (Some(span.clone()), "needs a text as `kind`".to_owned()),
    };
    let line = span
        .clone()
        .map(|s| 1 + text.get(..s.start).map_or(0, |t| t.matches('\n').count()));
    let shown = line
        .and_then(|l| text.lines().nth(l - 1))
        .map(str::trim)
        .unwrap_or_default();
    let place = line.map_or("file".into(), |l| format!("line {l} (`{shown}`)"));
    let at = span.clone().and_then(|s| text.get(s)).unwrap_or_default();
    let accepts = |span: &Range<usize>, value: &str| {
        let (before, after) = (text.get(..span.start), text.get(span.end..));
        let changed = [before.unwrap_or_default(), value, after.unwrap_or_default()].concat();
        match read_toml::<T>(&changed, tagged) {
            Ok(_) => true,
            Err(TomlError::Value(error)) => error.span().is_some_and(|s| s.start != span.start),
            Err(TomlError::Syntax(_) | TomlError::NoKind(_)) => false,
        }
    };
    let is_syntax = matches!(error, TomlError::Syntax(_));
    let (problem, remedy) = match common_toml_mistake(shown, at, is_syntax) {
        Some((problem, remedy)) => (problem.to_owned(), remedy.to_owned()),
        None => span
            .and_then(|span| wrong_type(text, &span, |value| accepts(&span, value)))
            .unwrap_or((message, remedy.to_owned())),
    };
    Err(Fault::new(file, place, problem, remedy))
}

/// Error of a TOML text.
enum TomlError {
    /// Text that is not TOML.
    Syntax(toml::de::Error),
    /// Value or key that does not fit.
    Value(toml::de::Error),
    /// Table without the key that chooses its variant.
    NoKind(Range<usize>),
}

fn read_toml<T: DeserializeOwned>(text: &str, tagged: &[&[&str]]) -> Result<T, TomlError> {
    let mut table = DeTable::parse(text).map_err(TomlError::Syntax)?;
    for path in tagged {
        if let Some(span) = tag_externally(table.get_mut(), path) {
            return Err(TomlError::NoKind(span));
        }
    }
    T::deserialize(toml::Deserializer::from(table)).map_err(TomlError::Value)
}

/// Moves the keys of a table below the value of its `kind`; returns the place of a table without one.
fn tag_externally(table: &mut DeTable, path: &[&str]) -> Option<Range<usize>> {
    let (first, rest) = path.split_first()?;
    let found = table.get_mut(*first)?;
    let span = found.span();
    let DeValue::Table(inner) = found.get_mut() else {
        return None;
    };
    if !rest.is_empty() {
        return tag_externally(inner, rest);
    }
    let kind = inner
        .get("kind")
        .map(|kind| (kind.span(), kind.get_ref().as_str()));
    let Some((place, Some(name))) = kind else {
        return Some(span);
    };
    let name = Spanned::new(place, name.to_owned().into());
    inner.remove("kind");
    let keys = std::mem::take(inner);
    inner.insert(name, Spanned::new(span, DeValue::Table(keys)));
    None
}

/// Values of each type, and its name in messages; the first that a key accepts shows its type.
const EXAMPLES: [(&str, &str); 5] = [
    ("0.5", "a number"),
    ("10", "a whole number"),
    ("true", "true or false"),
    ("\"text\"", "a text in quotes"),
    ("\"10s\"", "a duration in quotes"),
];

/// Returns problem and remedy for a value of the wrong type, with the value written properly, if it can be, or an example.
fn wrong_type(
    text: &str,
    span: &Range<usize>,
    accepts: impl Fn(&str) -> bool,
) -> Option<(String, String)> {
    let (before, value) = (text.get(..span.start)?, text.get(span.clone())?);
    let (key, _) = before.lines().last()?.split_once('=')?;
    let (example, kind) = EXAMPLES.iter().find(|(example, _)| accepts(example))?;
    let bare = value.trim_matches(['"', '\'']);
    let written = [
        bare.to_owned(),
        format!("\"{bare}\""),
        format!("\"{bare}s\""),
    ];
    let remedy = match written.iter().find(|w| *w != value && accepts(w)) {
        Some(written) => format!("write `{} = {written}`", key.trim()),
        None => format!("write it as in `{} = {example}`", key.trim()),
    };
    Some((format!("is {value}, but {kind} is expected"), remedy))
}

/// Returns problem and remedy of common mistakes in TOML: paths with backslashes, dates without quotes, decimal commas,
/// typographic quotes.
fn common_toml_mistake(
    line: &str,
    at: &str,
    is_syntax: bool,
) -> Option<(&'static str, &'static str)> {
    let value = line.split_once('=').map_or("", |(_, value)| value.trim());
    if is_syntax && value.starts_with('"') && value.contains('\\') {
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
