//! Export tables: the rows of a series in named, typed columns.

use wingd_base::clock::FIRST_KNOWN_UTC;
use wingd_evaluation::quantities::{
    ResultInputs, ResultRow, ResultTable, TableColumn, ValueGetter,
};
use wingd_evaluation::record::{ImageRecord, Term, json_fields};
use wingd_evaluation::results::{SeriesData, ShotData};

/// Type of the numbers of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberType {
    Double,
    Single,
    Count,
    Flag,
    /// Times, microseconds since 1970 UTC.
    Time,
}

/// Values of one column.
#[derive(Clone, Debug, PartialEq)]
pub enum ColumnValues {
    /// Texts; `None` if missing.
    Texts(Vec<Option<String>>),
    /// Numbers of a type; NaN if missing.
    Numbers(NumberType, Vec<f64>),
}

impl ColumnValues {
    /// Creates numbers of a type; a time before any clock was set is missing.
    pub fn from_numbers(kind: NumberType, mut numbers: Vec<f64>) -> Self {
        if kind == NumberType::Time {
            let first_us = FIRST_KNOWN_UTC.as_microsecond() as f64;
            let unset = numbers.iter_mut().filter(|us| **us < first_us);
            unset.for_each(|us| *us = f64::NAN);
        }
        Self::Numbers(kind, numbers)
    }

    /// Returns the number of rows.
    pub fn len(&self) -> usize {
        match self {
            Self::Texts(texts) => texts.len(),
            Self::Numbers(_, numbers) => numbers.len(),
        }
    }

    /// Returns true if there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Formats one value in full precision, a time as RFC 3339 in UTC; empty if the value is missing.
    pub fn value_text(&self, row: usize) -> String {
        let (kind, number) = match self {
            Self::Texts(texts) => return texts.get(row).cloned().flatten().unwrap_or_default(),
            Self::Numbers(kind, numbers) => {
                (kind, numbers.get(row).filter(|number| !number.is_nan()))
            }
        };
        let text = |number: &f64| match kind {
            NumberType::Double => number.to_string(),
            NumberType::Single => (*number as f32).to_string(),
            NumberType::Count => (*number as i64).to_string(),
            NumberType::Flag => (*number != 0.0).to_string(),
            // One width in a column: readers take its format from the first row.
            NumberType::Time => {
                jiff::Timestamp::from_microsecond(*number as i64).map_or(String::new(), time_text)
            }
        };
        number.map(text).unwrap_or_default()
    }

    /// Removes all rows.
    pub fn clear(&mut self) {
        match self {
            Self::Texts(texts) => texts.clear(),
            Self::Numbers(_, numbers) => numbers.clear(),
        }
    }

    /// Appends the rows of another column of the same type.
    pub fn append(&mut self, more: Self) {
        match (self, more) {
            (Self::Texts(texts), Self::Texts(more)) => texts.extend(more),
            (Self::Numbers(_, numbers), Self::Numbers(_, more)) => numbers.extend(more),
            // The columns of a table have the same types for every series.
            _ => {}
        }
    }
}

/// Formats a time with microseconds, RFC 3339 in UTC.
pub fn time_text(time: jiff::Timestamp) -> String {
    format!("{time:.6}")
}

/// Named column with its values.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportColumn {
    /// Name, with the unit.
    pub name: String,
    pub values: ColumnValues,
}

impl ExportColumn {
    /// Reads the values of a column from rows; numbers that are not finite are missing.
    pub fn from_rows(column: &TableColumn, rows: &[ResultRow]) -> Self {
        let rows = rows.iter().map(|row| column.narrow(row));
        let kind = match column.quantity.value {
            ValueGetter::Text(value) => {
                let values = ColumnValues::Texts(rows.map(|row| value(&row)).collect());
                return Self {
                    name: column.name.clone(),
                    values,
                };
            }
            ValueGetter::Number(_) => NumberType::Double,
            ValueGetter::Count(_) => NumberType::Count,
            ValueGetter::Flag(_) => NumberType::Flag,
            ValueGetter::Time(_) => NumberType::Time,
        };
        let finite = |number: f64| if number.is_finite() { number } else { f64::NAN };
        let numbers = rows
            .map(|row| finite(column.quantity.number(&row)))
            .collect();
        Self {
            name: column.name.clone(),
            values: ColumnValues::from_numbers(kind, numbers),
        }
    }
}

