//! `wingd fetch` brings flights from a recorder's page into a directory.

use std::path::PathBuf;

use super::copy::{bar, ended, read_back};
use super::{Done, Failure};
use crate::http::access;
use crate::http::client::Client;
use crate::http::fetch;
use crate::installation::Fault;
use crate::store::RealDisk;
use crate::store::receive::Receiver;

/// Flights from the page that a recorder or `wingd serve` shows: goes on where it ended, checked at the end.
#[derive(clap::Args)]
pub struct Args {
    /// The page, for example http://192.168.4.1:8080
    url: String,
    /// Where the copy goes: missing, empty, or an older copy of that store
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// One flight, for example f0001 [default: all of them]
    #[arg(long)]
    flight: Option<String>,
    /// A file with the page's token
    #[arg(long, alias = "token", value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// The certificate that the page must show (PEM), for https://
    #[arg(long, value_name = "FILE")]
    certificate: Option<PathBuf>,
    /// What the copy holds, as one JSON object
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let token = args.token_file.as_deref().map(|file| {
        access::read_token(file).map_err(|(problem, mend)| Fault::new(file, "token", problem, mend))
    });
    let client = Client::new(&args.url, token.transpose()?, args.certificate.as_deref());
    let mut client = client.map_err(|e| Failure::Failed(e.to_string()))?;
    let flights = match &args.flight {
        Some(flight) => vec![flight.clone()],
        None => fetch::flights(&mut client).map_err(|e| undone(args, e))?,
    };
    let report = fetch_all(args, &mut client, &flights, false)?;
    let report = if report.is_sound() { report } else { fetch_all(args, &mut client, &flights, true)? };
    ended(&report, &args.directory, args.json)
}

fn fetch_all(
    args: &Args,
    client: &mut Client,
    flights: &[String],
    thorough: bool,
) -> Result<crate::store::verify::Report, Failure> {
    let receiver = Receiver::open(&RealDisk, &args.directory)?;
    for flight in flights {
        let bar = bar(0, flight);
        let mut progress = |done, whole| {
            bar.set_length(whole);
            bar.set_position(done);
        };
        fetch::flight(client, &receiver, flight, thorough, &mut progress).map_err(|e| undone(args, e))?;
        bar.finish_and_clear();
    }
    Ok(read_back(receiver)?)
}

fn undone(args: &Args, error: fetch::FetchError) -> Failure {
    Failure::Failed(format!("{}: {error}", args.url))
}
