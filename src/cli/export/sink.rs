//! Output of an export: rows to a file or standard output, as CSV, JSON lines or Parquet.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use super::{ExportArgs, FormatName};
use crate::cli::{Failure, TaskResult, print_line};
use crate::report::export::{self, CsvWriter, ExportColumn};
use crate::store::StoreError;

/// Reason why an export ended early.
pub(super) enum ExportEnd {
    /// Error of the output.
    Output(io::Error),
    /// Error of a store.
    Failed(Failure),
}

impl From<io::Error> for ExportEnd {
    fn from(error: io::Error) -> Self {
        Self::Output(error)
    }
}

impl From<Failure> for ExportEnd {
    fn from(failure: Failure) -> Self {
        Self::Failed(failure)
    }
}

impl From<StoreError> for ExportEnd {
    fn from(error: StoreError) -> Self {
        Self::Failed(error.into())
    }
}

impl ExportArgs {
    /// Returns the file to write; `None` for standard output.
    fn output_file(&self) -> Option<&Path> {
        let default = matches!(self.format, FormatName::Parquet).then_some(Path::new("export.parquet"));
        self.output.as_deref().or(default)
    }

    /// Opens the output of text.
    pub(super) fn text_output(&self) -> io::Result<Box<dyn Write>> {
        match self.output_file() {
            Some(file) => Ok(Box::new(BufWriter::new(File::create(file)?))),
            None => Ok(Box::new(BufWriter::new(io::stdout()))),
        }
    }
}

pub(super) fn write_failure(file: &Path, error: &io::Error) -> Failure {
    Failure::Failed(format!("{}: could not write: {error}; choose another --output", file.display()))
}

/// Names and values for the metadata of a Parquet file.
pub(super) type FileMetadata = Vec<(String, String)>;

/// Output of rows.
pub(super) enum RowSink {
    Csv(Box<CsvWriter<Box<dyn Write>>>),
    Lines(Box<dyn Write>),
    #[cfg(feature = "parquet")]
    Parquet(Box<export::ParquetFile<BufWriter<File>>>),
}

impl RowSink {
    /// Begins an output with columns and their first rows; `notes` are the metadata, if the format has any.
    pub(super) fn begin(
        args: &ExportArgs,
        columns: Vec<ExportColumn>,
        notes: impl FnOnce() -> TaskResult<FileMetadata>,
    ) -> Result<Self, ExportEnd> {
        match args.format {
            FormatName::Jsonl => Ok(Self::Lines(args.text_output()?)),
            #[cfg(feature = "parquet")]
            FormatName::Parquet => {
                let output = BufWriter::new(File::create(args.output_file().unwrap_or(Path::new("")))?);
                let begun = export::ParquetFile::begin(output, columns, &notes()?);
                Ok(Self::Parquet(Box::new(begun.map_err(io::Error::other)?)))
            }
            #[cfg(not(feature = "parquet"))]
            FormatName::Parquet => {
                drop(notes);
                Err(Failure::Usage("this wingd was built without Parquet; use --format csv".into()).into())
            }
            FormatName::Csv | FormatName::Vtk | FormatName::Netcdf | FormatName::Npz => {
                Ok(Self::Csv(Box::new(CsvWriter::begin(args.text_output()?, &columns).map_err(io_error_from_csv)?)))
            }
        }
    }

    /// Writes rows as CSV, lines of JSON, or a row group of Parquet.
    pub(super) fn add_rows(&mut self, rows: Vec<ExportColumn>) -> io::Result<()> {
        match self {
            Self::Csv(csv) => csv.add(&rows).map_err(io_error_from_csv),
            Self::Lines(output) => export::write_json_rows(output, &rows),
            #[cfg(feature = "parquet")]
            Self::Parquet(file) => file.add(rows).map_err(io::Error::other),
        }
    }

    /// Writes buffered rows and closes the output.
    pub(super) fn finish(self) -> io::Result<()> {
        match self {
            Self::Csv(csv) => csv.end().map_err(io_error_from_csv),
            Self::Lines(mut output) => output.flush(),
            #[cfg(feature = "parquet")]
            Self::Parquet(file) => file.end().map_err(io::Error::other)?.flush(),
        }
    }
}

fn io_error_from_csv(error: csv::Error) -> io::Error {
    if !error.is_io_error() {
        return io::Error::other(error);
    }
    match error.into_kind() {
        csv::ErrorKind::Io(error) => error,
        _ => io::ErrorKind::Other.into(),
    }
}

/// Prints the path of the file, or returns the failure; a closed pipe (`| head`) is not an error.
pub(super) fn finish_export<T: Default>(args: &ExportArgs, outcome: Result<T, ExportEnd>) -> TaskResult<T> {
    let file = args.output_file();
    match outcome {
        Err(ExportEnd::Output(error)) if file.is_none() && error.kind() == io::ErrorKind::BrokenPipe => {
            Ok(T::default())
        }
        Err(ExportEnd::Output(error)) => Err(write_failure(file.unwrap_or(Path::new("standard output")), &error)),
        Err(ExportEnd::Failed(failure)) => Err(failure),
        Ok(value) => {
            file.map_or(Ok(()), |file| print_line(&file.display().to_string()))?;
            Ok(value)
        }
    }
}
