//! `wingd copy` copies a store's flights to another directory, disk or USB stick.

use std::path::{Path, PathBuf};

use super::store_access::select_flights;
use super::{Completion, Failure, image_batch, print_line};
use crate::report::number::count_text;
use crate::store::bundle::{self, BundleContent};
use crate::store::receive::{Listing, Receiver};
use crate::store::verify::VerifyReport;
use crate::store::{Disk, FlightRef, RealDisk, StoreError};

/// Copy a store's flights to another directory, disk or USB stick; an interrupted copy is resumed, and the result verified.
#[derive(clap::Args)]
pub struct CopyArgs {
    /// Store
    store: PathBuf,
    /// Directory of the copy: missing, empty, or with an older copy of this store
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// Flight, for example f0001 [default: all flights]
    #[arg(long)]
    flight: Option<String>,
    /// Print the contents of the copy as one JSON object
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &CopyArgs) -> Result<Completion, Failure> {
    let disk = RealDisk;
    let flights = select_flights(&args.store, args.flight.as_deref())?;
    let receiver = Receiver::open(&disk, &args.directory)?;
    for flight in &flights {
        copy_flight(&disk, &args.store, flight, &receiver, false)?;
    }
    let report = read_back(receiver)?;
    let report = if report.is_sound() { report } else { recopy_damaged(args, &disk, &flights)? };
    report_copy(&report, &args.directory, args.json)
}

/// Reads the complete copy back from its disk and verifies it.
pub(super) fn read_back(receiver: Receiver) -> Result<VerifyReport, StoreError> {
    let _busy = image_batch::show_busy("verifying the copy");
    receiver.finish()
}

/// Copies damaged files again, once.
fn recopy_damaged(args: &CopyArgs, disk: &dyn Disk, flights: &[FlightRef]) -> Result<VerifyReport, Failure> {
    let receiver = Receiver::open(disk, &args.directory)?;
    for flight in flights {
        copy_flight(disk, &args.store, flight, &receiver, true)?;
    }
    Ok(read_back(receiver)?)
}

fn copy_flight(
    disk: &dyn Disk,
    store: &Path,
    flight: &FlightRef,
    receiver: &Receiver,
    thorough: bool,
) -> Result<(), StoreError> {
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

/// Creates a progress bar in bytes on standard error; invisible unless that is a terminal.
pub(super) fn byte_progress(bytes: u64, what: &str) -> indicatif::ProgressBar {
    let style = indicatif::ProgressStyle::with_template("{msg} [{bar:30}] {bytes}/{total_bytes} {eta}");
    let bar = indicatif::ProgressBar::new(bytes).with_message(what.to_owned());
    bar.set_style(style.unwrap_or_else(|_| indicatif::ProgressStyle::default_bar()));
    bar
}

/// Prints the verdict on a copy that was read back.
pub(super) fn report_copy(report: &VerifyReport, directory: &Path, json: bool) -> Result<Completion, Failure> {
    if json {
        print_line(&serde_json::to_string(report).unwrap_or_default())?;
        return Ok(Completion::from_success(report.is_sound()));
    }
    for fault in &report.faults {
        eprintln!("wingd: {fault}");
    }
    let verdict = if report.is_sound() { "complete and sound" } else { "NOT SOUND" };
    print_line(&format!(
        "{}: {verdict}, verified: {}, {} series, {} ({:.1} MB), {}",
        directory.display(),
        count_text(report.flights, "flight"),
        report.series,
        count_text(report.frames, "frame"),
        report.bytes as f64 / 1e6,
        count_text(report.results, "result")
    ))?;
    Ok(Completion::from_success(report.is_sound()))
}
