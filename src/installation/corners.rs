//! A board's corners as measured in pictures, for other programs and for adjusting again without pictures.

use std::fmt::Write as _;
use std::path::Path;

use nalgebra::{Matrix2, Vector2};

use super::{Fault, Reader, rows, write_whole};
use crate::measure::calibrate::{BoardPoint, BoardView};

const COLUMNS: [&str; 10] = [
    "image",
    "width_px",
    "height_px",
    "board_x_m",
    "board_y_m",
    "u_px",
    "v_px",
    "sigma_u_px",
    "sigma_v_px",
    "correlation",
];
/// Below it two coordinates say the same twice.
const MAX_CORRELATION: f64 = 0.999_999;

/// One picture's corners.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureCorners {
    /// As it stands in results.
    pub image: String,
    /// Width and height, px.
    pub size: (u32, u32),
    /// The corners.
    pub view: BoardView,
    /// Per corner: whether a calibration used it; empty before one.
    pub used: Vec<bool>,
}

/// Writes a line for each corner.
pub fn write_corners(file: &Path, pictures: &[PictureCorners]) -> std::io::Result<()> {
    let mut text = COLUMNS.join(",") + ",used\n";
    for picture in pictures {
        let name = if picture.image.contains([',', '"', '\n']) {
            format!("\"{}\"", picture.image.replace('"', "\"\""))
        } else {
            picture.image.clone()
        };
        for (k, p) in picture.view.iter().enumerate() {
            let used = picture.used.get(k).map_or("", |u| if *u { "yes" } else { "no" });
            let c = &p.covariance_px2;
            let (su, sv) = (c[(0, 0)].sqrt(), c[(1, 1)].sqrt());
            let correlation = if su * sv > 0.0 { c[(0, 1)] / (su * sv) } else { 0.0 };
            let _ = writeln!(
                text,
                "{name},{},{},{},{},{:.5},{:.5},{su:.6},{sv:.6},{correlation:.5},{used}",
                picture.size.0, picture.size.1, p.board_m.x, p.board_m.y, p.pixel.x, p.pixel.y,
            );
        }
    }
    write_whole(file, &text)
}

/// Reads such a file; pictures in the order in which they first stand there.
///
/// # Errors
/// Every fault, with line and column.
pub fn read_corners(file: &Path) -> Result<Vec<PictureCorners>, Vec<Fault>> {
    let (mut reader, name) = Reader::of_file(file);
    let found = read(&mut reader, &name);
    found.filter(|_| reader.faults.is_empty()).ok_or(reader.faults)
}

fn read(reader: &mut Reader, name: &Path) -> Option<Vec<PictureCorners>> {
    let mend = "name pictures, or a file that `wingd calibrate --corners` wrote";
    let (file, text) = reader.text(name, mend)?;
    let lines = rows::read(reader, &file, &text, COLUMNS, &[])?;
    let mut pictures: Vec<PictureCorners> = vec![];
    for (line, cells) in lines {
        let values: Vec<f64> = (1..COLUMNS.len())
            .filter_map(|k| rows::number(reader, &file, line, COLUMNS[k], &cells[k]))
            .collect();
        let &[width, height, x, y, u, v, su, sv, correlation] = &values[..] else { continue };
        let sides = (1.0..=1e5).contains(&width) && (1.0..=1e5).contains(&height);
        let sigmas = (1e-6..=1e3).contains(&su) && (1e-6..=1e3).contains(&sv);
        if !sides || !sigmas || correlation.abs() > MAX_CORRELATION {
            let problem = "holds a size, standard deviation or correlation that cannot be";
            reader.fault(
                &file,
                &format!("line {line}"),
                problem,
                "give px above 0, correlations between -1 and 1",
            );
            continue;
        }
        let cross = correlation * su * sv;
        let point = BoardPoint {
            board_m: Vector2::new(x, y),
            pixel: Vector2::new(u, v),
            covariance_px2: Matrix2::new(su * su, cross, cross, sv * sv),
        };
        let size = (width as u32, height as u32);
        match pictures.iter_mut().rfind(|p| p.image == cells[0]) {
            Some(picture) => picture.view.push(point),
            None => pictures.push(PictureCorners {
                image: cells[0].clone(),
                size,
                view: vec![point],
                used: vec![],
            }),
        }
    }
    Some(pictures)
}
