//! Output of an export to a file or standard output.

use std::io::{self, BufWriter, Stdout, Write};
use std::path::Path;

use super::{ExportArgs, FormatName};
use crate::export::{CsvRows, ExportColumn, JsonRows, RowWriter};
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

pub(super) fn write_failure(file: &Path, error: &io::Error) -> Failure {
    Failure::Failed(format!(
        "{}: could not write: {error}; choose another --output",
        file.display()
    ))
}

/// Writes rows of columns, of which `begin` has the first, as CSV, lines of JSON or Parquet.
pub(super) fn write_rows<T: Default>(
    args: &ExportArgs,
    begin: Vec<ExportColumn>,
    write: impl FnOnce(&mut dyn RowWriter) -> Result<T, ExportEnd>,
) -> TaskResult<T> {
    write_output(args, |output| {
        let mut rows: Box<dyn RowWriter> = match args.format {
            FormatName::Jsonl => Box::new(JsonRows(output)),
            FormatName::Parquet => begin_parquet(output, begin)?,
            FormatName::Csv | FormatName::Netcdf => Box::new(CsvRows::begin(output, &begin)?),
        };
        let value = write(&mut *rows)?;
        rows.end()?;
        Ok(value)
    })
}

#[cfg(feature = "parquet")]
fn begin_parquet<'a>(
    output: &'a mut BufWriter<ExportOutput>,
    begin: Vec<ExportColumn>,
) -> Result<Box<dyn RowWriter + 'a>, ExportEnd> {
    let begun = crate::export::ParquetFile::begin(output, begin);
    Ok(Box::new(begun.map_err(io::Error::other)?))
}

#[cfg(not(feature = "parquet"))]
fn begin_parquet<'a>(
    _: &'a mut BufWriter<ExportOutput>,
    _: Vec<ExportColumn>,
) -> Result<Box<dyn RowWriter + 'a>, ExportEnd> {
    let what = "this wingd was built without Parquet; use --format csv";
    Err(Failure::Usage(what.into()).into())
}

/// Writes an output and prints its path; a closed pipe (`| head`) is not an error.
pub(super) fn write_output<T: Default>(
    args: &ExportArgs,
    write: impl FnOnce(&mut BufWriter<ExportOutput>) -> Result<T, ExportEnd>,
) -> TaskResult<T> {
    let file = args.output_file();
    let written = || {
        let mut output = BufWriter::new(match file {
            Some(file) => ExportOutput::File(PendingFile::create_output(file)?),
            None => ExportOutput::Stdout(io::stdout()),
        });
        let value = write(&mut output)?;
        match output
            .into_inner()
            .map_err(io::IntoInnerError::into_error)?
        {
            ExportOutput::Stdout(mut output) => output.flush()?,
            ExportOutput::File(file) => file.commit()?,
        }
        Ok(value)
    };
    match written() {
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
