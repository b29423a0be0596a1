//! Named arrays with units, written as NetCDF (classic, 64-bit offsets) with the CF conventions.

use std::fs::File;
use std::io;

use netcdf3::{DataSet, FileWriter, InvalidDataSet, Version, WriteError};
use serde_json::Value;

/// Values of an array, in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub enum ArrayValues {
    /// A missing value is NaN.
    Numbers(Vec<f64>),
    /// Numbers in single precision.
    Singles(Vec<f32>),
    /// 0 or 1.
    Flags(Vec<i8>),
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

/// Arrays over common dimensions, with attributes that hold for all of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArrayDataset {
    /// Names and sizes of the dimensions.
    pub dimensions: Vec<(&'static str, usize)>,
    pub arrays: Vec<NamedArray>,
    /// Names of arrays that are coordinates of the arrays with their dimensions.
    pub coordinates: Vec<&'static str>,
    /// Texts, integers, numbers and lists of numbers.
    pub attributes: Vec<(&'static str, Value)>,
}

/// Reason for a name, a size or a value that NetCDF does not have.
const NOT_POSSIBLE: &str = "NetCDF cannot hold these arrays; export fewer flights with --flight";

impl ArrayDataset {
    /// Returns the size of a dimension; 0 if it does not exist.
    pub fn size_of(&self, dimension: &str) -> usize {
        let found = self.dimensions.iter().find(|(name, _)| *name == dimension);
        found.map_or(0, |(_, size)| *size)
    }

    /// Adds an array.
    pub fn add(
        &mut self,
        name: &str,
        unit: &'static str,
        meaning: &str,
        dimensions: &[&'static str],
        values: ArrayValues,
    ) {
        self.arrays.push(NamedArray {
            name: name.to_owned(),
            dimensions: dimensions.to_vec(),
            unit,
            meaning: meaning.to_owned(),
            values,
        });
    }

    /// Writes a NetCDF file. Arrays with a dimension of size 0 are omitted.
    ///
    /// # Errors
    /// Returns an error of the file system, or of the format if a name or a size is not possible in it.
    pub fn write_netcdf(&self, file: File) -> io::Result<()> {
        let set = self.define();
        let set = set.map_err(|_: InvalidDataSet| io::Error::other(NOT_POSSIBLE))?;
        let written = self.write_arrays(&set, file);
        written.map_err(|error| match error {
            WriteError::IOErrorKind(kind) => kind.into(),
            _ => io::Error::other(NOT_POSSIBLE),
        })
    }

    fn write_arrays(&self, set: &DataSet, file: File) -> Result<(), WriteError> {
        let mut writer = FileWriter::open_seek_write("", Box::new(file))?;
        writer.set_def(set, Version::Offset64Bit, 0)?;
        for NamedArray { name, values, .. } in self.present() {
            match values {
                ArrayValues::Numbers(numbers) => writer.write_var_f64(name, numbers),
                ArrayValues::Singles(numbers) => writer.write_var_f32(name, numbers),
                ArrayValues::Flags(flags) => writer.write_var_i8(name, flags),
                ArrayValues::Texts(texts) => writer.write_var_u8(name, &fixed_width(texts)),
            }?;
        }
        writer.close()
    }

    fn present(&self) -> impl Iterator<Item = &NamedArray> {
        let is_empty = |array: &&NamedArray| array.dimensions.iter().any(|d| self.size_of(d) == 0);
        self.arrays.iter().filter(move |array| !is_empty(array))
    }

    /// Defines dimensions, arrays and attributes.
    fn define(&self) -> Result<DataSet, InvalidDataSet> {
        let mut set = DataSet::new();
        for (name, size) in self.dimensions.iter().filter(|(_, size)| *size > 0) {
            set.add_fixed_dim(name, *size)?;
        }
        for (name, value) in &self.attributes {
            match (value, value.as_i64()) {
                (Value::String(text), _) => set.add_global_attr_string(name, text)?,
                (_, Some(count)) => set.add_global_attr_i32(name, vec![count as i32])?,
                _ => {
                    let list = value.as_array().map_or(std::slice::from_ref(value), |l| l);
                    let numbers = list.iter().filter_map(Value::as_f64).collect();
                    set.add_global_attr_f64(name, numbers)?
                }
            };
        }
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
                    if !set.has_dim(&length) {
                        set.add_fixed_dim(&length, width)?;
                    }
                    dimensions.push(length);
                    set.add_var_u8(name, &dimensions)?;
                    // Readers return texts as such instead of bytes.
                    set.add_var_attr_string(name, "_Encoding", "utf-8")?
                }
            };
            if !array.unit.is_empty() {
                set.add_var_attr_string(name, "units", array.unit)?;
            }
            set.add_var_attr_string(name, "long_name", &array.meaning)?;
            let coordinates = self.coordinates_of(array);
            if !coordinates.is_empty() {
                set.add_var_attr_string(name, "coordinates", coordinates.join(" "))?;
            }
        }
        Ok(set)
    }

    /// Returns the coordinates of an array other than the indices of its dimensions.
    fn coordinates_of(&self, array: &NamedArray) -> Vec<&'static str> {
        let name = array.name.as_str();
        if self.coordinates.contains(&name) || array.dimensions == [name] {
            return vec![];
        }
        let belongs = |coordinate: &&&'static str| {
            let mut others = self.present().filter(|other| other.name == ***coordinate);
            others.any(|other| {
                other
                    .dimensions
                    .iter()
                    .all(|d| array.dimensions.contains(d))
            })
        };
        self.coordinates.iter().filter(belongs).copied().collect()
    }
}

/// Length of the longest text, at least 1 byte.
fn text_width(texts: &[String]) -> usize {
    texts.iter().map(String::len).max().unwrap_or(0).max(1)
}

/// Texts one after the other, each filled with zeros to the same width.
fn fixed_width(texts: &[String]) -> Vec<u8> {
    let width = text_width(texts);
    let fill = |text: &String| std::iter::repeat_n(0, width - text.len());
    let filled = texts.iter().flat_map(|text| text.bytes().chain(fill(text)));
    filled.collect()
}
