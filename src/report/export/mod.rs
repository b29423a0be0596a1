//! Results for other tools: one row per marker per image as CSV or Parquet, positions as VTK.

mod columns;
#[cfg(feature = "parquet")]
mod parquet_file;
mod vtk;

pub use columns::{Column, Values, columns};
#[cfg(feature = "parquet")]
pub use parquet_file::parquet;
pub use vtk::vtk;

/// The table as CSV with a heading line; what is missing is an empty field.
pub fn csv(columns: &[Column]) -> Result<String, csv::Error> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(columns.iter().map(|c| c.name.as_str()))?;
    let rows = columns.first().map_or(0, |c| c.values.len());
    for row in 0..rows {
        writer.write_record(columns.iter().map(|c| c.values.text(row)))?;
    }
    let bytes = writer.into_inner().map_err(|e| csv::Error::from(e.into_error()))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::sample;
    use super::*;

    #[test]
    fn csv_reads_back_with_every_marker_of_every_image() {
        let mut series = sample::series("s000001", 0, &[2.9, 3.1]);
        series.records.push(sample::failed("x.jpg", "dark, \"quoted\"\nand broken"));
        let text = csv(&columns(&[series])).unwrap();
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let heading = reader.headers().unwrap().clone();
        let at = |name: &str| heading.iter().position(|h| h == name).unwrap();
        let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        assert_eq!(rows.len(), 2 * 4 + 1, "four markers twice, and the failed image");
        let tip = rows.iter().find(|r| &r[at("marker")] == "M03").unwrap();
        assert_eq!(tip[at("lift_m")].parse::<f64>().unwrap(), 2.9);
        assert_eq!(tip[at("position_z_m")].parse::<f64>().unwrap(), 3.0 + 2.9);
        assert_eq!(&tip[at("torsion_tip_twist_deg")], "2.7");
        assert_eq!(&tip[at("used")], "true");
        let hidden = rows.iter().find(|r| &r[at("marker")] == "M04").unwrap();
        assert_eq!((&hidden[at("lift_m")], &hidden[at("marker_reason")]), ("", "hidden by glare"));
        let failed = rows.last().unwrap();
        assert_eq!(&failed[at("reason")], "dark, \"quoted\"\nand broken");
        assert_eq!(&failed[at("marker")], "");
    }

    #[test]
    fn an_empty_store_gives_the_heading_alone() {
        assert_eq!(csv(&columns(&[])).unwrap().lines().count(), 1);
    }
}
