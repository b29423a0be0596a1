//! `survey.csv`: markers surveyed with a total station.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::Vector3;

use super::{Reader, rows};
use crate::measure::setup::{Shape, SurveyMarker, fixed_target};

const COLUMNS: [&str; 10] =
    ["id", "shape", "diameter_m", "x_m", "y_m", "z_m", "sigma_m", FIXED_COLUMN, PART_COLUMN, MOTION_COLUMN];
/// Optional column: `yes` for a target that is fixed to the cabin.
const FIXED_COLUMN: &str = "fixed";
/// Optional column: control surface that the marker is on.
const PART_COLUMN: &str = "part";
/// Value of the part column for the wing itself, equivalent to an empty cell.
const WING_PART: &str = "wing";
/// Optional column: standard deviation of a fixed target's motion in flight, m.
const MOTION_COLUMN: &str = "flight_motion_m";

pub(super) fn read_survey(reader: &mut Reader, name: &str) -> Option<Vec<SurveyMarker>> {
    let (file, text) = reader.read_text(name, "name the survey in wing.survey of installation.toml")?;
    let lines = rows::read_table(reader, &file, &text, COLUMNS, &[FIXED_COLUMN, PART_COLUMN, MOTION_COLUMN])?;
    if lines.is_empty() {
        reader.fault(&file, "file", "has no markers", "add one line per surveyed marker");
        return None;
    }
    let before = reader.faults.len();
    let mut seen: HashMap<String, u64> = HashMap::new();
    let mut markers = vec![];
    for (line, cells) in lines {
        check_id(reader, &file, line, &cells[0], &mut seen);
        if let Some(marker) = parse_marker(reader, &file, line, &cells) {
            markers.push(marker);
        }
    }
    check_sigmas(reader, &file, &markers);
    (reader.faults.len() == before).then_some(markers)
}

/// Largest plausible standard deviation of a survey, m: a tape along the wing reaches some centimetres.
const MAX_SIGMA_M: f64 = 0.5;

/// Reports standard deviations that are probably in millimetres, once for all lines.
fn check_sigmas(reader: &mut Reader, file: &Path, markers: &[SurveyMarker]) {
    let coarse: Vec<&SurveyMarker> = markers.iter().filter(|m| m.sigma_m > MAX_SIGMA_M).collect();
    if let Some(first) = coarse.first() {
        let problem =
            format!("is {} m for {} of {} markers, {} first", first.sigma_m, coarse.len(), markers.len(), first.id);
        let remedy = format!("give metres, at most {MAX_SIGMA_M}: 0.002 for 2 mm");
        reader.fault(file, "column sigma_m", problem, remedy);
    }
}

fn check_id(reader: &mut Reader, file: &Path, line: u64, id: &str, seen: &mut HashMap<String, u64>) {
    let place = format!("line {line}, column id");
    if id.is_empty() {
        reader.fault(file, &place, "is empty", "give every marker a unique name");
    } else if let Some(first) = seen.insert(id.to_owned(), line) {
        let problem = format!("\"{id}\" is already on line {first}");
        reader.fault(file, &place, problem, "give every marker a unique name");
    }
}

/// Checks that only a fixed target has a motion, of 0 to 1 m, and only a marker on the wing a part.
fn check_motion_and_part(
    reader: &mut Reader,
    file: &Path,
    line: u64,
    fixed: bool,
    (motion_m, part): (f64, Option<&str>),
) {
    if !(0.0..=1.0).contains(&motion_m) {
        let remedy = "give a number from 0 to 1 m, or nothing";
        reader.fault(file, &format!("line {line}, column {MOTION_COLUMN}"), format!("is {motion_m:?} m"), remedy);
    }
    if !fixed && motion_m > 0.0 {
        let remedy = "leave it empty: for markers on the wing, set wing.skin_motion_m in installation.toml";
        let problem = "is given for a marker that is not fixed";
        reader.fault(file, &format!("line {line}, column {MOTION_COLUMN}"), problem, remedy);
    }
    if let Some(part) = part.filter(|_| fixed) {
        let remedy = "leave part empty, or write no under fixed";
        reader.fault(
            file,
            &format!("line {line}, column {PART_COLUMN}"),
            format!("is \"{part}\" for a fixed target"),
            remedy,
        );
    }
}

fn parse_marker(reader: &mut Reader, file: &Path, line: u64, cells: &[String; 10]) -> Option<SurveyMarker> {
    let shape = match cells[1].as_str() {
        "quadrant" => Some(Shape::Quadrant),
        "circle" => Some(Shape::Circle),
        other => {
            let place = format!("line {line}, column shape");
            reader.fault(file, &place, format!("\"{other}\" is not known"), "write quadrant or circle");
            None
        }
    };
    let mut cell = |k: usize| rows::parse_number(reader, file, line, COLUMNS[k], &cells[k]);
    let (diameter, x, y, z, sigma) = (cell(2), cell(3), cell(4), cell(5), cell(6));
    let (diameter_m, sigma_m) = (diameter?, sigma?);
    for (column, value, low, high) in [("diameter_m", diameter_m, 0.001, 10.0), ("sigma_m", sigma_m, 1e-6, 10.0)] {
        if !(low..=high).contains(&value) {
            let place = format!("line {line}, column {column}");
            reader.fault(file, &place, format!("is {value:?} m"), format!("give a number from {low} to {high} m"));
        }
    }
    let fixed = match cells[7].as_str() {
        "yes" => true,
        "" | "no" => false,
        other => {
            let place = format!("line {line}, column {FIXED_COLUMN}");
            let remedy = "write yes for a target fixed to the cabin, no or nothing for a marker on the wing";
            reader.fault(file, &place, format!("\"{other}\" is not known"), remedy);
            return None;
        }
    };
    let position_m = Vector3::new(x?, y?, z?);
    let flight_motion_m = match cells[9].as_str() {
        "" if fixed => fixed_target::FLIGHT_MOTION_M,
        "" => 0.0,
        text => rows::parse_number(reader, file, line, MOTION_COLUMN, text)?,
    };
    let part = Some(cells[8].as_str()).filter(|part| !part.is_empty() && *part != WING_PART).map(str::to_owned);
    check_motion_and_part(reader, file, line, fixed, (flight_motion_m, part.as_deref()));
    let (id, shape) = (cells[0].clone(), shape?);
    Some(SurveyMarker { id, shape, diameter_m, position_m, sigma_m, fixed, flight_motion_m, part })
}
