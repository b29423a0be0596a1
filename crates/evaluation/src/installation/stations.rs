//! Tables of stations along the bending axis.

use std::path::Path;

use super::{Fault, Reader, read_table};

/// Column of the arc length from the bending root on the ground.
const ARC_LENGTH: &str = "arc_length_m";
/// Longest wing, m.
const MAX_LENGTH_M: f64 = 100.0;

/// Reads the arc lengths of a table of stations in any directory, from root to tip, m.
///
/// # Errors
/// Returns the faults of the table: no stations, a cell that is not a number, stations that are not in order.
pub fn read_stations(file: &Path) -> Result<Vec<f64>, Vec<Fault>> {
    Reader::read_file(file, |reader, name| {
        let remedy = format!("name a table with a column {ARC_LENGTH}");
        let (file, lines) = read_table(reader, name, &remedy, [ARC_LENGTH], &[])?;
        let before = reader.faults.len();
        if lines.is_empty() {
            reader.fault(
                &file,
                "file",
                "has no stations",
                "add one line per station along the span",
            );
        }
        let mut stations: Vec<f64> = vec![];
        for line in &lines {
            let Some(arc_length_m) = line.parse_number(reader, 0) else {
                continue;
            };
            if !(0.0..=MAX_LENGTH_M).contains(&arc_length_m) {
                let remedy =
                    format!("give the arc length from the bending root, 0 to {MAX_LENGTH_M} m");
                line.cell_fault(reader, 0, format!("{arc_length_m}"), &remedy);
            }
            if stations.last().is_some_and(|last| arc_length_m <= *last) {
                let remedy = "order the stations from the root to the tip, each once";
                line.cell_fault(
                    reader,
                    0,
                    format!("{arc_length_m} m is not outboard of the previous line"),
                    remedy,
                );
            }
            stations.push(arc_length_m);
        }
        (reader.faults.len() == before).then_some(stations)
    })
}
