//! `wingd copy` copies a store's flights to another directory, disk or USB stick.

use std::path::{Path, PathBuf};

use super::verify::content_text;
use super::{
    Completion, TaskResult, byte_progress, print_json, print_line, print_notes, show_busy,
};
use crate::desk::stored_flights::select_flights;
use crate::report::number::count_text;
use crate::store::bundle::{self, BundleContent};
use crate::store::receive::{Listing, Receiver};
use crate::store::verify::VerifyReport;
use crate::store::{Disk, FlightRef, RealDisk, StoreError, StoreResult};

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

pub(super) fn run(args: &CopyArgs) -> TaskResult<Completion> {
    let flights = select_flights(&args.store, args.flight.as_deref())?;
    let report = copy_flights(args, &flights, false)?;
    // Damaged files are copied again, once.
    let report = if report.is_sound() {
        report
    } else {
        copy_flights(args, &flights, true)?
    };
    report_copy(&report, &args.directory, args.json)
}

/// Copies the missing files of the flights, or, if `thorough`, also the damaged ones, and reads the copy back.
fn copy_flights(
    args: &CopyArgs,
    flights: &[FlightRef],
    thorough: bool,
) -> StoreResult<VerifyReport> {
    let receiver = Receiver::open(&RealDisk, &args.directory)?;
    for flight in flights {
        copy_flight(&RealDisk, &args.store, flight, &receiver, thorough)?;
    }
    read_back(receiver)
}

/// Reads the complete copy back from its disk and verifies it.
pub(super) fn read_back(receiver: Receiver) -> StoreResult<VerifyReport> {
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
pub(super) fn report_copy(
    report: &VerifyReport,
    directory: &Path,
    json: bool,
) -> TaskResult<Completion> {
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
