//! Export of results as CSV or Parquet tables and JSON Lines.

mod columns;
mod dataset;
mod lines;
mod live;
#[cfg(feature = "parquet")]
mod parquet_file;
mod shape;

use std::io::{self, Write};

use wingd_base::text::text_cell;

pub use columns::{ColumnValues, ExportColumn, ExportContext, NumberType, table_columns};

pub use lines::write_json_lines;
pub use live::{JsonRows, LiveColumns};
#[cfg(feature = "parquet")]
pub use parquet_file::ParquetFile;
pub use shape::{DatedShape, ShapeExport};

/// Writer of rows of the same columns.
pub trait RowWriter {
    /// Adds rows.
    fn add(&mut self, rows: Vec<ExportColumn>) -> io::Result<()>;

    /// Writes what is left.
    fn end(self: Box<Self>) -> io::Result<()>;
}

/// Rows as CSV; a missing value is an empty field.
pub struct CsvRows<W: Write>(csv::Writer<W>);

impl<W: Write> CsvRows<W> {
    /// Begins with the heading line and the first rows.
    pub fn begin(output: W, columns: &[ExportColumn]) -> io::Result<Self> {
        let mut csv = Self(csv::Writer::from_writer(output));
        let heading = columns.iter().map(|c| c.name.as_str());
        csv.0.write_record(heading).map_err(io_error)?;
        csv.add_rows(columns)?;
        Ok(csv)
    }

    fn add_rows(&mut self, columns: &[ExportColumn]) -> io::Result<()> {
        let rows = columns.first().map_or(0, |c| c.values.len());
        let cell = |values: &ColumnValues, row| match (values, values.value_text(row)) {
            (ColumnValues::Texts(_), text) => text_cell(&text).into_owned(),
            (_, text) => text,
        };
        (0..rows).try_for_each(|row| {
            let cells = columns.iter().map(|c| cell(&c.values, row));
            self.0.write_record(cells).map_err(io_error)
        })
    }
}

impl<W: Write> RowWriter for CsvRows<W> {
    fn add(&mut self, rows: Vec<ExportColumn>) -> io::Result<()> {
        self.add_rows(&rows)
    }

    fn end(mut self: Box<Self>) -> io::Result<()> {
        self.0.flush()
    }
}

fn io_error(error: csv::Error) -> io::Error {
    match error.into_kind() {
        csv::ErrorKind::Io(error) => error,
        other => io::Error::other(format!("{other:?}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wingd_evaluation::quantities::ResultTable;
    use wingd_evaluation::results::{SeriesData, sample};

    fn text(table: ResultTable, series: &[SeriesData]) -> String {
        let common = ExportContext {
            store_id: Some("ab".to_owned()),
            pairs: vec!["tip".to_owned()],
        };
        let mut bytes = Vec::new();
        let mut csv = CsvRows::begin(
            &mut bytes,
            &table_columns(table, &SeriesData::default(), &common),
        )
        .unwrap();
        for one in series {
            csv.add(table_columns(table, one, &common)).unwrap();
        }
        Box::new(csv).end().unwrap();
        String::from_utf8(bytes).unwrap()
    }

    fn rows(text: &str) -> (csv::StringRecord, Vec<csv::StringRecord>) {
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let heading = reader.headers().unwrap().clone();
        (heading, reader.records().map(Result::unwrap).collect())
    }

    #[test]
    fn csv_reads_back_with_every_marker_of_every_image() {
        let mut series = sample::series("s000001", 0, &[2.9, 3.1]);
        series
            .records
            .push(sample::failed("=x.jpg", "dark, \"quoted\"\nand broken"));
        let text = text(ResultTable::Markers, &[series]);
        let (heading, rows) = rows(&text);
        let at = |name: &str| heading.iter().position(|h| h == name).unwrap();
        assert_eq!(
            rows.len(),
            2 * 4 + 1,
            "four markers twice, and the failed image"
        );
        let tip = rows.iter().find(|r| &r[at("marker")] == "M03").unwrap();
        assert_eq!(tip[at("deflection_m")].parse::<f64>().unwrap(), 2.9);
        assert_eq!(tip[at("position_z_m")].parse::<f64>().unwrap(), 3.0 + 2.9);
        assert_eq!(
            (&tip[at("torsion_tip_twist_deg")], &tip[at("recorder_id")]),
            ("2.7", "ab")
        );
        assert_eq!(&tip[at("used")], "true");
        assert!(tip[at("utc")].ends_with('Z'), "with its zone");
        let hidden = rows.iter().find(|r| &r[at("marker")] == "M04").unwrap();
        assert_eq!(
            (&hidden[at("deflection_m")], &hidden[at("marker_reason")]),
            ("", "hidden by glare")
        );
        let failed = rows.last().unwrap();
        assert_eq!(&failed[at("reason")], "dark, \"quoted\"\nand broken");
        assert_eq!(&failed[at("marker")], "");
    }

    #[test]
    fn the_other_tables_have_points_parameters_and_shots() {
        let mut series = sample::series("s000001", 0, &[2.9]);
        let lost = wingd_evaluation::results::ShotData {
            number: 2,
            failures: vec!["gone: unplugged".into()],
            ..Default::default()
        };
        series.shots.push(lost);
        let series = [series];
        let (heading, span) = rows(&text(ResultTable::Span, &series));
        let at = |name: &str| heading.iter().position(|h| h == name).unwrap();
        assert_eq!(
            (
                span.len(),
                &span[12][at("span_m")],
                &span[12][at("deflection_m")]
            ),
            (13, "36", "2.9")
        );
        let (heading, parameters) = rows(&text(ResultTable::Parameters, &series));
        let at = |name: &str| heading.iter().position(|h| h == name).unwrap();
        assert_eq!(
            (&parameters[0][at("parameter")], &parameters[0][at("value")]),
            ("a_per_m", "0.00219")
        );
        let (heading, shots) = rows(&text(ResultTable::Shots, &series));
        let at = |name: &str| heading.iter().position(|h| h == name).unwrap();
        assert_eq!((shots.len(), &shots[1][at("status")]), (2, "no frame"));
        assert_eq!(&shots[1][at("camera_failures")], "gone: unplugged");
    }

    #[test]
    fn an_empty_store_gives_the_heading_alone() {
        assert_eq!(text(ResultTable::Markers, &[]).lines().count(), 1);
    }
}
