//! Image points measured by hand: `id,u_px,v_px,sigma_px`, and `image` where they are of several pictures.

use std::path::Path;

use nalgebra::Vector2;

use super::{Fault, Reader, rows};
use crate::measure::setup::Setup;

const COLUMNS: [&str; 5] = ["id", "u_px", "v_px", "sigma_px", IMAGE];
/// Need not be there.
const IMAGE: &str = "image";

/// One marker as a person marked it.
#[derive(Clone, Debug, PartialEq)]
pub struct HandObservation {
    /// The picture it is of, by the name that results give it; `None` where the file does not say.
    pub image: Option<String>,
    /// Index in [`Setup::markers`].
    pub marker: usize,
    /// Image of the marker's centre, px.
    pub pixel: Vector2<f64>,
    /// Standard deviation of each coordinate, px.
    pub sigma_px: f64,
}

/// Reads a file of hand measurements against the survey.
pub fn read_observations(file: &Path, setup: &Setup) -> Result<Vec<HandObservation>, Vec<Fault>> {
    let (mut reader, name) = Reader::of_file(file);
    let found = read(&mut reader, &name, setup);
    found.filter(|_| reader.faults.is_empty()).ok_or_else(|| super::folded(reader.faults))
}

fn read(reader: &mut Reader, name: &str, setup: &Setup) -> Option<Vec<HandObservation>> {
    let (file, text) = reader.text(name, "name a file with the columns id,u_px,v_px,sigma_px")?;
    let lines = rows::read(reader, &file, &text, COLUMNS, &[IMAGE])?;
    let mut found: Vec<HandObservation> = vec![];
    for (line, cells) in lines {
        let place = format!("line {line}, column id");
        let marker = setup.markers.iter().position(|m| m.id == cells[0]);
        let image = Some(cells[4].clone()).filter(|name| !name.is_empty());
        match marker {
            None => {
                let problem = format!("marker \"{}\" is not in the survey", cells[0]);
                reader.fault(&file, &place, problem, "name a marker of the survey");
            }
            Some(m) if found.iter().any(|o| o.marker == m && o.image == image) => {
                reader.fault(
                    &file,
                    &place,
                    format!("\"{}\" stands twice", cells[0]),
                    "keep one line per marker and picture",
                );
            }
            Some(_) => {}
        }
        let v: Vec<Option<f64>> =
            (1..4).map(|k| rows::number(reader, &file, line, COLUMNS[k], &cells[k])).collect();
        let ([Some(u), Some(v), Some(sigma_px)], Some(marker)) = (&v[..], marker) else { continue };
        if !(1e-4..=1e3).contains(sigma_px) {
            let place = format!("line {line}, column sigma_px");
            reader.fault(
                &file,
                &place,
                format!("is {sigma_px:?} px"),
                "give a number from 0.0001 to 1000 px",
            );
        }
        let lens = &setup.lens;
        if !lens.contains(&Vector2::new(*u, *v)) {
            let problem = format!(
                "\"{}\" is at ({u}, {v}) px, outside the image of {} x {} px",
                cells[0], lens.width, lens.height
            );
            reader.fault(&file, &format!("line {line}"), problem, "measure it again, or leave the line out");
        }
        found.push(HandObservation { image, marker, pixel: Vector2::new(*u, *v), sigma_px: *sigma_px });
    }
    Some(found)
}
