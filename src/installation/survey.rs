//! `survey.csv`: the markers as the tachymeter found them.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::Vector3;

use super::{Reader, rows};
use crate::measure::setup::{Shape, SurveyMarker, fixed_mark};

const COLUMNS: [&str; 10] =
    ["id", "shape", "diameter_m", "x_m", "y_m", "z_m", "sigma_m", FIXED, PART, MOTION];
/// A column that need not be there: `yes` for a mark that is rigid to the cabin.
const FIXED: &str = "fixed";
/// Another: the moving part of the wing that the marker sits on.
const PART: &str = "part";
/// What stands there for the wing itself, as nothing does.
const WING: &str = "wing";
/// Another: how far a fixed mark moves in flight, m.
const MOTION: &str = "flight_motion_m";

pub(super) fn read(reader: &mut Reader, name: &str) -> Option<Vec<SurveyMarker>> {
    let (file, text) = reader.text(name, "name the survey in wing.survey of installation.toml")?;
    let lines = rows::read(reader, &file, &text, COLUMNS, &[FIXED, PART, MOTION])?;
    if lines.is_empty() {
        reader.fault(&file, "file", "holds no marker", "add one line per surveyed marker");
        return None;
    }
    let before = reader.faults.len();
    let mut seen: HashMap<String, u64> = HashMap::new();
    let mut markers = vec![];
    for (line, cells) in lines {
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

/// What moves in flight: by how much a fixed mark, and which part of the wing.
fn check_motion(
    reader: &mut Reader,
    file: &Path,
    line: u64,
    fixed: bool,
    (motion_m, part): (f64, Option<&str>),
) {
    if !(0.0..=1.0).contains(&motion_m) {
        let mend = "give a number from 0 to 1 m, or nothing";
        reader.fault(file, &format!("line {line}, column {MOTION}"), format!("is {motion_m:?} m"), mend);
    }
    if !fixed && motion_m > 0.0 {
        let mend = "leave it empty: of markers on the wing wing.skin_motion_m of installation.toml says it";
        let problem = "is given for a marker that is not fixed";
        reader.fault(file, &format!("line {line}, column {MOTION}"), problem, mend);
    }
    if let Some(part) = part.filter(|_| fixed) {
        let mend = "leave part empty, or write no under fixed";
        reader.fault(
            file,
            &format!("line {line}, column {PART}"),
            format!("is \"{part}\" for a fixed mark"),
            mend,
        );
    }
}

fn marker(reader: &mut Reader, file: &Path, line: u64, cells: &[String; 10]) -> Option<SurveyMarker> {
    let shape = match cells[1].as_str() {
        "quadrant" => Some(Shape::Quadrant),
        "circle" => Some(Shape::Circle),
        other => {
            let place = format!("line {line}, column shape");
            reader.fault(file, &place, format!("\"{other}\" is not known"), "write quadrant or circle");
            None
        }
    };
    let mut cell = |k: usize| rows::number(reader, file, line, COLUMNS[k], &cells[k]);
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
    let flight_motion_m = match cells[9].as_str() {
        "" if fixed => fixed_mark::FLIGHT_MOTION_M,
        "" => 0.0,
        text => rows::number(reader, file, line, MOTION, text)?,
    };
    let part = Some(cells[8].as_str()).filter(|part| !part.is_empty() && *part != WING).map(str::to_owned);
    check_motion(reader, file, line, fixed, (flight_motion_m, part.as_deref()));
    let (id, shape) = (cells[0].clone(), shape?);
    Some(SurveyMarker { id, shape, diameter_m, position_m, sigma_m, fixed, flight_motion_m, part })
}
