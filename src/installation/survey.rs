//! `survey.csv`: the markers as the tachymeter found them.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::Vector3;

use super::Reader;
use crate::measure::setup::{Shape, SurveyMarker};

const COLUMNS: [&str; 8] = ["id", "shape", "diameter_m", "x_m", "y_m", "z_m", "sigma_m", FIXED];
/// A column that need not be there: `yes` for a mark that is rigid to the cabin.
const FIXED: &str = "fixed";

/// A CSV file with named columns: (line number, the wanted columns' texts) per row; empty texts in `optional` columns
/// that are not there.
pub(super) fn read_table<const N: usize>(
    reader: &mut Reader,
    file: &Path,
    text: &str,
    columns: [&str; N],
    optional: &[&str],
) -> Option<Vec<(u64, [String; N])>> {
    let needed: Vec<&str> = columns.into_iter().filter(|c| !optional.contains(c)).collect();
    let text = without_comments(reader, file, text, needed.len());
    let mut csv = csv::ReaderBuilder::new().trim(csv::Trim::All).flexible(true).from_reader(text.as_bytes());
    let header = match csv.headers() {
        Ok(header) => header.clone(),
        Err(error) => {
            reader.fault(
                file,
                "line 1",
                error.to_string(),
                format!("begin with the header {}", needed.join(",")),
            );
            return None;
        }
    };
    if let Some(separator) = foreign_separator(&header) {
        let problem = format!("is separated by {separator}");
        let mend = "save it with commas between the columns and points in the numbers";
        reader.fault(file, "line 1", problem, mend);
        return None;
    }
    let mut index = [None; N];
    let mut whole = true;
    for (slot, name) in index.iter_mut().zip(columns) {
        match header.iter().position(|h| h == name) {
            Some(k) => *slot = Some(k),
            None if optional.contains(&name) => {}
            None => {
                let mend = format!("the header must hold {}", needed.join(","));
                reader.fault(file, &format!("column {name}"), "is missing", mend);
                whole = false;
            }
        }
    }
    if !whole {
        return None;
    }
    let mut rows = vec![];
    for record in csv.records() {
        match record {
            Ok(record) => {
                let line = record.position().map_or(0, csv::Position::line);
                if record.iter().all(str::is_empty) {
                    continue;
                }
                rows.push((
                    line,
                    index.map(|k| k.and_then(|k| record.get(k)).unwrap_or_default().to_owned()),
                ));
            }
            Err(error) => {
                let line = error.position().map_or(0, csv::Position::line);
                reader.fault(file, &format!("line {line}"), error.to_string(), "correct the line");
            }
        }
    }
    Some(rows)
}

/// The text with its comments as empty lines. A line that begins with `#` and is a whole row may be a
/// comment or a name: the user must say.
fn without_comments(reader: &mut Reader, file: &Path, text: &str, columns: usize) -> String {
    let mut kept = String::with_capacity(text.len());
    for (k, line) in text.lines().enumerate() {
        let comment = line.trim_start().strip_prefix('#');
        if comment.is_some_and(|c| !c.starts_with([' ', '\t', '#']) && c.split(',').count() >= columns) {
            let id = line.split(',').next().unwrap_or_default().trim();
            let mend =
                "write a blank after # to leave the line out, or give a name that does not begin with #";
            reader.fault(
                file,
                &format!("line {}", k + 1),
                format!("\"{id}\" may be a comment or a name"),
                mend,
            );
        }
        kept.push_str(if comment.is_some() { "" } else { line });
        kept.push('\n');
    }
    kept
}

/// What else than a comma stands between the columns, if the header is one cell for that reason.
fn foreign_separator(header: &csv::StringRecord) -> Option<&'static str> {
    let only = header.get(0).filter(|_| header.len() == 1)?;
    [(';', "semicolons"), ('\t', "tabs")].into_iter().find(|(c, _)| only.contains(*c)).map(|(_, name)| name)
}

