//! `tie_points.csv`: points known in the survey frame and in the CAD frame.

use nalgebra::Vector3;

use super::{INSTALLATION_FILE, Reader, read_table, tables};
use crate::measure::geometry::{PointPair, TransformFit};
use crate::measure::setup::{Setup, TiePoint};

/// Largest relative difference of the scales of CAD model and survey; a larger one is another unit or a gross error.
const MAX_SCALE_CHANGE: f64 = 0.05;
const COLUMNS: [&str; 7] = ["id", "x_m", "y_m", "z_m", "cad_x_m", "cad_y_m", "cad_z_m"];
/// Default standard deviation of a tie point's coordinate, m.
const DEFAULT_SIGMA_M: f64 = 0.005;

pub(super) fn read_tie_points(reader: &mut Reader, cad: &tables::CadTable) -> Option<Vec<TiePoint>> {
    let remedy = "name the file in cad.tie_points of installation.toml";
    let (file, lines) = read_table(reader, &cad.tie_points, remedy, COLUMNS, &[])?;
    let sigma_m = cad.sigma_m.unwrap_or(DEFAULT_SIGMA_M);
    let installation = reader.directory.join(INSTALLATION_FILE);
    reader.check_range(&installation, "cad.sigma_m", sigma_m, 1e-6..=10.0, "m");
    let before = reader.faults.len();
    let mut points: Vec<TiePoint> = vec![];
    for line in lines {
        let id = &line.cells[0];
        if points.iter().any(|p| p.id == *id) {
            line.cell_fault(reader, 0, format!("\"{id}\" occurs twice"), "give every tie point a unique name");
        }
        if let Some([x, y, z, cx, cy, cz]) = line.parse_numbers(reader, 1) {
            let (survey_m, cad_m) = (Vector3::new(x, y, z), Vector3::new(cx, cy, cz));
            points.push(TiePoint { id: id.clone(), survey_m, cad_m, sigma_m });
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
    let installation = reader.directory.join(INSTALLATION_FILE);
    let scale = TransformFit::estimate(&pairs, true).map_or(1.0, |fit| fit.transform.scale);
    if (scale - 1.0).abs() > MAX_SCALE_CHANGE {
        let problem = format!("the CAD coordinates are {scale:.4} times as large as the survey's");
        let remedy = "give both in metres (39.37: inches, 1000: millimetres), or correct the points";
        reader.fault(&installation, "cad.tie_points", problem, remedy);
        return None;
    }
    match TransformFit::estimate(&pairs, setup.cad_similarity) {
        Ok(fit) => Some(fit),
        Err(error) => {
            let remedy = "correct the tie points, or delete [cad]";
            reader.fault(&installation, "cad.tie_points", error.to_string(), remedy);
            None
        }
    }
}
