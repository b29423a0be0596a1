//! `wingd copy` brings a store's flights to another directory, disk or stick.

use std::path::{Path, PathBuf};

use super::stores::flights;
use super::{Done, Failure, frames, print};
use crate::report::number::count;
use crate::store::bundle::{self, Content};
use crate::store::receive::{Listing, Receiver};
use crate::store::verify::Report;
use crate::store::{Disk, FlightRef, RealDisk, StoreError};

/// A store's flights to another directory, disk or stick: goes on where it ended, checked at the end.
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// Where the copy goes: missing, empty, or an older copy of this store
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// One flight, for example f0001 [default: all of them]
    #[arg(long)]
    flight: Option<String>,
    /// What the copy holds, as one JSON object
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let disk = RealDisk;
    let flights = flights(&args.store, args.flight.as_deref())?;
    let receiver = Receiver::open(&disk, &args.directory)?;
    for flight in &flights {
        copy(&disk, &args.store, flight, &receiver, false)?;
    }
    let report = read_back(receiver)?;
    let report = if report.is_sound() { report } else { again(args, &disk, &flights)? };
    ended(&report, &args.directory, args.json)
}

/// All of the copy, read from its disk.
pub(super) fn read_back(receiver: Receiver) -> Result<Report, StoreError> {
    let _busy = frames::busy("reading back");
    receiver.finish()
}

/// What lies there damaged is copied anew, once.
fn again(args: &Args, disk: &dyn Disk, flights: &[FlightRef]) -> Result<Report, Failure> {
    let receiver = Receiver::open(disk, &args.directory)?;
    for flight in flights {
        copy(disk, &args.store, flight, &receiver, true)?;
    }
    Ok(read_back(receiver)?)
}

fn copy(
    disk: &dyn Disk,
    store: &Path,
    flight: &FlightRef,
    receiver: &Receiver,
    thorough: bool,
) -> Result<(), StoreError> {
    let bundle = bundle::flight(disk, store, flight)?;
    let listing = Listing::of(&flight.id, &bundle);
    receiver.prepare(&listing)?;
    let missing = receiver.missing(&listing, thorough);
    let bar = bar(missing.iter().map(|item| item.length).sum(), &flight.id);
    for (item, listed) in bundle.items.iter().zip(&listing.items) {
        if !missing.contains(&listed) {
            continue;
        }
        let bytes = match &item.content {
            Content::Bytes(bytes) => bytes.clone(),
            Content::File(path) => {
                let mut bytes = disk.read(path).map_err(StoreError::io(path, "read"))?;
                // Results that were added meanwhile are not of this state.
                bytes.truncate(usize::try_from(item.length).unwrap_or(usize::MAX));
                bytes
            }
        };
        receiver.accept(listed, &bytes)?;
        bar.inc(item.length);
    }
    bar.finish_and_clear();
    receiver.commit(&listing)
}

/// Bytes on standard error; silent where that is no terminal.
pub(super) fn bar(bytes: u64, what: &str) -> indicatif::ProgressBar {
    let style = indicatif::ProgressStyle::with_template("{msg} [{bar:30}] {bytes}/{total_bytes} {eta}");
    let bar = indicatif::ProgressBar::new(bytes).with_message(what.to_owned());
    bar.set_style(style.unwrap_or_else(|_| indicatif::ProgressStyle::default_bar()));
    bar
}

/// What the copy is, after all of it was read back.
pub(super) fn ended(report: &Report, directory: &Path, json: bool) -> Result<Done, Failure> {
    if json {
        print(&serde_json::to_string(report).unwrap_or_default())?;
        return Ok(Done::all(report.is_sound()));
    }
    for fault in &report.faults {
        eprintln!("wingd: invariant {}: {}: {}", fault.invariant, fault.path.display(), fault.what);
    }
    let verdict = if report.is_sound() { "whole and sound" } else { "NOT SOUND" };
    print(&format!(
        "{}: {verdict}, read back: {}, {} series, {} ({:.1} MB), {}",
        directory.display(),
        count(report.flights, "flight"),
        report.series,
        count(report.frames, "frame"),
        report.bytes as f64 / 1e6,
        count(report.results, "result")
    ))?;
    Ok(Done::all(report.is_sound()))
}
