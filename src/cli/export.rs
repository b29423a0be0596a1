//! `wingd export`: a store's results for other tools.

use std::fs;
use std::path::{Path, PathBuf};

use clap::ValueEnum;

use super::{Done, Failure, print};
use crate::report::{ReportData, export, source};

#[derive(Clone, Copy, ValueEnum)]
enum FormatName {
    /// One row per marker per image
    Csv,
    /// The same table, typed columns
    Parquet,
    /// Mean positions with lift and standard deviation, one file per series (ParaView)
    Vtk,
}

/// Export a store's results for other tools.
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// Of the output
    #[arg(long, value_enum)]
    format: FormatName,
    /// File, or folder for vtk [default: csv to standard output, export.parquet, export-vtk]
    #[arg(long, short, value_name = "PATH")]
    output: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let data = source::all(&args.store).map_err(|e| Failure::Undone(e.to_string()))?;
    for note in &data.notes {
        eprintln!("wingd: {note}");
    }
    match args.format {
        FormatName::Csv => csv(args, &data)?,
        FormatName::Parquet => parquet(args, &data)?,
        FormatName::Vtk => vtk(args, &data)?,
    }
    Ok(Done::all(data.notes.is_empty()))
}

fn csv(args: &Args, data: &ReportData) -> Result<(), Failure> {
    let text = export::csv(&export::columns(&data.series)).map_err(|e| Failure::Undone(e.to_string()))?;
    match &args.output {
        Some(file) => write(file, text.as_bytes()),
        None => print(text.trim_end_matches('\n')),
    }
}

#[cfg(feature = "parquet")]
fn parquet(args: &Args, data: &ReportData) -> Result<(), Failure> {
    let bytes =
        export::parquet(&export::columns(&data.series)).map_err(|e| Failure::Undone(e.to_string()))?;
    write(args.output.as_deref().unwrap_or(Path::new("export.parquet")), &bytes)
}

#[cfg(not(feature = "parquet"))]
fn parquet(_: &Args, _: &ReportData) -> Result<(), Failure> {
    Err(Failure::Usage("this wingd was built without Parquet; use --format csv".into()))
}

fn vtk(args: &Args, data: &ReportData) -> Result<(), Failure> {
    let folder = args.output.as_deref().unwrap_or(Path::new("export-vtk"));
    fs::create_dir_all(folder).map_err(|e| {
        Failure::Undone(format!("{}: could not create: {e}; choose another --output", folder.display()))
    })?;
    for series in &data.series {
        match export::vtk(series) {
            Some(text) => {
                write(&folder.join(format!("{}-{}.vtk", series.flight, series.name)), text.as_bytes())?
            }
            None => eprintln!("wingd: {}/{}: no solved frame, left out", series.flight, series.name),
        }
    }
    Ok(())
}

/// Writes a file and says where it is.
fn write(file: &Path, bytes: &[u8]) -> Result<(), Failure> {
    fs::write(file, bytes).map_err(|e| {
        Failure::Undone(format!("{}: could not write: {e}; choose another --output", file.display()))
    })?;
    print(&file.display().to_string())
}
