//! Output of an export: rows to a file or standard output, as CSV, JSON lines or Parquet.

use std::io::{self, BufWriter, Stdout, Write};
use std::path::Path;

use super::{ExportArgs, FormatName};
use crate::export;
use crate::export::{CsvWriter, ExportColumn};
use wingd_base::failure::{Failure, TaskResult};
use wingd_base::output::print_line;
use wingd_base::pending_file::PendingFile;
use wingd_store::StoreError;

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
        let default =
            matches!(self.format, FormatName::Parquet).then_some(Path::new("export.parquet"));
        self.output.as_deref().or(default)
    }

    /// Opens the output.
    pub(super) fn open_output(&self) -> io::Result<BufWriter<ExportOutput>> {
        let output = match self.output_file() {
            Some(file) => ExportOutput::File(PendingFile::create_output(file)?),
            None => ExportOutput::Stdout(io::stdout()),
        };
        Ok(BufWriter::new(output))
    }
}

/// Standard output or a file, which gets its name when it is complete.
pub(super) enum ExportOutput {
    Stdout(Stdout),
    File(PendingFile),
}

impl Write for ExportOutput {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Stdout(output) => output.write(bytes),
            Self::File(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Stdout(output) => output.flush(),
            Self::File(file) => file.flush(),
        }
    }
}

/// Flushes the output and gives the file its name.
pub(super) fn end_output(output: BufWriter<ExportOutput>) -> io::Result<()> {
    match output
        .into_inner()
        .map_err(io::IntoInnerError::into_error)?
    {
        ExportOutput::Stdout(mut output) => output.flush(),
        ExportOutput::File(file) => file.commit(),
    }
}

pub(super) fn write_failure(file: &Path, error: &io::Error) -> Failure {
    Failure::Failed(format!(
        "{}: could not write: {error}; choose another --output",
        file.display()
    ))
}

/// Names and values for the metadata of a Parquet file.
pub(super) type FileMetadata = Vec<(String, String)>;

/// Output of rows.
pub(super) enum RowSink {
    Csv(Box<CsvWriter<BufWriter<ExportOutput>>>),
    Lines(BufWriter<ExportOutput>),
    #[cfg(feature = "parquet")]
    Parquet(Box<export::ParquetFile<BufWriter<ExportOutput>>>),
}

impl RowSink {
    /// Begins an output with columns and their first rows; `notes` are the metadata, if the format has any.
    pub(super) fn begin(
        args: &ExportArgs,
        columns: Vec<ExportColumn>,
        notes: impl FnOnce() -> TaskResult<FileMetadata>,
    ) -> Result<Self, ExportEnd> {
        match args.format {
            FormatName::Jsonl => Ok(Self::Lines(args.open_output()?)),
            #[cfg(feature = "parquet")]
            FormatName::Parquet => {
                let begun = export::ParquetFile::begin(args.open_output()?, columns, &notes()?);
                Ok(Self::Parquet(Box::new(begun.map_err(io::Error::other)?)))
            }
            #[cfg(not(feature = "parquet"))]
            FormatName::Parquet => {
                drop(notes);
                Err(
                    Failure::Usage("this wingd was built without Parquet; use --format csv".into())
                        .into(),
                )
            }
            FormatName::Csv | FormatName::Netcdf => Ok(Self::Csv(Box::new(
                CsvWriter::begin(args.open_output()?, &columns).map_err(io_error_from_csv)?,
            ))),
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

    /// Writes buffered rows and gives the file its name.
    pub(super) fn finish(self) -> io::Result<()> {
        match self {
            Self::Csv(csv) => end_output(csv.end()?),
            Self::Lines(output) => end_output(output),
            #[cfg(feature = "parquet")]
            Self::Parquet(file) => end_output(file.end().map_err(io::Error::other)?),
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
pub(super) fn finish_export<T: Default>(
    args: &ExportArgs,
    outcome: Result<T, ExportEnd>,
) -> TaskResult<T> {
    let file = args.output_file();
    match outcome {
        Err(ExportEnd::Output(error))
            if file.is_none() && error.kind() == io::ErrorKind::BrokenPipe =>
        {
            Ok(T::default())
        }
        Err(ExportEnd::Output(error)) => Err(write_failure(
            file.unwrap_or(Path::new("standard output")),
            &error,
        )),
        Err(ExportEnd::Failed(failure)) => Err(failure),
        Ok(value) => {
            file.map_or(Ok(()), |file| print_line(&file.display().to_string()))?;
            Ok(value)
        }
    }
}
