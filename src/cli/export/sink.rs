//! Output of an export: rows to a file or standard output, as CSV, JSON lines or Parquet.

use std::fmt::Display;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use super::{ExportArgs, FormatName};
use crate::cli::{Failure, print_line};
use crate::report::export::{self, CsvWriter, ExportColumn};

/// Reason why an export ended early.
pub(super) enum ExportEnd {
    /// Closed pipe (`| head`): not an error.
    Pipe,
    /// Error of an output or of a store.
    Failed(Failure),
}

impl<E: Into<Failure>> From<E> for ExportEnd {
    fn from(failure: E) -> Self {
        Self::Failed(failure.into())
    }
}

/// Output of rows.
pub(super) enum RowSink {
    Csv(CsvWriter<Box<dyn Write>>),
    Lines(Box<dyn Write>),
    #[cfg(feature = "parquet")]
    Parquet(export::ParquetFile<BufWriter<File>>),
}

impl ExportArgs {
    /// Returns the file to write; `None` for standard output.
    fn output_file(&self) -> Option<&Path> {
        let default = matches!(self.format, FormatName::Parquet).then_some(Path::new("export.parquet"));
        self.output.as_deref().or(default)
    }

    /// Opens the output of text.
    pub(super) fn text_output(&self) -> Result<Box<dyn Write>, Failure> {
        match self.output_file() {
            Some(file) => Ok(Box::new(BufWriter::new(create_file(file)?))),
            None => Ok(Box::new(BufWriter::new(io::stdout()))),
        }
    }

    /// Distinguishes an error of the output from a closed pipe.
    fn classify_error(&self, error: &dyn Display, kind: Option<io::ErrorKind>) -> ExportEnd {
        match self.output_file() {
            None if kind == Some(io::ErrorKind::BrokenPipe) => ExportEnd::Pipe,
            place => ExportEnd::Failed(write_failure(place.unwrap_or(Path::new("standard output")), error)),
        }
    }

    /// Distinguishes an I/O error of the output from a closed pipe.
    pub(super) fn classify_io_error(&self, error: &io::Error) -> ExportEnd {
        self.classify_error(error, Some(error.kind()))
    }

    fn classify_csv_error(&self, error: &csv::Error) -> ExportEnd {
        let kind = match error.kind() {
            csv::ErrorKind::Io(error) => Some(error.kind()),
            _ => None,
        };
        self.classify_error(error, kind)
    }
}

fn create_file(file: &Path) -> Result<File, Failure> {
    File::create(file).map_err(|e| write_failure(file, &e))
}

pub(super) fn write_failure(file: &Path, error: &dyn Display) -> Failure {
    Failure::Failed(format!("{}: could not write: {error}; choose another --output", file.display()))
}

/// Names and values for the metadata of a Parquet file.
pub(super) type FileMetadata = Vec<(String, String)>;

impl RowSink {
    /// Begins an output with columns and their first rows; `notes` are the metadata, if the format has any.
    pub(super) fn begin(
        args: &ExportArgs,
        columns: Vec<ExportColumn>,
        notes: impl FnOnce() -> Result<FileMetadata, Failure>,
    ) -> Result<Self, ExportEnd> {
        match args.format {
            FormatName::Jsonl => Ok(Self::Lines(args.text_output()?)),
            FormatName::Parquet => Self::begin_parquet(args, columns, notes),
            FormatName::Csv | FormatName::Vtk => {
                let begun = CsvWriter::begin(args.text_output()?, &columns);
                begun.map(Self::Csv).map_err(|error| args.classify_csv_error(&error))
            }
        }
    }

    #[cfg(feature = "parquet")]
    fn begin_parquet(
        args: &ExportArgs,
        columns: Vec<ExportColumn>,
        notes: impl FnOnce() -> Result<FileMetadata, Failure>,
    ) -> Result<Self, ExportEnd> {
        let output = BufWriter::new(create_file(args.output_file().unwrap_or(Path::new("")))?);
        let begun = export::ParquetFile::begin(output, columns, &notes()?);
        begun.map(Self::Parquet).map_err(|error| args.classify_error(&error, None))
    }

    #[cfg(not(feature = "parquet"))]
    fn begin_parquet(
        _: &ExportArgs,
        _: Vec<ExportColumn>,
        _: impl FnOnce() -> Result<FileMetadata, Failure>,
    ) -> Result<Self, ExportEnd> {
        Err(Failure::Usage("this wingd was built without Parquet; use --format csv".into()).into())
    }

    pub(super) fn add_rows(&mut self, args: &ExportArgs, rows: Vec<ExportColumn>) -> Result<(), ExportEnd> {
        match self {
            Self::Csv(csv) => csv.add(&rows).map_err(|error| args.classify_csv_error(&error)),
            Self::Lines(output) => {
                export::write_json_rows(output, &rows).map_err(|error| args.classify_io_error(&error))
            }
            #[cfg(feature = "parquet")]
            Self::Parquet(file) => file.add(rows).map_err(|error| args.classify_error(&error, None)),
        }
    }

    /// Writes buffered rows and closes the output.
    pub(super) fn finish(self, args: &ExportArgs) -> Result<(), ExportEnd> {
        match self {
            Self::Csv(csv) => csv.end().map_err(|error| args.classify_csv_error(&error)),
            Self::Lines(mut output) => output.flush().map_err(|error| args.classify_io_error(&error)),
            #[cfg(feature = "parquet")]
            Self::Parquet(file) => {
                let mut output = file.end().map_err(|error| args.classify_error(&error, None))?;
                output.flush().map_err(|error| args.classify_io_error(&error))
            }
        }
    }
}

/// Prints the path of the file, or returns the failure; a closed pipe is not an error.
pub(super) fn finish_export<T: Default>(args: &ExportArgs, outcome: Result<T, ExportEnd>) -> Result<T, Failure> {
    match outcome {
        Err(ExportEnd::Pipe) => Ok(T::default()),
        Err(ExportEnd::Failed(failure)) => Err(failure),
        Ok(value) => {
            args.output_file().map_or(Ok(()), |file| print_line(&file.display().to_string()))?;
            Ok(value)
        }
    }
}
