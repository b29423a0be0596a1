//! Parquet files with bounded row groups, optional columns, Snappy compression, and times as UTC timestamps.

use std::io::{self, Write};
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, TimeUnit, Type as Physical};
use parquet::data_type::{
    BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type,
};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnPath, Type};

use super::RowWriter;
use super::columns::{ColumnValues, ExportColumn, NumberType};

/// Approximate maximum number of rows of a row group. A group is kept in memory, about 1 kB per row, until it is written.
const MAX_GROUP_ROWS: usize = 16_384;

/// Writer of a Parquet file.
pub struct ParquetFile<W: Write + Send> {
    writer: SerializedFileWriter<W>,
    /// Row group in memory.
    columns: Vec<ExportColumn>,
}

impl<W: Write + Send> ParquetFile<W> {
    /// Begins a file with these columns and their rows as the first ones.
    pub fn begin(output: W, columns: Vec<ExportColumn>) -> Result<Self, ParquetError> {
        let fields = columns
            .iter()
            .map(|c| schema_field(c).map(Arc::new))
            .collect::<Result<Vec<_>, _>>()?;
        let schema = Type::group_type_builder("wingd")
            .with_fields(fields)
            .build()?;
        let mut properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_created_by(format!("wingd {}", env!("CARGO_PKG_VERSION")));
        // Measured numbers hardly repeat: a dictionary would hold the full column, plus an index per value.
        for column in columns.iter().filter(|c| {
            matches!(
                c.values,
                ColumnValues::Numbers(NumberType::Double | NumberType::Single, _)
            )
        }) {
            let path = ColumnPath::from(column.name.as_str());
            properties = properties.set_column_dictionary_enabled(path, false);
        }
        let writer =
            SerializedFileWriter::new(output, Arc::new(schema), Arc::new(properties.build()))?;
        Ok(Self { writer, columns })
    }

    fn flush(&mut self) -> Result<(), ParquetError> {
        if self.columns.first().is_none_or(|c| c.values.is_empty()) {
            return Ok(());
        }
        let mut group = self.writer.next_row_group()?;
        for column in &mut self.columns {
            write_column(&mut group, &column.values)?;
            column.values.clear();
        }
        group.close().map(drop)
    }
}

impl<W: Write + Send> RowWriter for ParquetFile<W> {
    fn add(&mut self, rows: Vec<ExportColumn>) -> io::Result<()> {
        for (column, more) in self.columns.iter_mut().zip(rows) {
            column.values.append(more.values);
        }
        let rows = self.columns.first().map_or(0, |c| c.values.len());
        match rows >= MAX_GROUP_ROWS {
            true => self.flush().map_err(io::Error::other),
            false => Ok(()),
        }
    }

    fn end(mut self: Box<Self>) -> io::Result<()> {
        let written = self.flush().and_then(|()| self.writer.close());
        written.map(drop).map_err(io::Error::other)
    }
}

