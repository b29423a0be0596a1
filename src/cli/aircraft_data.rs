//! `wingd aircraft-data` takes a table of the aircraft's own data into a flight after it.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::json;

use super::stores::{self, flights};
use super::{Done, Failure, print};
use crate::aircraft::{Column, Layout, Quantity};
use crate::installation::{self, Fault};
use crate::report::aircraft;
use crate::store::aircraft::AircraftLine;

/// Take a table of the aircraft's own data into a flight: its lines are kept as they are
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// The table, CSV with a header
    table: PathBuf,
    /// Which column is which quantity, TOML (docs/aircraft-data.md)
    #[arg(long, value_name = "FILE")]
    mapping: PathBuf,
    /// The flight, for example f0001
    #[arg(long)]
    flight: String,
    /// One JSON object: flight, lines, read, samples, repeated
    #[arg(long)]
    json: bool,
}

/// The file of `--mapping`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Mapping {
    /// Name of the column with the time tag.
    time: String,
    #[serde(default = "comma")]
    separator: char,
    column: Vec<Named>,
}

fn comma() -> char {
    ','
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Named {
    name: String,
    quantity: Quantity,
    #[serde(default = "one")]
    scale: f64,
    #[serde(default)]
    offset: f64,
}

fn one() -> f64 {
    1.0
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let (mapping, table) = (read(&args.mapping)?, read(&args.table)?);
    let mapping: Mapping = toml::from_str(&mapping).map_err(|error| {
        installation::toml_fault(&args.mapping, &mapping, &error, "see docs/aircraft-data.md")
    })?;
    let mut lines = table.lines();
    let layout = layout(args, &mapping, lines.next().unwrap_or_default())?;
    let lines: Vec<AircraftLine> = lines
        .filter(|line| !line.trim().is_empty())
        .map(|line| AircraftLine { at: None, line: line.to_owned() })
        .collect();
    let read = lines.iter().filter(|line| layout.read(&line.line).is_some()).count();
    if read == 0 {
        let problem = format!("none of its {} lines has a time in column {}", lines.len(), mapping.time);
        let mend = "write times as 2026-03-01T06:00:00Z, or as seconds since 1970";
        return Err(Fault::new(&args.table, &mapping.time, problem, mend).into());
    }
    let flight = flights(&args.store, Some(&args.flight))?;
    let (store, _) = stores::open(&args.store)?;
    let source =
        json!({"table": args.table.file_name().map(|name| name.to_string_lossy()), "layout": layout});
    for chunk in lines.chunks(CHUNK) {
        store.add_aircraft_to(&args.flight, &source, chunk)?;
    }
    store.close_aircraft()?;
    for flight in &flight {
        let (track, _) = aircraft::track(store.disk(), store.root(), flight)?;
        let (samples, repeated) = (track.len(), track.unused.repeated);
        let (id, kept) = (&flight.id, lines.len());
        let answer =
            json!({"flight": id, "lines": kept, "read": read, "samples": samples, "repeated": repeated});
        print(&match args.json {
            true => answer.to_string(),
            false => format!(
                "{id}: {kept} lines kept, {read} read; {samples} samples in all, {repeated} of a time that was there before"
            ),
        })?;
    }
    Ok(Done::all(read == lines.len()))
}

/// Lines that are made durable together.
const CHUNK: usize = 5000;

fn read(file: &Path) -> Result<String, Fault> {
    let text = std::fs::read_to_string(file).map_err(|e| {
        Fault::new(file, "file", format!("cannot be read ({e})"), "name a file of UTF-8 text")
    })?;
    Ok(text.trim_start_matches('\u{feff}').to_owned())
}

fn layout(args: &Args, mapping: &Mapping, header: &str) -> Result<Layout, Vec<Fault>> {
    let names: Vec<&str> = header.split(mapping.separator).map(str::trim).collect();
    let mut faults = Vec::new();
    let mut field = |name: &str| {
        let place = names.iter().position(|known| *known == name);
        if place.is_none() {
            let problem = format!("there is no column {name} in {}", args.table.display());
            faults.push(Fault::new(
                &args.mapping,
                name,
                problem,
                format!("its header has {}", names.join(", ")),
            ));
        }
        place.map_or(0, |k| k + 1)
    };
    let time_field = field(&mapping.time);
    let taken =
        |c: &Named| Column { field: field(&c.name), quantity: c.quantity, scale: c.scale, offset: c.offset };
    let column: Vec<Column> = mapping.column.iter().map(taken).collect();
    let sound = |c: &Column| c.scale.is_finite() && c.scale != 0.0 && c.offset.is_finite();
    if column.is_empty() || !column.iter().all(sound) {
        let problem = "has no column, or a scale of 0".to_owned();
        faults.push(Fault::new(
            &args.mapping,
            "column",
            problem,
            "give name, quantity, and a scale other than 0",
        ));
    }
    let layout = Layout { begins_with: None, separator: mapping.separator, time_field, column };
    if faults.is_empty() { Ok(layout) } else { Err(faults) }
}
