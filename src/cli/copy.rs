//! `wingd copy` copies a store's flights to another directory, disk or USB stick.

use std::path::{Path, PathBuf};

use super::verify::content_text;
use super::workstation::Download;
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{byte_progress, print_json, print_line, print_notes, show_busy};
use wingd_evaluation::inputs::stored_flights::select_flights;
use wingd_evaluation::number::count_text;
use wingd_store::bundle;
use wingd_store::bundle::BundleContent;
use wingd_store::receive::{Listing, Receiver};
use wingd_store::verify::VerifyReport;
use wingd_store::{Disk, FlightRef, RealDisk, StoreError, StoreResult};

/// Copy flights from a store, or from the page of a recorder or of `wingd serve`, to another directory, disk or USB stick;
/// an interrupted copy is resumed, and the result verified.
#[derive(clap::Args)]
pub struct CopyArgs {
    /// Store, or page, for example http://192.168.4.1:8080
    #[arg(value_name = "STORE|URL")]
    source: PathBuf,
    /// Directory of the copy: missing, empty, or with an older copy of this store
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

pub(super) fn run(args: &CopyArgs) -> TaskResult<Completion> {
    let report = match args.source.to_str() {
        Some(url) if url.contains("://") => download(args, url)?,
        _ => copy_store(args)?,
    };
    report_copy(&report, &args.directory, args.json)
}

/// Downloads flights from a page.
fn download(args: &CopyArgs, url: &str) -> TaskResult<VerifyReport> {
    let (token, certificate) = (args.token_file.as_deref(), args.certificate.as_deref());
    let mut source = Download::open(url, token, certificate)?;
    let flights = match &args.flight {
        Some(flight) => vec![flight.clone()],
        None => source.flight_names()?,
    };
    let mut receive = |thorough: bool| -> TaskResult<VerifyReport> {
        let receiver = Receiver::open(&RealDisk, &args.directory)?;
        source.receive(&receiver, &flights, thorough)?;
        Ok(read_back(receiver)?)
    };
    let report = receive(false)?;
    // Damaged files are downloaded again, once.
    if report.is_sound() {
        Ok(report)
    } else {
        receive(true)
    }
}

fn copy_store(args: &CopyArgs) -> TaskResult<VerifyReport> {
    for (option, file) in [
        ("--token-file", &args.token_file),
        ("--certificate", &args.certificate),
    ] {
        if file.is_some() {
            return Err(Failure::Usage(format!(
                "{option} is for a URL; {} is a directory",
                args.source.display()
            )));
        }
    }
    let flights = select_flights(&args.source, args.flight.as_deref())?;
    let report = copy_flights(args, &flights, false)?;
    // Damaged files are copied again, once.
    if report.is_sound() {
        Ok(report)
    } else {
        Ok(copy_flights(args, &flights, true)?)
    }
}

/// Copies the missing files of the flights, or, if `thorough`, also the damaged ones, and reads the copy back.
fn copy_flights(
    args: &CopyArgs,
    flights: &[FlightRef],
    thorough: bool,
) -> StoreResult<VerifyReport> {
    let receiver = Receiver::open(&RealDisk, &args.directory)?;
    for flight in flights {
        copy_flight(&RealDisk, &args.source, flight, &receiver, thorough)?;
    }
    read_back(receiver)
}

/// Reads the complete copy back from its disk and verifies it.
fn read_back(receiver: Receiver) -> StoreResult<VerifyReport> {
    show_busy("verifying the copy", || receiver.finish())
}

fn copy_flight(
    disk: &dyn Disk,
    store: &Path,
    flight: &FlightRef,
    receiver: &Receiver,
    thorough: bool,
) -> StoreResult<()> {
    let bundle = bundle::bundle_flight(disk, store, flight)?;
    let listing = Listing::from_bundle(&flight.id, &bundle);
    receiver.prepare_flight(&listing)?;
    let missing = receiver.missing_files(&listing, thorough);
    let bar = byte_progress(missing.iter().map(|item| item.length).sum(), &flight.id);
    for (item, listed) in bundle.items.iter().zip(&listing.items) {
        if !missing.contains(&listed) {
            continue;
        }
        let bytes = match &item.content {
            BundleContent::Bytes(bytes) => bytes.clone(),
            BundleContent::File(path) => {
                let mut bytes = disk.read(path).map_err(StoreError::io(path, "read"))?;
                // Results added meanwhile are not part of this listing.
                bytes.truncate(usize::try_from(item.length).unwrap_or(usize::MAX));
                bytes
            }
        };
        receiver.accept_file(listed, &bytes)?;
        bar.inc(item.length);
    }
    bar.finish_and_clear();
    receiver.commit_flight(&listing)
}

/// Prints the verdict on a copy that was read back.
fn report_copy(report: &VerifyReport, directory: &Path, json: bool) -> TaskResult<Completion> {
    if json {
        print_json(report)?;
        return Ok(Completion::from_success(report.is_sound()));
    }
    print_notes(&report.faults);
    let verdict = if report.is_sound() {
        "complete and sound"
    } else {
        "NOT SOUND"
    };
    let (content, results) = (content_text(report), count_text(report.results, "result"));
    print_line(&format!(
        "{}: {verdict}, verified: {content}, {results}",
        directory.display()
    ))?;
    Ok(Completion::from_success(report.is_sound()))
}
