//! `wingd fetch` downloads flights from a recorder's page into a directory.

use std::path::PathBuf;

use super::copy::{read_back, report_copy};
use super::{Completion, Failure, TaskResult, byte_progress};
use crate::http::access;
use crate::http::client::Client;
use crate::http::fetch;
use crate::installation::Fault;
use crate::store::RealDisk;
use crate::store::receive::Receiver;

/// Download flights from the page of a recorder or of `wingd serve`; an interrupted download is resumed, and the result
/// verified.
#[derive(clap::Args)]
pub struct FetchArgs {
    /// Page, for example http://192.168.4.1:8080
    url: String,
    /// Directory of the copy: missing, empty, or with an older copy of that store
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// Flight, for example f0001 [default: all flights]
    #[arg(long)]
    flight: Option<String>,
    /// File with the page's access token
    #[arg(long, alias = "token", value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Certificate that the page must present (PEM), for https://
    #[arg(long, value_name = "FILE")]
    certificate: Option<PathBuf>,
    /// Print the contents of the copy as one JSON object
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &FetchArgs) -> TaskResult<Completion> {
    let token = args.token_file.as_deref().map(|file| {
        access::read_token(file)
            .map_err(|(problem, remedy)| Fault::new(file, "token", problem, remedy))
    });
    let client = Client::new(&args.url, token.transpose()?, args.certificate.as_deref());
    let mut client = client.map_err(|e| Failure::Failed(e.to_string()))?;
    let flights = match &args.flight {
        Some(flight) => vec![flight.clone()],
        None => fetch::fetch_flight_names(&mut client).map_err(|e| fetch_failure(args, e))?,
    };
    let report = fetch_all(args, &mut client, &flights, false)?;
    let report = if report.is_sound() {
        report
    } else {
        fetch_all(args, &mut client, &flights, true)?
    };
    report_copy(&report, &args.directory, args.json)
}

fn fetch_all(
    args: &FetchArgs,
    client: &mut Client,
    flights: &[String],
    thorough: bool,
) -> TaskResult<crate::store::verify::VerifyReport> {
    let receiver = Receiver::open(&RealDisk, &args.directory)?;
    for flight in flights {
        let bar = byte_progress(0, flight);
        let mut progress = |done, total| {
            bar.set_length(total);
            bar.set_position(done);
        };
        fetch::fetch_flight(client, &receiver, flight, thorough, &mut progress)
            .map_err(|e| fetch_failure(args, e))?;
        bar.finish_and_clear();
    }
    Ok(read_back(receiver)?)
}

fn fetch_failure(args: &FetchArgs, error: fetch::FetchError) -> Failure {
    Failure::Failed(format!("{}: {error}", args.url))
}
