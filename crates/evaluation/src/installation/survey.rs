//! `survey.csv`: markers surveyed with a total station.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::Vector3;

use super::Reader;
use crate::installation::{TableLine, read_table};
use wingd_measure::setup::{POINT_EXTENT_M, Shape, SurveyMarker, fixed_target};

/// Columns. The last three are optional: `yes` for a target that is fixed to the cabin, control surface of the marker (or `wing`), and
/// standard deviation of a fixed target's motion in flight.
const COLUMNS: [&str; 10] = [
    "id",
    "shape",
    "diameter_m",
    "x_m",
    "y_m",
    "z_m",
    "sigma_m",
    "fixed",
    "part",
    "flight_motion_m",
];

pub(super) fn read_survey(
    reader: &mut Reader,
    name: &str,
    centre_m: &Vector3<f64>,
) -> Option<Vec<SurveyMarker>> {
    let remedy = "name the survey in wing.survey of installation.toml";
    let (file, lines) = read_table(reader, name, remedy, COLUMNS, &COLUMNS[7..])?;
    if lines.is_empty() {
        reader.fault(
            &file,
            "file",
            "has no markers",
            "add one line per surveyed marker",
        );
        return None;
    }
    let before = reader.faults.len();
    let mut seen: HashMap<String, u64> = HashMap::new();
    let mut markers = vec![];
    for line in lines {
        check_id(reader, &line, &mut seen);
        markers.extend(parse_marker(reader, &line, centre_m));
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
        let problem = format!(
            "is {} m for {} of {} markers, {} first",
            first.sigma_m,
            coarse.len(),
            markers.len(),
            first.id
        );
        let remedy = format!("give metres, at most {MAX_SIGMA_M}: 0.002 for 2 mm");
        reader.fault(file, "column sigma_m", problem, remedy);
    }
}

fn check_id(reader: &mut Reader, line: &TableLine<10>, seen: &mut HashMap<String, u64>) {
    let (id, remedy) = (&line.cells[0], "give every marker a unique name");
    if id.is_empty() {
        line.cell_fault(reader, 0, "is empty", remedy);
    } else if let Some(first) = seen.insert(id.clone(), line.number) {
        let problem = format!("\"{id}\" is already on line {first}");
        line.cell_fault(reader, 0, problem, remedy);
    }
}

/// Checks that only a fixed target has a motion, of 0 to 1 m, and only a marker on the wing a part.
fn check_motion_and_part(reader: &mut Reader, line: &TableLine<10>, marker: &SurveyMarker) {
    let motion_m = marker.flight_motion_m;
    if !(0.0..=1.0).contains(&motion_m) {
        line.cell_fault(
            reader,
            9,
            format!("is {motion_m:?} m"),
            "give a number from 0 to 1 m, or nothing",
        );
    }
    if !marker.fixed && motion_m > 0.0 {
        let remedy =
            "leave it empty: for markers on the wing, set wing.skin_motion_m in installation.toml";
        line.cell_fault(reader, 9, "is given for a marker that is not fixed", remedy);
    }
    if let Some(part) = marker.part.as_ref().filter(|_| marker.fixed) {
        let remedy = "leave part empty, or write no under fixed";
        line.cell_fault(
            reader,
            8,
            format!("is \"{part}\" for a fixed target"),
            remedy,
        );
    }
}

/// Parses the diameter of a decal, m; a point has none.
fn parse_diameter(reader: &mut Reader, line: &TableLine<10>, shape: Shape) -> Option<f64> {
    let cell = &line.cells[2];
    if shape == Shape::Point {
        if !cell.is_empty() {
            let remedy = "leave it empty, or write the shape of the decal: quadrant or circle";
            line.cell_fault(
                reader,
                2,
                format!("is \"{cell}\" for a point, which has no decal"),
                remedy,
            );
        }
        return Some(POINT_EXTENT_M);
    }
    let diameter_m = line.parse_number(reader, 2)?;
    if !(0.001..=10.0).contains(&diameter_m) {
        let remedy = "give a number from 0.001 to 10 m: metres, not inches or millimetres";
        line.cell_fault(reader, 2, format!("is {diameter_m:?} m"), remedy);
    }
    Some(diameter_m)
}

fn parse_marker(
    reader: &mut Reader,
    line: &TableLine<10>,
    centre_m: &Vector3<f64>,
) -> Option<SurveyMarker> {
    let [id, shape, .., fixed, part, motion] = &line.cells;
    let shape = match shape.as_str() {
        "quadrant" => Shape::Quadrant,
        "circle" => Shape::Circle,
        "point" => Shape::Point,
        other => {
            line.cell_fault(
                reader,
                1,
                format!("\"{other}\" is not known"),
                "write quadrant, circle or point",
            );
            // The other faults of the line are reported too.
            Shape::Circle
        }
    };
    let diameter = parse_diameter(reader, line, shape);
    let [x, y, z, sigma] = std::array::from_fn(|k| line.parse_number(reader, 3 + k));
    let (diameter_m, sigma_m) = (diameter?, sigma?);
    line.check_range(reader, 6, sigma_m, 1e-6..=10.0, "m");
    let fixed = match fixed.as_str() {
        "yes" => true,
        "" | "no" => false,
        other => {
            let remedy =
                "write yes for a target fixed to the cabin, no or nothing for a marker on the wing";
            line.cell_fault(reader, 7, format!("\"{other}\" is not known"), remedy);
            return None;
        }
    };
    let position_m = Vector3::new(x?, y?, z?);
    let flight_motion_m = match motion.as_str() {
        "" if fixed => fixed_target::flight_motion_m((position_m - centre_m).norm()),
        "" => 0.0,
        _ => line.parse_number(reader, 9)?,
    };
    let part = Some(part)
        .filter(|part| !part.is_empty() && *part != "wing")
        .cloned();
    let marker = SurveyMarker {
        id: id.clone(),
        shape,
        diameter_m,
        position_m,
        sigma_m,
        fixed,
        flight_motion_m,
        part,
    };
    check_motion_and_part(reader, line, &marker);
    Some(marker)
}
