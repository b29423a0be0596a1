//! `wingd export` writes a store's results for other tools.

mod live;
mod sink;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::ValueEnum;

use self::sink::{Notes, Sink, cannot_write, ended};
use super::{Done, Failure, print, stores};
use crate::installation;
use crate::record::TorsionRecord;
use crate::report::export::{self, Common, Table};
use crate::report::source::{self, Choice};
use crate::report::{GroundMarker, ReportData, SeriesData, Site, distinct, summary};
use crate::store::{FlightRef, RealDisk, catalogue, layout, result_summary};

#[derive(Clone, Copy, ValueEnum)]
enum FormatName {
    /// A table with a heading line
    Csv,
    /// The same table, typed columns, times as UTC timestamps
    Parquet,
    /// Shapes: a .vtp per frame, a .pvd per flight, the ground, a mean .vtu and .vtk per series (ParaView)
    Vtk,
    /// One JSON object per shot, with its whole record
    Jsonl,
}

#[derive(Clone, Copy, Default, ValueEnum)]
enum TableName {
    /// One row per marker per image
    #[default]
    Markers,
    /// One row per point of the curve along the span per image
    Span,
    /// One row per parameter of the model per image
    Parameters,
    /// One row per shot, those without a frame too
    Shots,
    /// One row per result of live mode; of jsonl too
    Live,
}

impl From<TableName> for Option<Table> {
    fn from(name: TableName) -> Self {
        match name {
            TableName::Markers => Some(Table::Markers),
            TableName::Span => Some(Table::Span),
            TableName::Parameters => Some(Table::Parameters),
            TableName::Shots => Some(Table::Shots),
            TableName::Live => None,
        }
    }
}

/// Export a store's results for other tools.
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// Of the output
    #[arg(long, value_enum)]
    format: FormatName,
    /// Rows of csv and parquet
    #[arg(long, value_enum, default_value = "markers")]
    table: TableName,
    /// One flight, for example f0001 [default: all of them]
    #[arg(long)]
    flight: Option<String>,
    /// Of a flight with results of several inputs: those whose key begins so [default: the newest whole solve]
    #[arg(long, value_name = "KEY")]
    inputs: Option<String>,
    /// The installation, for the ground shape of vtk [default: the one kept in the store]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// File, or folder for vtk [default: csv and jsonl to standard output, export.parquet, export-vtk]
    #[arg(long, short, value_name = "PATH")]
    output: Option<PathBuf>,
}

impl Args {
    fn choice(&self) -> Choice<'_> {
        Choice { flight: self.flight.as_deref(), inputs: self.inputs.as_deref() }
    }
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let Some(table) = Option::<Table>::from(args.table) else { return live::run(args) };
    let said = match args.format {
        FormatName::Csv | FormatName::Parquet => rows(args, table)?,
        FormatName::Vtk => vtk(args)?,
        FormatName::Jsonl => jsonl(args)?,
    };
    for note in said.warnings.iter().chain(&said.notes) {
        eprintln!("wingd: {note}");
    }
    Ok(Done::all(said.notes.is_empty()))
}

/// What is common to all rows: torsion pairs are found by a first look through the results.
fn common(args: &Args) -> Result<Common, Failure> {
    let mut names: Vec<String> = Vec::new();
    for flight in source::chosen(&args.store, args.flight.as_deref())? {
        for series in catalogue::series(&RealDisk, &flight)? {
            let bytes = fs::read(series.folder.join(layout::RESULTS_FILE)).unwrap_or_default();
            for head in result_summary::parse(&bytes, &["torsion"]) {
                let torsion = head.record.into_values().next().map(serde_json::from_value);
                let torsion: Vec<TorsionRecord> = torsion.and_then(Result::ok).unwrap_or_default();
                names = distinct(names.into_iter().chain(torsion.into_iter().map(|pair| pair.name)));
            }
        }
    }
    Ok(Common { store_id: catalogue::store_id(&RealDisk, &args.store), pairs: names })
}

/// The table's rows, series by series.
fn rows(args: &Args, table: Table) -> Result<ReportData, Failure> {
    let common = common(args)?;
    let empty = export::columns(table, &SeriesData::default(), &common);
    let written = || {
        let mut sink = Sink::begin(args, empty, || notes(args, &common))?;
        let said = source::each(&args.store, args.choice(), |series| {
            sink.add(args, export::columns(table, &series, &common))
        })?;
        sink.end(args)?;
        Ok(said)
    };
    ended(args, written())
}

