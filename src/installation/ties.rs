//! `tie_points.csv`: points known in the survey frame and in the CAD model's.

use nalgebra::Vector3;

use super::toml_file::FILE;
use super::{Reader, rows, tables};
use crate::measure::geometry::{PointPair, TransformFit};
use crate::measure::setup::{Setup, TiePoint};

const COLUMNS: [&str; 7] = ["id", "x_m", "y_m", "z_m", "cad_x_m", "cad_y_m", "cad_z_m"];
/// Standard deviation of a tie point's coordinate where the user gives none, m.
const DEFAULT_SIGMA_M: f64 = 0.005;

pub(super) fn read(reader: &mut Reader, cad: &tables::Cad) -> Option<Vec<TiePoint>> {
    let (file, text) =
        reader.text(&cad.tie_points, "name the file in cad.tie_points of installation.toml")?;
    let lines = rows::read(reader, &file, &text, COLUMNS, &[])?;
    let sigma_m = cad.sigma_m.unwrap_or(DEFAULT_SIGMA_M);
    if !(1e-6..=10.0).contains(&sigma_m) {
        let installation = reader.directory.join(FILE);
        reader.fault(
            &installation,
            "cad.sigma_m",
            format!("is {sigma_m} m"),
            "give a number from 1e-6 to 10 m",
        );
    }
    let before = reader.faults.len();
    let mut points: Vec<TiePoint> = vec![];
    for (line, cells) in lines {
        if points.iter().any(|p| p.id == cells[0]) {
            let place = format!("line {line}, column id");
            reader.fault(
                &file,
                &place,
                format!("\"{}\" stands twice", cells[0]),
                "give every tie point a name of its own",
            );
        }
        let v: Vec<Option<f64>> =
            (1..7).map(|k| rows::number(reader, &file, line, COLUMNS[k], &cells[k])).collect();
        if let [Some(x), Some(y), Some(z), Some(cx), Some(cy), Some(cz)] = v[..] {
            let (survey_m, cad_m) = (Vector3::new(x, y, z), Vector3::new(cx, cy, cz));
            points.push(TiePoint { id: cells[0].clone(), survey_m, cad_m, sigma_m });
        }
    }
    if points.len() < 3 && reader.faults.len() == before {
        let problem = format!("holds {} tie points", points.len());
        reader.fault(&file, "file", problem, "a transform needs at least 3 that are not on one line");
    }
    (reader.faults.len() == before).then_some(points)
}

/// The transform that the tie points give; a fault where they give none.
pub(super) fn transform(reader: &mut Reader, setup: &Setup) -> Option<TransformFit> {
    if setup.tie_points.is_empty() {
        return None;
    }
    let pair = |t: &TiePoint| PointPair { source_m: t.survey_m, target_m: t.cad_m, sigma_m: t.sigma_m };
    let pairs: Vec<PointPair> = setup.tie_points.iter().map(pair).collect();
    match TransformFit::estimate(&pairs, setup.cad_similarity) {
        Ok(fit) => Some(fit),
        Err(error) => {
            let installation = reader.directory.join(FILE);
            let mend = "correct the tie points, or leave [cad] out";
            reader.fault(&installation, "cad.tie_points", error.to_string(), mend);
            None
        }
    }
}
