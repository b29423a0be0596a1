//! The export's table as a Parquet file: one row group, optional columns, Snappy.

use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::Type;

use super::columns::{Column, Values};

/// The bytes of the file.
pub fn parquet(columns: &[Column]) -> Result<Vec<u8>, ParquetError> {
    let fields = columns.iter().map(|c| field(c).map(Arc::new)).collect::<Result<Vec<_>, _>>()?;
    let schema = Type::group_type_builder("wingd").with_fields(fields).build()?;
    let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
    let mut writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), Arc::new(properties))?;
    let mut group = writer.next_row_group()?;
    for column in columns {
        write(&mut group, &column.values)?;
    }
    group.close()?;
    writer.into_inner()
}

fn field(column: &Column) -> Result<Type, ParquetError> {
    let (physical, logical) = match column.values {
        Values::Text(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        Values::Number(_) => (Physical::DOUBLE, None),
        Values::Count(_) => (Physical::INT64, None),
        Values::Flag(_) => (Physical::BOOLEAN, None),
    };
    let builder = Type::primitive_type_builder(&column.name, physical);
    builder.with_repetition(Repetition::OPTIONAL).with_logical_type(logical).build()
}

type Group<'a> = SerializedRowGroupWriter<'a, Vec<u8>>;

fn write(group: &mut Group, values: &Values) -> Result<(), ParquetError> {
    match values {
        Values::Text(v) => put::<ByteArrayType, _>(group, v, |t: &String| ByteArray::from(t.as_str())),
        Values::Number(v) => put::<DoubleType, _>(group, v, |n| *n),
        Values::Count(v) => put::<Int64Type, _>(group, v, |n| *n),
        Values::Flag(v) => put::<BoolType, _>(group, v, |b| *b),
    }
}

fn put<T: DataType, V>(
    group: &mut Group,
    values: &[Option<V>],
    of: impl Fn(&V) -> T::T,
) -> Result<(), ParquetError> {
    let present: Vec<T::T> = values.iter().flatten().map(of).collect();
    let levels: Vec<i16> = values.iter().map(|v| i16::from(v.is_some())).collect();
    let missing = || ParquetError::General("the schema has fewer columns than the table".to_owned());
    let mut column = group.next_column()?.ok_or_else(missing)?;
    column.typed::<T>().write_batch(&present, Some(&levels), None)?;
    column.close()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::Field;

    use super::super::super::sample;
    use super::super::columns;
    use super::*;

    #[test]
    fn the_file_reads_back_with_numbers_words_and_gaps() {
        let mut series = sample::series("s000001", 0, &[2.9]);
        series.records.push(sample::failed("x.jpg", "dark"));
        let bytes = parquet(&columns(&[series])).unwrap();
        let reader = SerializedFileReader::new(axum::body::Bytes::from(bytes)).unwrap();
        let rows: Vec<_> = reader.get_row_iter(None).unwrap().map(Result::unwrap).collect();
        assert_eq!(rows.len(), 5);
        let value = |row: usize, name: &str| {
            rows[row].get_column_iter().find(|(n, _)| *n == name).map(|(_, f)| f.clone()).unwrap()
        };
        assert_eq!(value(2, "marker"), Field::Str("M03".to_owned()));
        assert_eq!(value(2, "lift_m"), Field::Double(2.9));
        assert_eq!(value(2, "redundancy"), Field::Long(33));
        assert_eq!(value(3, "used"), Field::Bool(false));
        assert_eq!(value(3, "lift_m"), Field::Null);
        assert_eq!(value(4, "reason"), Field::Str("dark".to_owned()));
    }

    #[test]
    fn an_empty_table_is_a_readable_file() {
        let bytes = parquet(&columns(&[])).unwrap();
        let reader = SerializedFileReader::new(axum::body::Bytes::from(bytes)).unwrap();
        assert_eq!(reader.metadata().file_metadata().num_rows(), 0);
    }
}
