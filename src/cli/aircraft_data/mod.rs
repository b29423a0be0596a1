//! `wingd aircraft-data`: a table of the aircraft's own data, taken into a flight after it, listed, or withdrawn.

mod list;
mod take;

use std::path::PathBuf;
use std::sync::Arc;

use super::stores::flights;
use super::{Done, Failure, print};
use crate::clock::{Clock, System};
use crate::report::aircraft::{self, Withdrawal};
use crate::store::{FlightRef, RealDisk, Store, StoreConfig, StoreError};

/// Take a table of the aircraft's own data into a flight; its lines are kept as they are, beside those that are there.
/// Of several sources that tell a quantity at a frame the latest that was not withdrawn counts
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// The table: CSV with a header, or lines of IWG1
    #[arg(required_unless_present_any = ["list", "withdraw"], conflicts_with_all = ["list", "withdraw"])]
    table: Option<PathBuf>,
    /// Which column is which quantity, TOML (docs/aircraft-data.md)
    #[arg(long, value_name = "FILE", required_unless_present_any = ["list", "withdraw"])]
    mapping: Option<PathBuf>,
    /// The flight, for example f0001
    #[arg(long)]
    flight: String,
    /// The flight's sources of aircraft data, with the frames at which each counts
    #[arg(long, conflicts_with = "withdraw")]
    list: bool,
    /// A source, by its number in --list, that does not count any more; it stays in the flight
    #[arg(long, value_name = "SOURCE")]
    withdraw: Option<usize>,
    /// One JSON object: flight, source, lines, read, samples, repeated, frames, quantities; with --list flight, sources
    #[arg(long)]
    json: bool,
}

fn undone(error: StoreError) -> Failure {
    Failure::Failed(error.to_string())
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let found = flights(&args.store, Some(&args.flight))?;
    let flight =
        found.first().ok_or_else(|| Failure::Failed(format!("there is no flight {}", args.flight)))?;
    match (args.withdraw, &args.table, &args.mapping) {
        (Some(source), ..) => withdraw(args, flight, source),
        (None, Some(table), Some(mapping)) if !args.list => take::run(args, flight, table, mapping),
        _ => list::run(args, flight),
    }
}

/// The store, which no recorder writes meanwhile.
fn open(args: &Args) -> Result<Store, Failure> {
    let config = StoreConfig { reserve_mb: 0, ..StoreConfig::at(&args.store) };
    Store::open(Arc::new(RealDisk), config).map(|(store, _)| store).map_err(undone)
}

fn withdraw(args: &Args, flight: &FlightRef, number: usize) -> Result<Done, Failure> {
    let store = open(args)?;
    let (sources, _) = aircraft::sources(store.disk(), store.root(), flight).map_err(undone)?;
    let name = match sources.iter().find(|source| source.number == number) {
        None => {
            let known = format!("{} has {} sources of aircraft data", flight.id, sources.len());
            return Err(Failure::Failed(format!("there is no source {number}: {known}; see --list")));
        }
        Some(source) if source.withdrawn.is_some() => {
            return Err(Failure::Failed(format!("source {number} is withdrawn already; see --list")));
        }
        Some(source) => source.name(),
    };
    let withdrawal = Withdrawal { withdraws: number, at: System::new().stamp().utc };
    let head = serde_json::to_value(withdrawal).map_err(|e| Failure::Failed(e.to_string()))?;
    store.add_aircraft_to(&flight.id, &head, &[]).map_err(undone)?;
    store.close_aircraft().map_err(undone)?;
    print(&match args.json {
        true => serde_json::json!({"flight": flight.id, "withdrawn": number}).to_string(),
        false => format!(
            "{}: source {number} ({name}) does not count any more; run `wingd solve {} --flight {}` for results without it",
            flight.id,
            args.store.display(),
            flight.id
        ),
    })?;
    Ok(Done::All)
}
