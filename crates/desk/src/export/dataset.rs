//! Named arrays with units, written as NetCDF (classic, 64-bit offsets) with the CF conventions.

use std::fs::File;
use std::io;

use netcdf3::{DataSet, FileWriter, InvalidDataSet, Version, WriteError};

/// Values of an array, in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub enum ArrayValues {
    /// A missing value is NaN.
    Numbers(Vec<f64>),
    /// Numbers in single precision.
    Singles(Vec<f32>),
    /// 0 or 1.
    Flags(Vec<bool>),
    Texts(Vec<String>),
}

/// Array with a name, dimensions, unit and meaning.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedArray {
    pub name: String,
    /// Names of the dimensions, the slowest first.
    pub dimensions: Vec<&'static str>,
    /// Unit, empty for a text.
    pub unit: &'static str,
    /// Meaning, a phrase.
    pub meaning: String,
    pub values: ArrayValues,
}

/// Attribute of a dataset.
#[derive(Clone, Debug, PartialEq)]
pub enum AttributeValue {
    Text(String),
    Numbers(Vec<f64>),
    Count(i32),
}

/// Arrays over common dimensions, with attributes that hold for all of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArrayDataset {
    /// Names and sizes of the dimensions.
    pub dimensions: Vec<(&'static str, usize)>,
    pub arrays: Vec<NamedArray>,
    /// Names of arrays that are coordinates of the arrays with their dimensions.
    pub coordinates: Vec<&'static str>,
    pub attributes: Vec<(String, AttributeValue)>,
}

impl ArrayDataset {
    fn size_of(&self, dimension: &str) -> usize {
        self.dimensions
            .iter()
            .find(|(name, _)| *name == dimension)
            .map_or(0, |(_, size)| *size)
    }

    /// Writes a NetCDF file. Arrays with a dimension of size 0 are omitted.
    ///
    /// # Errors
    /// Returns an error of the file system, or of the format if a name or a size is not possible in it.
    pub fn write_netcdf(&self, file: File) -> io::Result<()> {
        let set = self.define().map_err(definition_error)?;
        let mut writer = FileWriter::open_seek_write("", Box::new(file)).map_err(write_error)?;
        writer
            .set_def(&set, Version::Offset64Bit, 0)
            .map_err(write_error)?;
        for array in self.present() {
            let name = &array.name;
            match &array.values {
                ArrayValues::Numbers(numbers) => writer.write_var_f64(name, numbers),
                ArrayValues::Singles(numbers) => writer.write_var_f32(name, numbers),
                ArrayValues::Flags(flags) => writer.write_var_i8(
                    name,
                    &flags.iter().map(|f| i8::from(*f)).collect::<Vec<_>>(),
                ),
                ArrayValues::Texts(texts) => writer.write_var_u8(name, &fixed_width(texts)),
            }
            .map_err(write_error)?;
        }
        writer.close().map_err(write_error)
    }

    fn present(&self) -> impl Iterator<Item = &NamedArray> {
        self.arrays
            .iter()
            .filter(|a| a.dimensions.iter().all(|d| self.size_of(d) > 0))
    }

    /// Defines dimensions, arrays and attributes.
    fn define(&self) -> Result<DataSet, InvalidDataSet> {
        let mut set = DataSet::new();
        for (name, size) in self.dimensions.iter().filter(|(_, size)| *size > 0) {
            set.add_fixed_dim(name, *size)?;
        }
        for (name, value) in &self.attributes {
            match value {
                AttributeValue::Text(text) => set.add_global_attr_string(name, text)?,
                AttributeValue::Numbers(numbers) => {
                    set.add_global_attr_f64(name, numbers.clone())?
                }
                AttributeValue::Count(count) => set.add_global_attr_i32(name, vec![*count])?,
            };
        }
        let mut widths = vec![];
        for array in self.present() {
            let name = &array.name;
            let mut dimensions: Vec<String> =
                array.dimensions.iter().map(|d| (*d).to_owned()).collect();
            match &array.values {
                ArrayValues::Numbers(_) => set.add_var_f64(name, &dimensions)?,
                ArrayValues::Singles(_) => set.add_var_f32(name, &dimensions)?,
                ArrayValues::Flags(_) => set.add_var_i8(name, &dimensions)?,
                ArrayValues::Texts(texts) => {
                    let width = text_width(texts);
                    let length = format!("string{width}");
                    if !widths.contains(&width) {
                        set.add_fixed_dim(&length, width)?;
                        widths.push(width);
                    }
                    dimensions.push(length);
                    set.add_var_u8(name, &dimensions)?
                }
            };
            // Readers return texts as such instead of bytes.
            if matches!(array.values, ArrayValues::Texts(_)) {
                set.add_var_attr_string(name, "_Encoding", "utf-8")?;
            }
            if !array.unit.is_empty() {
                set.add_var_attr_string(name, "units", array.unit)?;
            }
            set.add_var_attr_string(name, "long_name", &array.meaning)?;
            let coordinates = self.coordinates_of(array).join(" ");
            if !coordinates.is_empty() {
                set.add_var_attr_string(name, "coordinates", coordinates)?;
            }
        }
        Ok(set)
    }

    /// Returns the coordinates of an array other than the indices of its dimensions.
    fn coordinates_of(&self, array: &NamedArray) -> Vec<&str> {
        let is_coordinate = |name: &str| self.coordinates.contains(&name);
        let belongs = |other: &&NamedArray| {
            let is_index = other.dimensions == [other.name.as_str()];
            is_coordinate(&other.name)
                && !is_index
                && other
                    .dimensions
                    .iter()
                    .all(|d| array.dimensions.contains(d))
        };
        let is_index = array.dimensions == [array.name.as_str()];
        match is_coordinate(&array.name) || is_index {
            true => vec![],
            false => self
                .present()
                .filter(belongs)
                .map(|other| other.name.as_str())
                .collect(),
        }
    }
}

/// Length of the longest text, at least 1 byte.
fn text_width(texts: &[String]) -> usize {
    texts.iter().map(String::len).max().unwrap_or(0).max(1)
}

/// Texts one after the other, each filled with zeros to the same width.
fn fixed_width(texts: &[String]) -> Vec<u8> {
    let width = text_width(texts);
    texts
        .iter()
        .flat_map(|text| {
            text.bytes()
                .chain(std::iter::repeat_n(0, width - text.len()))
        })
        .collect()
}

/// Reason for a name, a size or a value that NetCDF does not have.
const NOT_POSSIBLE: &str = "NetCDF cannot hold these arrays; export fewer flights with --flight";

fn definition_error(_: InvalidDataSet) -> io::Error {
    io::Error::other(NOT_POSSIBLE)
}

fn write_error(error: WriteError) -> io::Error {
    match error {
        WriteError::IOErrorKind(kind) => kind.into(),
        _ => io::Error::other(NOT_POSSIBLE),
    }
}
