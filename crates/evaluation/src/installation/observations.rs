//! Image points measured manually: `id,u_px,v_px,sigma_px`, and `image` if they are of several images.

use std::path::Path;

use nalgebra::{Matrix2, Vector2};

use super::Reader;
use crate::installation::{TableLine, read_table};
use wingd_base::fault::Fault;
use wingd_base::text::text_cell;
use wingd_measure::setup::Setup;

const COLUMNS: [&str; 9] = [
    "id",
    "u_px",
    "v_px",
    "sigma_px",
    "image",
    "sigma_v_px",
    "who",
    "when",
    "why",
];
/// Columns that may be missing: all but the first four.
const OPTIONAL_COLUMNS: &[&str] = &["image", "sigma_v_px", "who", "when", "why"];
/// Allowed standard deviations of manual measurements, px.
const SIGMAS_PX: std::ops::RangeInclusive<f64> = 1e-4..=1e3;

/// Standard deviation of the place of a point if the file gives none, px: a person who sees a corner in a loupe.
pub const POINT_SIGMA_PX: f64 = 0.5;

/// Manual observation or rejection of one marker in one image.
#[derive(Clone, Debug, PartialEq)]
pub struct ManualObservation {
    /// Name of the image, as in results; `None` if the file does not name it.
    pub image: Option<String>,
    /// Index in [`Setup::markers`].
    pub marker: usize,
    /// Position of the centre; `None` if the person rejects the detection of the marker.
    pub place: Option<ManualPosition>,
    /// Person, time and reason, as written; empty if not given.
    pub note: [String; 3],
}

/// Centre of a marker, marked manually.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ManualPosition {
    /// Image of the marker's centre, px.
    pub pixel: Vector2<f64>,
    /// Covariance of the position, px^2.
    pub covariance_px2: Matrix2<f64>,
}

/// Reads a file of manual measurements and checks it against the survey.
///
/// # Errors
/// Returns all errors of the file, with line and remedy.
pub fn read_observations(file: &Path, setup: &Setup) -> Result<Vec<ManualObservation>, Vec<Fault>> {
    Reader::read_file(file, |reader, name| parse_observations(reader, name, setup))
}

/// Formats observations as a file that [`read_observations`] reads; of covariances only the diagonal is written.
///
/// # Errors
/// Returns an error if a line cannot be written as a record of a table.
pub fn observations_text(
    observations: &[ManualObservation],
    setup: &Setup,
) -> std::io::Result<Vec<u8>> {
    let mut csv = csv::Writer::from_writer(vec![]);
    csv.write_record(COLUMNS)?;
    for o in observations {
        let number = |value: &dyn Fn(&ManualPosition) -> f64| {
            o.place
                .as_ref()
                .map_or(String::new(), |p| value(p).to_string())
        };
        let id = setup.markers.get(o.marker).map_or("", |m| m.id.as_str());
        let [id, image, who, when, why] = [
            id,
            o.image.as_deref().unwrap_or_default(),
            &o.note[0],
            &o.note[1],
            &o.note[2],
        ]
        .map(text_cell);
        csv.write_record([
            &*id,
            &number(&|p| p.pixel.x),
            &number(&|p| p.pixel.y),
            &number(&|p| p.covariance_px2[(0, 0)].sqrt()),
            &image,
            &number(&|p| p.covariance_px2[(1, 1)].sqrt()),
            &who,
            &when,
            &why,
        ])?;
    }
    csv.into_inner()
        .map_err(|error| std::io::Error::other(error.to_string()))
}

fn parse_observations(
    reader: &mut Reader,
    name: &Path,
    setup: &Setup,
) -> Option<Vec<ManualObservation>> {
    let remedy = "name a file with the columns id,u_px,v_px,sigma_px";
    let (_, lines) = read_table(reader, name, remedy, COLUMNS, OPTIONAL_COLUMNS)?;
    let mut found: Vec<ManualObservation> = vec![];
    for line in lines {
        let id = &line.cells[0];
        let marker = setup.markers.iter().position(|m| m.id == *id);
        let image = Some(line.cells[4].clone()).filter(|name| !name.is_empty());
        match marker {
            None => {
                let problem = format!("marker \"{id}\" is not in the survey");
                line.cell_fault(reader, 0, problem, "name a marker of the survey");
            }
            Some(m) if found.iter().any(|o| o.marker == m && o.image == image) => {
                line.cell_fault(
                    reader,
                    0,
                    format!("\"{id}\" occurs twice"),
                    "keep one line per marker and image",
                );
            }
            Some(_) => {}
        }
        // A line without a position rejects the marker.
        let place = if line.cells[1..4].iter().all(String::is_empty) {
            None
        } else {
            let is_point = marker.is_some_and(|m| setup.is_point(m));
            let Some(place) = parse_position(reader, &line, setup, is_point) else {
                continue;
            };
            Some(place)
        };
        let [.., who, when, why] = line.cells;
        found.extend(marker.map(|marker| ManualObservation {
            image,
            marker,
            place,
            note: [who, when, why],
        }));
    }
    Some(found)
}

fn parse_position(
    reader: &mut Reader,
    line: &TableLine<9>,
    setup: &Setup,
    is_point: bool,
) -> Option<ManualPosition> {
    let [u, v, sigma_u] = if is_point && line.cells[3].is_empty() {
        let [u, v] = line.parse_numbers(reader, 1)?;
        [u, v, POINT_SIGMA_PX]
    } else {
        line.parse_numbers(reader, 1)?
    };
    let sigma_v = if line.cells[5].is_empty() {
        sigma_u
    } else {
        line.parse_number(reader, 5)?
    };
    let sigmas = [(3, sigma_u), (5, sigma_v)];
    // Both have one value if the second is not given.
    if let Some((k, sigma)) = sigmas
        .into_iter()
        .find(|(_, sigma)| !SIGMAS_PX.contains(sigma))
    {
        line.check_range(reader, k, sigma, SIGMAS_PX, "px");
    }
    let (lens, pixel) = (&setup.lens, Vector2::new(u, v));
    if !lens.contains(&pixel) {
        let id = &line.cells[0];
        let problem = format!(
            "\"{id}\" is at ({u}, {v}) px, outside the image of {} x {} px",
            lens.width, lens.height
        );
        line.fault(reader, problem, "measure it again, or delete the line");
    }
    let covariance_px2 = Matrix2::new(sigma_u * sigma_u, 0.0, 0.0, sigma_v * sigma_v);
    Some(ManualPosition {
        pixel,
        covariance_px2,
    })
}
