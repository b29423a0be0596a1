//! `wingd report` shows a flight's figures and tables as one HTML file.

use std::path::PathBuf;

use super::{Done, Failure, frames, print};
use crate::installation;
use crate::report::number::count;
use crate::report::source::{self, Choice};
use crate::report::{html, overview, summary, table};
use crate::store::RealDisk;

/// Write a flight's figures and tables as one HTML file.
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// Which flight, for example f0001 [default: the newest]
    #[arg(long)]
    flight: Option<String>,
    /// All flights on one page: the deflection over time of each
    #[arg(long, conflicts_with_all = ["flight", "inputs", "installation"])]
    all_flights: bool,
    /// Of a flight with results of several inputs: those whose key begins so [default: the newest whole solve]
    #[arg(long, value_name = "KEY")]
    inputs: Option<String>,
    /// The installation, for the ground shape and the lines of sight [default: the one that the store keeps]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// How many frames' pictures it shows, those to be looked at first; each is some 200 kB of the page
    #[arg(long, value_name = "COUNT", default_value_t = source::PICTURES, conflicts_with = "all_flights")]
    pictures: usize,
    /// Every column of the table, however wide [default: those that fit 80 characters]
    #[arg(long)]
    wide: bool,
    /// Where the page goes
    #[arg(long, short, value_name = "FILE", default_value = "report.html")]
    output: PathBuf,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    if args.all_flights {
        return all_flights(args);
    }
    let installation = args.installation.as_deref().map(installation::load_without_orientation);
    let installation = installation.transpose()?;
    let setup = installation.as_ref().map(|i| &i.setup);
    let choice = Choice { flight: args.flight.as_deref(), inputs: args.inputs.as_deref() };
    let busy = frames::busy("reading the store");
    let data = source::flight_with(&args.store, choice, setup, args.pictures)?;
    drop(busy);
    for note in data.warnings.iter().chain(&data.notes) {
        eprintln!("wingd: {note}");
    }
    write(args, &html::page(&data))?;
    print(table::series(&summary::summaries(&data.series), args.wide).trim_end())?;
    print(&format!("\nReport: {}", args.output.display()))?;
    Ok(Done::all(data.notes.is_empty()))
}

fn all_flights(args: &Args) -> Result<Done, Failure> {
    let flights = source::chosen(&args.store, None)?;
    let read = flights.iter().map(|flight| overview::flight(&RealDisk, flight));
    let all = read.collect::<Result<Vec<_>, _>>()?;
    for note in all.iter().flat_map(|f| f.warning.iter().chain(&f.notes)) {
        eprintln!("wingd: {note}");
    }
    write(args, &html::flights(&all))?;
    print(&format!("Report of {}: {}", count(all.len(), "flight"), args.output.display()))?;
    Ok(Done::all(all.iter().all(|f| f.notes.is_empty())))
}

fn write(args: &Args, page: &str) -> Result<(), Failure> {
    std::fs::write(&args.output, page).map_err(|e| {
        let file = args.output.display();
        Failure::Failed(format!("{file}: could not write: {e}; choose another place with --output"))
    })
}
