//! Tables of stations along the bending axis, alone or with the shape that a computation predicts.

use std::path::Path;

use super::Reader;
use crate::installation::read_table;
use wingd_base::fault::Fault;

/// Columns: arc length from the bending root on the ground, then the predicted quantities, which are optional.
pub const STATION_COLUMNS: [&str; 7] = [
    "arc_length_m",
    "displacement_x_m",
    "displacement_y_m",
    "displacement_z_m",
    "slope_deg",
    "twist_deg",
    "streamwise_twist_deg",
];
/// Optional columns with the standard deviations of the predicted quantities, independent from station to station.
const SIGMA_COLUMNS: [&str; 6] = [
    "sigma_displacement_x_m",
    "sigma_displacement_y_m",
    "sigma_displacement_z_m",
    "sigma_slope_deg",
    "sigma_twist_deg",
    "sigma_streamwise_twist_deg",
];
/// Number of predicted quantities.
pub const PREDICTED_COUNT: usize = SIGMA_COLUMNS.len();
/// Longest wing, m.
const MAX_LENGTH_M: f64 = 100.0;

/// Station with the quantities of [`STATION_COLUMNS`] after the first, as far as the table has them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedStation {
    /// Arc length from the bending root along the axis on the ground, m.
    pub arc_length_m: f64,
    pub values: [Option<f64>; PREDICTED_COUNT],
    /// Standard deviations of the quantities.
    pub sigmas: [Option<f64>; PREDICTED_COUNT],
}

/// Reads a table of stations in any directory, from root to tip.
///
/// # Errors
/// Returns the faults of the table: no stations, a cell that is not a number, stations that are not in order.
pub fn read_stations(file: &Path) -> Result<Vec<PredictedStation>, Vec<Fault>> {
    Reader::read_file(file, |reader, name| {
        let remedy = format!("name a table with a column {}", STATION_COLUMNS[0]);
        let mut columns = [STATION_COLUMNS[0]; 1 + 2 * PREDICTED_COUNT];
        columns[1..=PREDICTED_COUNT].copy_from_slice(&STATION_COLUMNS[1..]);
        columns[1 + PREDICTED_COUNT..].copy_from_slice(&SIGMA_COLUMNS);
        let (file, lines) = read_table(reader, name, &remedy, columns, &columns[1..])?;
        let before = reader.faults.len();
        if lines.is_empty() {
            reader.fault(
                &file,
                "file",
                "has no stations",
                "add one line per station along the span",
            );
        }
        let mut stations: Vec<PredictedStation> = vec![];
        for line in &lines {
            let Some(arc_length_m) = line.parse_number(reader, 0) else {
                continue;
            };
            if !(0.0..=MAX_LENGTH_M).contains(&arc_length_m) {
                let remedy =
                    format!("give the arc length from the bending root, 0 to {MAX_LENGTH_M} m");
                line.cell_fault(reader, 0, format!("{arc_length_m}"), &remedy);
            }
            if stations
                .last()
                .is_some_and(|last| arc_length_m <= last.arc_length_m)
            {
                let remedy = "order the stations from the root to the tip, each once";
                line.cell_fault(
                    reader,
                    0,
                    format!("{arc_length_m} m is not outboard of the previous line"),
                    remedy,
                );
            }
            let mut read = |first: usize| {
                std::array::from_fn(|k| match line.cells[first + k].is_empty() {
                    true => None,
                    false => line.parse_number(reader, first + k),
                })
            };
            let (values, sigmas): (_, [Option<f64>; PREDICTED_COUNT]) =
                (read(1), read(1 + PREDICTED_COUNT));
            if let Some(k) = sigmas
                .iter()
                .position(|sigma| sigma.is_some_and(|sigma| sigma < 0.0))
            {
                let problem = "is a negative standard deviation".to_owned();
                line.cell_fault(
                    reader,
                    1 + PREDICTED_COUNT + k,
                    problem,
                    "give 0 or a positive number",
                );
            }
            stations.push(PredictedStation {
                arc_length_m,
                values,
                sigmas,
            });
        }
        (reader.faults.len() == before).then_some(stations)
    })
}
