//! `wingd report` writes a flight's figures and tables as one HTML file.

use std::path::PathBuf;

use super::{Completion, Failure, image_batch, print_line};
use crate::installation;
use crate::report::number::count_text;
use crate::report::source::{self, ResultChoice};
use crate::report::{html, overview, summary, table};
use crate::store::RealDisk;

/// Write a flight's figures and tables as one HTML file.
#[derive(clap::Args)]
pub struct ReportArgs {
    /// Store
    store: PathBuf,
    /// Flight, for example f0001 [default: the newest]
    #[arg(long)]
    flight: Option<String>,
    /// Show all flights on one page: the deflection over time of each
    #[arg(long, conflicts_with_all = ["flight", "inputs", "installation"])]
    all_flights: bool,
    /// Results to use if a flight was solved with several inputs: first characters of their key [default: newest complete
    /// solve]
    #[arg(long, value_name = "KEY")]
    inputs: Option<String>,
    /// Installation, for the ground shape and the lines of sight [default: the one kept in the store]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Number of frames shown as images, those with warnings first; each adds about 200 kB to the page
    #[arg(long, value_name = "COUNT", default_value_t = source::DEFAULT_PICTURES, conflicts_with = "all_flights")]
    pictures: usize,
    /// Show all columns of the table [default: those that fit 80 characters]
    #[arg(long)]
    wide: bool,
    /// File for the page
    #[arg(long, short, value_name = "FILE", default_value = "report.html")]
    output: PathBuf,
}

pub(super) fn run(args: &ReportArgs) -> Result<Completion, Failure> {
    if args.all_flights {
        return report_all_flights(args);
    }
    let installation = args.installation.as_deref().map(installation::load_without_orientation);
    let installation = installation.transpose()?;
    let setup = installation.as_ref().map(|i| &i.setup);
    let choice = ResultChoice { flight: args.flight.as_deref(), inputs: args.inputs.as_deref() };
    let busy = image_batch::show_busy("reading the store");
    let data = source::read_flight_with_pictures(&args.store, choice, setup, args.pictures)?;
    drop(busy);
    for note in data.warnings.iter().chain(&data.notes) {
        eprintln!("wingd: {note}");
    }
    write_page(args, &html::report_page(&data))?;
    print_line(table::series_text(&summary::summarise_series(&data.series), args.wide).trim_end())?;
    print_line(&format!("\nReport: {}", args.output.display()))?;
    Ok(Completion::from_success(data.notes.is_empty()))
}

fn report_all_flights(args: &ReportArgs) -> Result<Completion, Failure> {
    let flights = source::selected_flights(&args.store, None)?;
    let read = flights.iter().map(|flight| overview::read_overview(&RealDisk, flight));
    let all = read.collect::<Result<Vec<_>, _>>()?;
    for note in all.iter().flat_map(|f| f.warning.iter().chain(&f.notes)) {
        eprintln!("wingd: {note}");
    }
    write_page(args, &html::flights_page(&all))?;
    print_line(&format!("Report of {}: {}", count_text(all.len(), "flight"), args.output.display()))?;
    Ok(Completion::from_success(all.iter().all(|f| f.notes.is_empty())))
}

fn write_page(args: &ReportArgs, page: &str) -> Result<(), Failure> {
    std::fs::write(&args.output, page).map_err(|e| {
        let file = args.output.display();
        Failure::Failed(format!("{file}: could not write: {e}; choose another file with --output"))
    })
}
