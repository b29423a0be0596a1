//! `wingd aircraft-data` adds a table of the aircraft's own data to a recorded flight, or lists or withdraws such sources.

mod list;
mod table_import;

use std::path::PathBuf;
use std::sync::Arc;

use super::store_access::select_flights;
use super::{Completion, Failure, print_line};
use crate::clock::{Clock, SystemClock};
use crate::report::aircraft::{self, Withdrawal};
use crate::store::{FlightRef, RealDisk, Store, StoreConfig, StoreError};

/// Add a table of the aircraft's own data to a flight; its lines are kept unchanged, in addition to existing sources.
#[derive(clap::Args)]
pub struct AircraftDataArgs {
    /// Store
    store: PathBuf,
    /// Table: CSV with a header, or lines of IWG1
    #[arg(required_unless_present_any = ["list", "withdraw"], conflicts_with_all = ["list", "withdraw"])]
    table: Option<PathBuf>,
    /// Assignment of columns to quantities, TOML (docs/aircraft-data.md)
    #[arg(long, value_name = "FILE", required_unless_present_any = ["list", "withdraw"])]
    mapping: Option<PathBuf>,
    /// Flight, for example f0001
    #[arg(long)]
    flight: String,
    /// List the flight's sources of aircraft data, and the number of frames that use each
    #[arg(long, conflicts_with = "withdraw")]
    list: bool,
    /// Stop using a source, by its number in --list; its data stay in the flight
    #[arg(long, value_name = "SOURCE")]
    withdraw: Option<usize>,
    /// Print one JSON object: flight, source, lines, read, samples, repeated, frames, quantities; with --list flight,
    /// sources
    #[arg(long)]
    json: bool,
}

fn store_failure(error: StoreError) -> Failure {
    Failure::Failed(error.to_string())
}

pub(super) fn run(args: &AircraftDataArgs) -> Result<Completion, Failure> {
    let found = select_flights(&args.store, Some(&args.flight))?;
    let flight = found.first().ok_or_else(|| Failure::Failed(format!("there is no flight {}", args.flight)))?;
    match (args.withdraw, &args.table, &args.mapping) {
        (Some(source), ..) => withdraw_source(args, flight, source),
        (None, Some(table), Some(mapping)) if !args.list => table_import::import_table(args, flight, table, mapping),
        _ => list::list_sources(args, flight),
    }
}

/// Opens the store; no recorder may write to it at the same time.
fn open_store(args: &AircraftDataArgs) -> Result<Store, Failure> {
    let config = StoreConfig { reserve_mb: 0, ..StoreConfig::new(&args.store) };
    Store::open(Arc::new(RealDisk), config).map(|(store, _)| store).map_err(store_failure)
}

fn withdraw_source(args: &AircraftDataArgs, flight: &FlightRef, number: usize) -> Result<Completion, Failure> {
    let store = open_store(args)?;
    let (sources, _) = aircraft::read_sources(store.disk(), store.root(), flight).map_err(store_failure)?;
    let name = match sources.iter().find(|source| source.number == number) {
        None => {
            let known = format!("{} has {} sources of aircraft data", flight.id, sources.len());
            return Err(Failure::Failed(format!("there is no source {number}: {known}; see --list")));
        }
        Some(source) if source.withdrawn.is_some() => {
            return Err(Failure::Failed(format!("source {number} is already withdrawn; see --list")));
        }
        Some(source) => source.name(),
    };
    let withdrawal = Withdrawal { withdraws: number, at: SystemClock::new().stamp().utc };
    let head = serde_json::to_value(withdrawal).map_err(|e| Failure::Failed(e.to_string()))?;
    store.add_aircraft_lines_to(&flight.id, &head, &[]).map_err(store_failure)?;
    store.close_aircraft_file().map_err(store_failure)?;
    print_line(&match args.json {
        true => serde_json::json!({"flight": flight.id, "withdrawn": number}).to_string(),
        false => format!(
            "{}: source {number} ({name}) is no longer used; run `wingd solve {} --flight {}` for results without it",
            flight.id,
            args.store.display(),
            flight.id
        ),
    })?;
    Ok(Completion::All)
}