fn jsonl(args: &Args) -> Result<ReportData, Failure> {
    let id = catalogue::store_id(&RealDisk, &args.store);
    let written = || {
        let mut output = args.text_output()?;
        let said = source::each(&args.store, args.choice(), |series| {
            export::lines(&mut output, &series, id.as_deref()).map_err(|error| args.stopped(&error))
        })?;
        output.flush().map_err(|error| args.stopped(&error))?;
        Ok(said)
    };
    ended(args, written())
}

/// Who recorded.
fn recorder_notes(store_id: Option<&str>) -> Notes {
    let units = "m, deg, px, s by the ending of a column's name; columns: docs/tables.md";
    vec![
        ("program".to_owned(), format!("wingd {}", env!("CARGO_PKG_VERSION"))),
        ("schema_version".to_owned(), export::SCHEMA_VERSION.to_string()),
        ("recorder_id".to_owned(), store_id.unwrap_or_default().to_owned()),
        ("units".to_owned(), units.to_owned()),
    ]
}

/// The file's own metadata: who recorded, and what the results follow from, by the key in column `inputs`.
fn notes(args: &Args, common: &Common) -> Result<Notes, Failure> {
    let mut notes = recorder_notes(common.store_id.as_deref());
    for flight in source::chosen(&args.store, args.flight.as_deref())? {
        if let Some(set) = crate::store::sets::of_flight(&RealDisk, &flight)?.chosen(args.inputs.as_deref()) {
            let provenance = serde_json::to_string(&set.provenance).unwrap_or_default();
            let note = (format!("inputs {}", set.key), provenance);
            if !notes.contains(&note) {
                notes.push(note);
            }
        }
    }
    Ok(notes)
}

fn vtk(args: &Args) -> Result<ReportData, Failure> {
    let folder = args.output.as_deref().unwrap_or(Path::new("export-vtk"));
    let mut said = ReportData::default();
    for flight in source::chosen(&args.store, args.flight.as_deref())? {
        let one = vtk_flight(args, &flight, folder)?;
        said.notes.extend(one.notes);
        said.warnings.extend(one.warnings);
    }
    Ok(said)
}

/// The survey that displacements count from.
fn ground(args: &Args, flight: &FlightRef) -> Result<Vec<GroundMarker>, Failure> {
    let directory = match &args.installation {
        Some(directory) => Some(directory.clone()),
        None => stores::kept(&args.store, flight)?,
    };
    let Some(directory) = directory else {
        let flight = &flight.id;
        eprintln!(
            "wingd: {flight}: no installation is kept; name one with --installation for displacement vectors"
        );
        return Ok(Vec::new());
    };
    let installation = installation::load_without_orientation(&directory)?;
    Ok(Site::from(&installation.setup).ground)
}

fn vtk_flight(args: &Args, flight: &FlightRef, folder: &Path) -> Result<ReportData, Failure> {
    let ground = ground(args, flight)?;
    let below = folder.join(&flight.id);
    fs::create_dir_all(&below).map_err(|e| cannot_write(&below, &e))?;
    if !ground.is_empty() {
        write(&folder.join(format!("{}-ground.vtp", flight.id)), &export::ground_shape(&ground).vtp(None))?;
    }
    let (mut files, mut first) = (Vec::new(), None);
    let choice = Choice { flight: Some(&flight.id), inputs: args.inputs.as_deref() };
    let said = source::each(&args.store, choice, |series| {
        if summary::solved(&series).is_empty() {
            eprintln!("wingd: {}/{}: no solved frame, left out", series.flight, series.name);
            return Ok(());
        }
        let name = format!("{}-{}", series.flight, series.name);
        if let Some(text) = export::vtk(&series) {
            write(&folder.join(format!("{name}.vtk")), &text)?;
        }
        write(&folder.join(format!("{name}.vtu")), &export::series_shape(&series, &ground).vtu())?;
        for record in summary::solved(&series) {
            let Some(stamp) = series.shot_of(record).and_then(|s| s.stamp.clone()) else { continue };
            let began = first.get_or_insert_with(|| stamp.clone());
            let time_s = 3600.0 * summary::hours_between(began, &stamp);
            let stem = record.image.split('.').next().unwrap_or_default();
            let file = format!("{}-{stem}.vtp", series.name);
            let shape = export::frame_shape(record, &ground);
            fs::write(below.join(&file), shape.vtp(Some(time_s))).map_err(|e| cannot_write(&below, &e))?;
            files.push((time_s, format!("{}/{file}", flight.id)));
        }
        Result::<(), Failure>::Ok(())
    })?;
    write(&folder.join(format!("{}.pvd", flight.id)), &export::collection(&files))?;
    Ok(said)
}

/// Writes a file and says where it is.
fn write(file: &Path, text: &str) -> Result<(), Failure> {
    fs::write(file, text).map_err(|e| cannot_write(file, &e))?;
    print(&file.display().to_string())
}
