//! `tie_points.csv`: points known in the survey frame and in the CAD frame.

use nalgebra::Vector3;

use super::toml_file::INSTALLATION_FILE;
use super::{Reader, rows, tables};
use crate::measure::geometry::{PointPair, TransformFit};
use crate::measure::setup::{Setup, TiePoint};

const COLUMNS: [&str; 7] = ["id", "x_m", "y_m", "z_m", "cad_x_m", "cad_y_m", "cad_z_m"];
/// Default standard deviation of a tie point's coordinate, m.
const DEFAULT_SIGMA_M: f64 = 0.005;

pub(super) fn read_tie_points(reader: &mut Reader, cad: &tables::CadTable) -> Option<Vec<TiePoint>> {
    let (file, text) = reader.read_text(&cad.tie_points, "name the file in cad.tie_points of installation.toml")?;
    let lines = rows::read_table(reader, &file, &text, COLUMNS, &[])?;
    let sigma_m = cad.sigma_m.unwrap_or(DEFAULT_SIGMA_M);
    if !(1e-6..=10.0).contains(&sigma_m) {
        let installation = reader.directory.join(INSTALLATION_FILE);
        reader.fault(&installation, "cad.sigma_m", format!("is {sigma_m} m"), "give a number from 1e-6 to 10 m");
    }
    let before = reader.faults.len();
    let mut points: Vec<TiePoint> = vec![];
    for (line, cells) in lines {
        if points.iter().any(|p| p.id == cells[0]) {
            let place = format!("line {line}, column id");
            reader.fault(&file, &place, format!("\"{}\" occurs twice", cells[0]), "give every tie point a unique name");
        }
        let v: Vec<Option<f64>> =
            (1..7).map(|k| rows::parse_number(reader, &file, line, COLUMNS[k], &cells[k])).collect();
        if let [Some(x), Some(y), Some(z), Some(cx), Some(cy), Some(cz)] = v[..] {
            let (survey_m, cad_m) = (Vector3::new(x, y, z), Vector3::new(cx, cy, cz));
            points.push(TiePoint { id: cells[0].clone(), survey_m, cad_m, sigma_m });
        }
    }
    if points.len() < 3 && reader.faults.len() == before {
        let problem = format!("has {} tie points", points.len());
        reader.fault(&file, "file", problem, "a transform needs at least 3, not on one line");
    }
    (reader.faults.len() == before).then_some(points)
}

/// Estimates the transform from the tie points; reports an error if they determine none.
pub(super) fn estimate_transform(reader: &mut Reader, setup: &Setup) -> Option<TransformFit> {
    if setup.tie_points.is_empty() {
        return None;
    }
    let pair = |t: &TiePoint| PointPair { source_m: t.survey_m, target_m: t.cad_m, sigma_m: t.sigma_m };
    let pairs: Vec<PointPair> = setup.tie_points.iter().map(pair).collect();
    match TransformFit::estimate(&pairs, setup.cad_similarity) {
        Ok(fit) => Some(fit),
        Err(error) => {
            let installation = reader.directory.join(INSTALLATION_FILE);
            let remedy = "correct the tie points, or delete [cad]";
            reader.fault(&installation, "cad.tie_points", error.to_string(), remedy);
            None
        }
    }
}
