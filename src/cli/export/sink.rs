//! An export's rows go to a file or to standard output, as CSV, JSON lines or Parquet.

use std::fmt::Display;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use super::{Args, FormatName};
use crate::cli::{Failure, print};
use crate::report::export::{self, Column, Csv};

/// Why rows end early.
pub(super) enum Stop {
    /// Nobody reads on (`| head`): no fault.
    Pipe,
    /// Anything else.
    Failed(Failure),
}

impl<E: Into<Failure>> From<E> for Stop {
    fn from(failure: E) -> Self {
        Self::Failed(failure.into())
    }
}

/// Where rows go.
pub(super) enum Sink {
    Csv(Csv<Box<dyn Write>>),
    Lines(Box<dyn Write>),
    #[cfg(feature = "parquet")]
    Parquet(export::ParquetFile<BufWriter<File>>),
}

impl Args {
    /// The file that is written; `None`: standard output.
    fn place(&self) -> Option<&Path> {
        let default = matches!(self.format, FormatName::Parquet).then_some(Path::new("export.parquet"));
        self.output.as_deref().or(default)
    }

    /// Where text goes.
    pub(super) fn text_output(&self) -> Result<Box<dyn Write>, Failure> {
        match self.place() {
            Some(file) => Ok(Box::new(BufWriter::new(create(file)?))),
            None => Ok(Box::new(BufWriter::new(io::stdout()))),
        }
    }

    /// A fault of the output, or a reader that went away.
    fn stop(&self, error: &dyn Display, kind: Option<io::ErrorKind>) -> Stop {
        match self.place() {
            None if kind == Some(io::ErrorKind::BrokenPipe) => Stop::Pipe,
            place => Stop::Failed(cannot_write(place.unwrap_or(Path::new("standard output")), error)),
        }
    }

    /// The same of text.
    pub(super) fn stopped(&self, error: &io::Error) -> Stop {
        self.stop(error, Some(error.kind()))
    }

    fn stopped_csv(&self, error: &csv::Error) -> Stop {
        let kind = match error.kind() {
            csv::ErrorKind::Io(error) => Some(error.kind()),
            _ => None,
        };
        self.stop(error, kind)
    }
}

fn create(file: &Path) -> Result<File, Failure> {
    File::create(file).map_err(|e| cannot_write(file, &e))
}

pub(super) fn cannot_write(file: &Path, error: &dyn Display) -> Failure {
    Failure::Failed(format!("{}: could not write: {error}; choose another --output", file.display()))
}

/// Name and value for the metadata of a Parquet file.
pub(super) type Notes = Vec<(String, String)>;

impl Sink {
    /// With these columns, whose rows are the first; `notes` go into a file that has room for them.
    pub(super) fn begin(
        args: &Args,
        columns: Vec<Column>,
        notes: impl FnOnce() -> Result<Notes, Failure>,
    ) -> Result<Self, Stop> {
        match args.format {
            FormatName::Jsonl => Ok(Self::Lines(args.text_output()?)),
            FormatName::Parquet => Self::parquet(args, columns, notes),
            FormatName::Csv | FormatName::Vtk => {
                let begun = Csv::begin(args.text_output()?, &columns);
                begun.map(Self::Csv).map_err(|error| args.stopped_csv(&error))
            }
        }
    }

    #[cfg(feature = "parquet")]
    fn parquet(
        args: &Args,
        columns: Vec<Column>,
        notes: impl FnOnce() -> Result<Notes, Failure>,
    ) -> Result<Self, Stop> {
        let output = BufWriter::new(create(args.place().unwrap_or(Path::new("")))?);
        let begun = export::ParquetFile::begin(output, columns, &notes()?);
        begun.map(Self::Parquet).map_err(|error| args.stop(&error, None))
    }

    #[cfg(not(feature = "parquet"))]
    fn parquet(_: &Args, _: Vec<Column>, _: impl FnOnce() -> Result<Notes, Failure>) -> Result<Self, Stop> {
        Err(Failure::Usage("this wingd was built without Parquet; use --format csv".into()).into())
    }

    pub(super) fn add(&mut self, args: &Args, rows: Vec<Column>) -> Result<(), Stop> {
        match self {
            Self::Csv(csv) => csv.add(&rows).map_err(|error| args.stopped_csv(&error)),
            Self::Lines(output) => export::json_rows(output, &rows).map_err(|error| args.stopped(&error)),
            #[cfg(feature = "parquet")]
            Self::Parquet(file) => file.add(rows).map_err(|error| args.stop(&error, None)),
        }
    }

    /// Writes what is left.
    pub(super) fn end(self, args: &Args) -> Result<(), Stop> {
        match self {
            Self::Csv(csv) => csv.end().map_err(|error| args.stopped_csv(&error)),
            Self::Lines(mut output) => output.flush().map_err(|error| args.stopped(&error)),
            #[cfg(feature = "parquet")]
            Self::Parquet(file) => {
                let mut output = file.end().map_err(|error| args.stop(&error, None))?;
                output.flush().map_err(|error| args.stopped(&error))
            }
        }
    }
}

/// What came of it, and where the file is; a reader that went away is no fault.
pub(super) fn ended<T: Default>(args: &Args, outcome: Result<T, Stop>) -> Result<T, Failure> {
    match outcome {
        Err(Stop::Pipe) => Ok(T::default()),
        Err(Stop::Failed(failure)) => Err(failure),
        Ok(said) => {
            args.place().map_or(Ok(()), |file| print(&file.display().to_string()))?;
            Ok(said)
        }
    }
}
