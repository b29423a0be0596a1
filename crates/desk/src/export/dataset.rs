//! Named arrays with units, written as NetCDF (classic, 64-bit offsets) or as an archive of NumPy arrays (npz).

use std::fs::File;
use std::io::{self, Seek, Write};

use netcdf3::{DataSet, FileWriter, InvalidDataSet, Version, WriteError};
use zip::write::{SimpleFileOptions, ZipWriter};

/// Values of an array, in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub enum ArrayValues {
    /// A missing value is NaN.
    Numbers(Vec<f64>),
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
    /// Unit, empty for a number without one.
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
    pub attributes: Vec<(String, String)>,
}

/// Name of an array in the archive that holds attributes, units and dimensions as JSON.
const DESCRIPTION: &str = "description";
/// Alignment of the data in a NumPy file, bytes.
const NPY_ALIGNMENT: usize = 64;

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
        let mut set = DataSet::new();
        for (name, size) in self.dimensions.iter().filter(|(_, size)| *size > 0) {
            set.add_fixed_dim(name, *size).map_err(definition_error)?;
        }
        for (name, text) in &self.attributes {
            set.add_global_attr_string(name, text)
                .map_err(definition_error)?;
        }
        let present = || {
            self.arrays
                .iter()
                .filter(|a| a.dimensions.iter().all(|d| self.size_of(d) > 0))
        };
        for array in present() {
            let (name, mut dimensions) = (
                &array.name,
                array
                    .dimensions
                    .iter()
                    .map(|d| (*d).to_owned())
                    .collect::<Vec<_>>(),
            );
            match &array.values {
                ArrayValues::Numbers(_) => set.add_var_f64(name, &dimensions),
                ArrayValues::Flags(_) => set.add_var_i8(name, &dimensions),
                ArrayValues::Texts(texts) => {
                    let length = format!("{name}_length");
                    set.add_fixed_dim(&length, text_width(texts))
                        .map_err(definition_error)?;
                    dimensions.push(length);
                    set.add_var_u8(name, &dimensions)
                }
            }
            .map_err(definition_error)?;
            for (attribute, text) in [("units", array.unit), ("long_name", array.meaning.as_str())]
            {
                set.add_var_attr_string(name, attribute, text)
                    .map_err(definition_error)?;
            }
        }
        let mut writer = FileWriter::open_seek_write("", Box::new(file)).map_err(write_error)?;
        writer
            .set_def(&set, Version::Offset64Bit, 0)
            .map_err(write_error)?;
        for array in present() {
            let name = &array.name;
            match &array.values {
                ArrayValues::Numbers(numbers) => writer.write_var_f64(name, numbers),
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

    /// Writes an archive of NumPy arrays; the array `description` holds attributes, dimensions, units and meanings as JSON.
    ///
    /// # Errors
    /// Returns an error of the file system.
    pub fn write_npz(&self, file: impl Write + Seek) -> io::Result<()> {
        let mut archive = ZipWriter::new(file);
        for NamedArray {
            name,
            dimensions,
            values,
            ..
        } in &self.arrays
        {
            let shape: Vec<usize> = dimensions.iter().map(|d| self.size_of(d)).collect();
            let (kind, bytes) = match values {
                ArrayValues::Numbers(numbers) => (
                    "<f8".into(),
                    numbers.iter().flat_map(|v| v.to_le_bytes()).collect(),
                ),
                ArrayValues::Flags(flags) => {
                    ("|b1".into(), flags.iter().map(|f| u8::from(*f)).collect())
                }
                ArrayValues::Texts(texts) => {
                    (format!("|S{}", text_width(texts)), fixed_width(texts))
                }
            };
            add_npy(&mut archive, name, &kind, &shape, &bytes)?;
        }
        let text = self.description().to_string();
        add_npy(
            &mut archive,
            DESCRIPTION,
            &format!("|S{}", text.len()),
            &[],
            text.as_bytes(),
        )?;
        archive.finish()?.flush()
    }

    fn description(&self) -> serde_json::Value {
        let arrays = self.arrays.iter().map(|a| {
            (a.name.clone(), serde_json::json!({"dimensions": a.dimensions, "unit": a.unit, "meaning": a.meaning}))
        });
        let attributes = self
            .attributes
            .iter()
            .map(|(name, text)| (name.clone(), text.clone().into()));
        let (arrays, attributes): (serde_json::Map<_, _>, serde_json::Map<_, _>) =
            (arrays.collect(), attributes.collect());
        serde_json::json!({"attributes": attributes, "arrays": arrays})
    }
}

/// Adds a file of one array (format 1.0: magic number, length of the header, header, data).
fn add_npy<W: Write + Seek>(
    archive: &mut ZipWriter<W>,
    name: &str,
    kind: &str,
    shape: &[usize],
    bytes: &[u8],
) -> io::Result<()> {
    archive.start_file(
        format!("{name}.npy"),
        SimpleFileOptions::default().large_file(true),
    )?;
    let shape: String = shape.iter().map(|size| format!("{size}, ")).collect();
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    let before = b"\x93NUMPY\x01\x00".len() + 2;
    let length = (before + header.len() + 1).next_multiple_of(NPY_ALIGNMENT) - before;
    header.extend(std::iter::repeat_n(' ', length - header.len() - 1));
    archive.write_all(b"\x93NUMPY\x01\x00")?;
    archive.write_all(
        &u16::try_from(length)
            .map_err(io::Error::other)?
            .to_le_bytes(),
    )?;
    archive.write_all(header.as_bytes())?;
    archive.write_all(b"\n")?;
    archive.write_all(bytes)
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
const NOT_POSSIBLE: &str = "NetCDF cannot hold these arrays; use --format npz";

fn definition_error(_: InvalidDataSet) -> io::Error {
    io::Error::other(NOT_POSSIBLE)
}

fn write_error(error: WriteError) -> io::Error {
    match error {
        WriteError::IOErrorKind(kind) => kind.into(),
        _ => io::Error::other(NOT_POSSIBLE),
    }
}