/// Data common to the rows of all series.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExportContext {
    /// Random id of the recorder's store; `None` in a store without evidence.
    pub store_id: Option<String>,
    /// Names of the torsion pairs; each pair has its own columns.
    pub pairs: Vec<String>,
}

/// Shot and result of a frame: at least one is there.
type Frame<'a> = (Option<&'a ShotData>, Option<&'a ImageRecord>);

fn is_per_shot(table: ResultTable) -> bool {
    matches!(table, ResultTable::Shots | ResultTable::Summary)
}

/// Builds the columns of a table of frames for one series.
pub fn table_columns(
    table: ResultTable,
    series: &SeriesData,
    common: &ExportContext,
) -> Vec<ExportColumn> {
    let frames: Vec<Frame> = if is_per_shot(table) {
        series
            .shots
            .iter()
            .map(|shot| (Some(shot), series.record_for_shot(shot)))
            .collect()
    } else {
        series
            .records
            .iter()
            .map(|image| (series.shot_for_record(image), Some(image)))
            .collect()
    };
    let inputs = |(_, image): &Frame| {
        let provenance = &(*image)?.provenance;
        Some(ResultInputs::new(
            &json_fields(provenance),
            series.inputs.clone(),
        ))
    };
    let inputs: Vec<Option<ResultInputs>> = frames.iter().map(inputs).collect();
    let terms: Vec<Vec<Term>> = frames
        .iter()
        .map(|(_, image)| image.map_or(vec![], |image| image.model.terms()))
        .collect();
    let rows = frames
        .iter()
        .zip(&inputs)
        .zip(&terms)
        .flat_map(|((frame, inputs), terms)| {
            let row = ResultRow {
                recorder_id: common.store_id.as_deref(),
                inputs: inputs.as_ref(),
                ..frame_row(series, frame)
            };
            image_rows(table, row, terms)
        });
    let rows: Vec<ResultRow> = rows.collect();
    let columns = TableColumn::of_frames(table, &common.pairs);
    columns
        .iter()
        .map(|column| ExportColumn::from_rows(column, &rows))
        .collect()
}

/// Returns the values of shot, failures, image and solution that each row of a frame has.
fn frame_row<'a>(series: &'a SeriesData, (shot, image): &Frame<'a>) -> ResultRow<'a> {
    let row = ResultRow {
        flight: Some(&series.flight),
        series: Some(&series.name),
        image: *image,
        frame: image.map(|image| image.image.as_str()),
        ..ResultRow::default()
    };
    let Some(shot) = shot else { return row };
    ResultRow {
        shot: Some(shot.number),
        frame: row.frame.or(shot.image.as_deref()),
        frame_sha256: shot.sha256.as_deref(),
        failures: &shot.failures,
        stamp: shot.stamp.as_ref(),
        exposure: shot.exposure.as_ref(),
        aircraft: Some(&shot.aircraft),
        ..row
    }
}

/// Returns the rows of one frame.
fn image_rows<'a>(table: ResultTable, row: ResultRow<'a>, terms: &'a [Term]) -> Vec<ResultRow<'a>> {
    let Some(image) = row.image.filter(|_| !is_per_shot(table)) else {
        return vec![row];
    };
    let count = match table {
        ResultTable::Span => image.curve.len(),
        ResultTable::Moments => image.moments.len(),
        ResultTable::Parameters => {
            return terms
                .iter()
                .map(|term| ResultRow {
                    parameter: Some(term),
                    ..row
                })
                .collect();
        }
        _ if image.markers.is_empty() => return vec![row],
        _ => image.markers.len(),
    };
    (0..count)
        .map(|index| ResultRow {
            index: Some(index),
            ..row
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_before_any_clock_was_set_is_missing() {
        let times = vec![3e7, 315_532_799e6, 315_532_800e6, 1.78e15, f64::NAN];
        let column = ColumnValues::from_numbers(NumberType::Time, times);
        let texts: Vec<String> = (0..column.len())
            .map(|row| column.value_text(row))
            .collect();
        let known = ["1980-01-01T00:00:00.000000Z", "2026-05-28T20:26:40.000000Z"];
        assert_eq!(texts, ["", "", known[0], known[1], ""]);
        // Only times are: a count may be small.
        let counts = ColumnValues::from_numbers(NumberType::Count, vec![3.0]);
        assert_eq!(counts.value_text(0), "3");
    }
}
