//! Corners of a board measured in images, for other programs and for an adjustment without the images.

use std::path::Path;

use nalgebra::{Matrix2, Vector2};

use crate::installation::Reader;
use crate::installation::read_table;
use wingd_base::fault::Fault;
use wingd_base::pending_file::write_atomically;
use wingd_measure::calibrate::{BoardPoint, BoardView};

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
/// Largest correlation of the two coordinates of a corner; above it the covariance is singular.
const MAX_CORRELATION: f64 = 0.999_999;

/// Corners of a board in one image.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageCorners {
    /// Name of the image, as in results.
    pub image: String,
    /// Width and height, px.
    pub size: (u32, u32),
    /// Measured corners.
    pub view: BoardView,
}

/// Writes the corners of all images as CSV: one line per corner with its covariance.
pub fn write_corners(file: &Path, images: &[ImageCorners]) -> std::io::Result<()> {
    let mut csv = csv::Writer::from_writer(vec![]);
    csv.write_record(COLUMNS)?;
    for (image, p) in images
        .iter()
        .flat_map(|image| image.view.iter().map(move |p| (image, p)))
    {
        let c = &p.covariance_px2;
        let (su, sv) = (c[(0, 0)].sqrt(), c[(1, 1)].sqrt());
        let correlation = if su * sv > 0.0 {
            c[(0, 1)] / (su * sv)
        } else {
            0.0
        };
        let (width, height) = image.size;
        csv.write_record([
            image.image.clone(),
            width.to_string(),
            height.to_string(),
            p.board_m.x.to_string(),
            p.board_m.y.to_string(),
            format!("{:.5}", p.pixel.x),
            format!("{:.5}", p.pixel.y),
            format!("{su:.6}"),
            format!("{sv:.6}"),
            format!("{correlation:.5}"),
        ])?;
    }
    let text = csv
        .into_inner()
        .map_err(|error| std::io::Error::other(error.to_string()))?;
    write_atomically(file, &text)
}

/// Reads a file of corners; images are in the order in which they first occur.
///
/// # Errors
/// Returns all errors, with line and column.
pub fn read_corners(file: &Path) -> Result<Vec<ImageCorners>, Vec<Fault>> {
    Reader::read_file(file, read_corners_table)
}

fn read_corners_table(reader: &mut Reader, name: &Path) -> Option<Vec<ImageCorners>> {
    let remedy = "name images, or a file that `wingd calibrate --corners` wrote";
    let (_, lines) = read_table(reader, name, remedy, COLUMNS, &[])?;
    let mut images: Vec<ImageCorners> = vec![];
    for line in lines {
        let Some([width, height, x, y, u, v, su, sv, correlation]) = line.parse_numbers(reader, 1)
        else {
            continue;
        };
        let sides = (1.0..=1e5).contains(&width) && (1.0..=1e5).contains(&height);
        let sigmas = (1e-6..=1e3).contains(&su) && (1e-6..=1e3).contains(&sv);
        if !sides || !sigmas || correlation.abs() > MAX_CORRELATION {
            let problem = "has an impossible size, standard deviation or correlation";
            line.fault(
                reader,
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
        let [image, ..] = line.cells;
        match images.iter_mut().rfind(|p| p.image == image) {
            Some(known) => known.view.push(point),
            None => images.push(ImageCorners {
                image,
                size,
                view: vec![point],
            }),
        }
    }
    Some(images)
}
