//! `wingd export --table live`: a block at a time, so that an hour of results takes no more memory than a minute.

use std::io::{self, Write};
use std::path::PathBuf;

use super::{Args, FormatName, cannot_write, text_output};
use crate::cli::copy::bar;
use crate::cli::{Done, Failure, print};
use crate::report::export::{self, Column, Csv, LiveColumns};
use crate::report::source;
use crate::store::{RealDisk, StoreError, catalogue, live};

/// Why rows end early.
enum Stop {
    /// Nobody reads on (`| head`): no fault.
    Pipe,
    Failed(Failure),
}

impl From<StoreError> for Stop {
    fn from(error: StoreError) -> Self {
        Self::Failed(error.into())
    }
}

/// Where rows go.
enum Sink {
    Csv(Csv<Box<dyn Write>>),
    Lines(Box<dyn Write>),
    #[cfg(feature = "parquet")]
    Parquet(export::ParquetFile<io::BufWriter<std::fs::File>>),
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    usage(args)?;
    let flights = source::chosen(&args.store, args.flight.as_deref())?;
    let (mut tables, mut bytes) = (Vec::new(), 0);
    for flight in &flights {
        live::each_file(&RealDisk, &args.store, flight, |file| {
            bytes += file.length() as u64;
            if !tables.contains(&file.head.table) {
                tables.push(file.head.table);
            }
            Result::<usize, StoreError>::Ok(0)
        })?;
    }
    if tables.is_empty() {
        let what = format!(
            "{}: there are no live results; [live] in the configuration makes some",
            args.store.display()
        );
        return Err(Failure::Undone(what));
    }
    let columns = LiveColumns::of(&tables, catalogue::store_id(&RealDisk, &args.store));
    let mut sink = Sink::begin(args, columns.empty())?;
    let bar = bar(bytes, "live results");
    let mut notes = Vec::new();
    let outcome = flights.iter().try_for_each(|flight| {
        notes.extend(live::each_file(&RealDisk, &args.store, flight, |mut file| {
            bar.inc(file.length() as u64);
            let head = file.head.clone();
            while let Some(block) = file.next_block() {
                match columns.rows(&head, &block) {
                    Some(rows) => sink.add(args, rows)?,
                    None => return Ok(file.torn().max(1)),
                }
            }
            Result::<usize, Stop>::Ok(file.torn())
        })?);
        Ok(())
    });
    bar.finish_and_clear();
    match outcome.and_then(|()| sink.end(args)) {
        Ok(()) => args.output.as_ref().map_or(Ok(()), |file| print(&file.display().to_string()))?,
        Err(Stop::Pipe) => {}
        Err(Stop::Failed(failure)) => return Err(failure),
    }
    notes.iter().for_each(|note| eprintln!("wingd: {note}"));
    Ok(Done::all(notes.is_empty()))
}

fn usage(args: &Args) -> Result<(), Failure> {
    let wrong = match args.format {
        FormatName::Vtk => {
            Some("--format vtk has shapes of frames; take csv, parquet or jsonl for live results")
        }
        _ if args.inputs.is_some() => Some("--inputs: live results are not solved again; leave it out"),
        _ => args.installation.is_some().then_some("--installation is for vtk alone; leave it out"),
    };
    wrong.map_or(Ok(()), |what| Err(Failure::Usage(what.to_owned())))
}

/// A reader that went away, or a fault of the output.
fn stop(args: &Args, error: &dyn std::fmt::Display, kind: Option<io::ErrorKind>) -> Stop {
    if args.output.is_none() && kind == Some(io::ErrorKind::BrokenPipe) {
        return Stop::Pipe;
    }
    let place = args.output.clone().unwrap_or_else(|| PathBuf::from("standard output"));
    Stop::Failed(cannot_write(&place, error))
}

fn of_csv(args: &Args, error: &csv::Error) -> Stop {
    let kind = match error.kind() {
        csv::ErrorKind::Io(error) => Some(error.kind()),
        _ => None,
    };
    stop(args, error, kind)
}

impl Sink {
    fn begin(args: &Args, columns: Vec<Column>) -> Result<Self, Failure> {
        match args.format {
            FormatName::Jsonl => Ok(Self::Lines(text_output(args)?)),
            FormatName::Parquet => Self::parquet(args, columns),
            FormatName::Csv | FormatName::Vtk => {
                let begun = Csv::begin(text_output(args)?, &columns);
                begun
                    .map(Self::Csv)
                    .map_err(|error| cannot_write(&args.output.clone().unwrap_or_default(), &error))
            }
        }
    }

    #[cfg(feature = "parquet")]
    fn parquet(args: &Args, columns: Vec<Column>) -> Result<Self, Failure> {
        let file = super::parquet_place(args);
        let output = io::BufWriter::new(super::create(file)?);
        let notes = super::recorder_notes(catalogue::store_id(&RealDisk, &args.store).as_deref());
        let begun = export::ParquetFile::begin(output, columns, &notes);
        begun.map(Self::Parquet).map_err(|error| cannot_write(file, &error))
    }

    #[cfg(not(feature = "parquet"))]
    fn parquet(_: &Args, _: Vec<Column>) -> Result<Self, Failure> {
        Err(super::without_parquet())
    }

    fn add(&mut self, args: &Args, rows: Vec<Column>) -> Result<(), Stop> {
        match self {
            Self::Csv(csv) => csv.add(&rows).map_err(|error| of_csv(args, &error)),
            Self::Lines(output) => {
                export::json_rows(output, &rows).map_err(|error| stop(args, &error, Some(error.kind())))
            }
            #[cfg(feature = "parquet")]
            Self::Parquet(file) => {
                file.add(rows).map_err(|e| Stop::Failed(cannot_write(super::parquet_place(args), &e)))
            }
        }
    }

    fn end(self, args: &Args) -> Result<(), Stop> {
        match self {
            Self::Csv(csv) => csv.end().map_err(|error| of_csv(args, &error)),
            Self::Lines(mut output) => output.flush().map_err(|error| stop(args, &error, Some(error.kind()))),
            #[cfg(feature = "parquet")]
            Self::Parquet(file) => {
                let place = super::parquet_place(args);
                let mut output = file.end().map_err(|e| Stop::Failed(cannot_write(place, &e)))?;
                output.flush().map_err(|e| Stop::Failed(cannot_write(place, &e)))?;
                if args.output.is_none() {
                    print(&place.display().to_string()).map_err(Stop::Failed)
                } else {
                    Ok(())
                }
            }
        }
    }
}