/// A finite number; a fault where it is not one.
pub(super) fn number(reader: &mut Reader, file: &Path, line: u64, column: &str, text: &str) -> Option<f64> {
    let value = text.parse::<f64>().ok().filter(|v| v.is_finite());
    if value.is_none() {
        let place = format!("line {line}, column {column}");
        reader.fault(
            file,
            &place,
            format!("\"{text}\" is not a finite number"),
            "give a decimal number with a point",
        );
    }
    value
}

pub(super) fn read(reader: &mut Reader, name: &str) -> Option<Vec<SurveyMarker>> {
    let (file, text) = reader.text(name, "name the survey in wing.survey of installation.toml")?;
    let rows = read_table(reader, &file, &text, COLUMNS, &[FIXED])?;
    if rows.is_empty() {
        reader.fault(&file, "file", "holds no marker", "add one line per surveyed marker");
        return None;
    }
    let before = reader.faults.len();
    let mut seen: HashMap<String, u64> = HashMap::new();
    let mut markers = vec![];
    for (line, cells) in rows {
        check_id(reader, &file, line, &cells[0], &mut seen);
        if let Some(marker) = marker(reader, &file, line, &cells) {
            markers.push(marker);
        }
    }
    check_sigmas(reader, &file, &markers);
    (reader.faults.len() == before).then_some(markers)
}

/// Coarsest standard deviation of a survey that is believed, m: a tape along the wing gives some centimetres.
const COARSEST_SIGMA_M: f64 = 0.5;

/// Millimetres in a column of metres are one cause, on however many lines.
fn check_sigmas(reader: &mut Reader, file: &Path, markers: &[SurveyMarker]) {
    let coarse: Vec<&SurveyMarker> = markers.iter().filter(|m| m.sigma_m > COARSEST_SIGMA_M).collect();
    if let Some(first) = coarse.first() {
        let problem = format!(
            "is {} m for {} of {} markers, {} first",
            first.sigma_m,
            coarse.len(),
            markers.len(),
            first.id
        );
        let mend = format!("give metres, at most {COARSEST_SIGMA_M}: 0.002 for 2 mm");
        reader.fault(file, "column sigma_m", problem, mend);
    }
}

fn check_id(reader: &mut Reader, file: &Path, line: u64, id: &str, seen: &mut HashMap<String, u64>) {
    let place = format!("line {line}, column id");
    if id.is_empty() {
        reader.fault(file, &place, "is empty", "give every marker a name of its own");
    } else if let Some(first) = seen.insert(id.to_owned(), line) {
        let problem = format!("\"{id}\" stands on line {first} already");
        reader.fault(file, &place, problem, "give every marker a name of its own");
    }
}

fn marker(reader: &mut Reader, file: &Path, line: u64, cells: &[String; 8]) -> Option<SurveyMarker> {
    let shape = match cells[1].as_str() {
        "quadrant" => Some(Shape::Quadrant),
        "circle" => Some(Shape::Circle),
        other => {
            let place = format!("line {line}, column shape");
            reader.fault(file, &place, format!("\"{other}\" is not known"), "write quadrant or circle");
            None
        }
    };
    let mut cell = |k: usize| number(reader, file, line, COLUMNS[k], &cells[k]);
    let (diameter, x, y, z, sigma) = (cell(2), cell(3), cell(4), cell(5), cell(6));
    let (diameter_m, sigma_m) = (diameter?, sigma?);
    for (column, value, low, high) in
        [("diameter_m", diameter_m, 0.001, 10.0), ("sigma_m", sigma_m, 1e-6, 10.0)]
    {
        if !(low..=high).contains(&value) {
            let place = format!("line {line}, column {column}");
            reader.fault(
                file,
                &place,
                format!("is {value:?} m"),
                format!("give a number from {low} to {high} m"),
            );
        }
    }
    let fixed = match cells[7].as_str() {
        "yes" => true,
        "" | "no" => false,
        other => {
            let place = format!("line {line}, column {FIXED}");
            let mend = "write yes for a mark that is rigid to the cabin, no or nothing for one on the wing";
            reader.fault(file, &place, format!("\"{other}\" is not known"), mend);
            return None;
        }
    };
    let position_m = Vector3::new(x?, y?, z?);
    Some(SurveyMarker { id: cells[0].clone(), shape: shape?, diameter_m, position_m, sigma_m, fixed })
}
