//! Tables of stations along the bending axis, alone or with the shape that a computation predicts.

use std::path::Path;

use super::{Fault, Reader, read_table};

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
/// Longest wing, m.
const MAX_LENGTH_M: f64 = 100.0;

/// Station with the quantities of [`STATION_COLUMNS`] after the first, as far as the table has them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedStation {
    /// Arc length from the bending root along the axis on the ground, m.
    pub arc_length_m: f64,
    pub values: [Option<f64>; STATION_COLUMNS.len() - 1],
}

/// Reads a table of stations in any directory, from root to tip.
///
/// # Errors
/// Returns the faults of the table: no stations, a cell that is not a number, stations that are not in order.
pub fn read_stations(file: &Path) -> Result<Vec<PredictedStation>, Vec<Fault>> {
    Reader::read_file(file, |reader, name| {
        let remedy = format!("name a table with a column {}", STATION_COLUMNS[0]);
        let (file, lines) = read_table(reader, name, &remedy, STATION_COLUMNS, &STATION_COLUMNS[1..])?;
        let before = reader.faults.len();
        if lines.is_empty() {
            reader.fault(&file, "file", "has no stations", "add one line per station along the span");
        }
        let mut stations: Vec<PredictedStation> = vec![];
        for line in &lines {
            let Some(arc_length_m) = line.parse_number(reader, 0) else { continue };
            if !(0.0..=MAX_LENGTH_M).contains(&arc_length_m) {
                let remedy = format!("give the arc length from the bending root, 0 to {MAX_LENGTH_M} m");
                line.cell_fault(reader, 0, format!("{arc_length_m}"), &remedy);
            }
            if stations.last().is_some_and(|last| arc_length_m <= last.arc_length_m) {
                let remedy = "order the stations from the root to the tip, each once";
                line.cell_fault(reader, 0, format!("{arc_length_m} m is not outboard of the previous line"), remedy);
            }
            let filled = |k: &usize| !line.cells[*k].is_empty();
            let mut values = [None; STATION_COLUMNS.len() - 1];
            (1..STATION_COLUMNS.len()).filter(filled).for_each(|k| values[k - 1] = line.parse_number(reader, k));
            stations.push(PredictedStation { arc_length_m, values });
        }
        (reader.faults.len() == before).then_some(stations)
    })
}