fn schema_field(column: &ExportColumn) -> Result<Type, ParquetError> {
    let utc = LogicalType::timestamp(true, TimeUnit::MICROS);
    let (physical, logical) = match column.values {
        ColumnValues::Texts(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        ColumnValues::Numbers(NumberType::Double, _) => (Physical::DOUBLE, None),
        ColumnValues::Numbers(NumberType::Single, _) => (Physical::FLOAT, None),
        ColumnValues::Numbers(NumberType::Count, _) => (Physical::INT64, None),
        ColumnValues::Numbers(NumberType::Flag, _) => (Physical::BOOLEAN, None),
        ColumnValues::Numbers(NumberType::Time, _) => (Physical::INT64, Some(utc)),
    };
    let builder = Type::primitive_type_builder(&column.name, physical);
    builder
        .with_repetition(Repetition::OPTIONAL)
        .with_logical_type(logical)
        .build()
}

type ParquetRowGroup<'a, W> = SerializedRowGroupWriter<'a, W>;

fn write_column<W: Write + Send>(
    group: &mut ParquetRowGroup<W>,
    values: &ColumnValues,
) -> Result<(), ParquetError> {
    let (kind, numbers) = match values {
        ColumnValues::Texts(texts) => {
            let texts = texts
                .iter()
                .map(|text| text.as_deref().map(ByteArray::from));
            return write_values::<W, ByteArrayType>(group, texts);
        }
        ColumnValues::Numbers(kind, numbers) => (kind, numbers),
    };
    let present = numbers
        .iter()
        .map(|number| Some(*number).filter(|number| !number.is_nan()));
    match kind {
        NumberType::Double => write_values::<W, DoubleType>(group, present),
        NumberType::Single => {
            write_values::<W, FloatType>(group, present.map(|n| n.map(|n| n as f32)))
        }
        NumberType::Count | NumberType::Time => {
            write_values::<W, Int64Type>(group, present.map(|n| n.map(|n| n as i64)))
        }
        NumberType::Flag => {
            write_values::<W, BoolType>(group, present.map(|n| n.map(|n| n != 0.0)))
        }
    }
}

fn write_values<W: Write + Send, T: DataType>(
    group: &mut ParquetRowGroup<W>,
    values: impl Iterator<Item = Option<T::T>> + Clone,
) -> Result<(), ParquetError> {
    let levels: Vec<i16> = values
        .clone()
        .map(|value| i16::from(value.is_some()))
        .collect();
    let present: Vec<T::T> = values.flatten().collect();
    let missing =
        || ParquetError::General("the schema has fewer columns than the table".to_owned());
    let mut column = group.next_column()?.ok_or_else(missing)?;
    column
        .typed::<T>()
        .write_batch(&present, Some(&levels), None)?;
    column.close()
}

#[cfg(test)]
mod tests {
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::Field;

    use super::super::{ExportContext, table_columns};
    use super::*;
    use wingd_evaluation::quantities::ResultTable;
    use wingd_evaluation::results::{SeriesData, sample};

    fn file(table: ResultTable, series: &[SeriesData]) -> SerializedFileReader<axum::body::Bytes> {
        let common = ExportContext {
            store_id: Some("ab".to_owned()),
            pairs: vec!["tip".to_owned()],
        };
        let empty = SeriesData::default();
        let mut bytes = vec![];
        let columns = table_columns(table, &empty, &common);
        let mut file = Box::new(ParquetFile::begin(&mut bytes, columns).unwrap());
        for one in series {
            file.add(table_columns(table, one, &common)).unwrap();
        }
        file.end().unwrap();
        SerializedFileReader::new(axum::body::Bytes::from(bytes)).unwrap()
    }

    #[test]
    fn the_file_reads_back_with_numbers_words_times_and_gaps() {
        let mut series = sample::series("s000001", 0, &[2.9]);
        series.records.push(sample::failed("x.jpg", "dark"));
        let utc = series.shots[0].stamp.as_ref().unwrap().utc;
        let reader = file(ResultTable::Markers, &[series]);
        let rows: Vec<_> = reader
            .get_row_iter(None)
            .unwrap()
            .map(Result::unwrap)
            .collect();
        assert_eq!(rows.len(), 5);
        let value = |row: usize, name: &str| {
            rows[row]
                .get_column_iter()
                .find(|(n, _)| *n == name)
                .map(|(_, f)| f.clone())
                .unwrap()
        };
        assert_eq!(value(2, "marker"), Field::Str("M03".to_owned()));
        assert_eq!(value(2, "deflection_m"), Field::Double(2.9));
        assert_eq!(value(2, "redundancy"), Field::Long(33));
        assert_eq!(value(2, "recorder_id"), Field::Str("ab".to_owned()));
        assert_eq!(
            value(2, "utc"),
            Field::TimestampMicros(utc.as_microsecond())
        );
        assert_eq!(value(3, "used"), Field::Bool(false));
        assert_eq!(value(3, "deflection_m"), Field::Null);
        assert_eq!(value(4, "reason"), Field::Str("dark".to_owned()));
    }

    #[test]
    fn measured_numbers_read_back_bit_by_bit_and_take_their_own_size() {
        let rows = 10_000_u32;
        let noise = |k: u32| f64::from(k.wrapping_mul(2_654_435_761)) / f64::from(k + 3);
        let number = |k| (k % 10 != 0).then_some(noise(k));
        let numbers: Vec<f64> = (0..rows).map(|k| number(k).unwrap_or(f64::NAN)).collect();
        let column = |name: &str, values| ExportColumn {
            name: name.to_owned(),
            values,
        };
        let columns = vec![
            column(
                "deflection_m",
                ColumnValues::Numbers(NumberType::Double, numbers.clone()),
            ),
            column(
                "sigma_m",
                ColumnValues::Numbers(NumberType::Single, numbers),
            ),
        ];
        let mut bytes = vec![];
        let file = ParquetFile::begin(&mut bytes, columns).unwrap();
        Box::new(file).end().unwrap();
        let plain = 0.9 * f64::from(rows) * (8.0 + 4.0);
        assert!(
            (bytes.len() as f64) < 1.05 * plain,
            "{} of {plain} bytes",
            bytes.len()
        );
        let reader = SerializedFileReader::new(axum::body::Bytes::from(bytes)).unwrap();
        for (k, row) in (0..rows).zip(reader.get_row_iter(None).unwrap()) {
            let read: Vec<Field> = row
                .unwrap()
                .get_column_iter()
                .map(|(_, field)| field.clone())
                .collect();
            let expected = number(k).map_or([Field::Null, Field::Null], |v| {
                [Field::Double(v), Field::Float(v as f32)]
            });
            assert_eq!(read, expected, "row {k}");
        }
    }

    #[test]
    fn an_empty_table_is_a_readable_file() {
        assert_eq!(
            file(ResultTable::Span, &[])
                .metadata()
                .file_metadata()
                .num_rows(),
            0
        );
    }

    #[test]
    fn row_groups_are_bounded() {
        let series: Vec<SeriesData> = (0..40)
            .map(|k| sample::series("s", k, &[2.9; 150]))
            .collect();
        let reader = file(ResultTable::Markers, &series);
        assert_eq!(reader.metadata().file_metadata().num_rows(), 40 * 150 * 4);
        assert!(reader.num_row_groups() == 2, "{}", reader.num_row_groups());
    }
}
