//! `wingd upload` brings flights into an object store.

use std::path::PathBuf;

use super::{Done, Failure};
use crate::store::{FlightRef, RealDisk, StoreError};
use crate::upload::{self, Aircraft, Manifest, Sent, Settings, Target, UploadError};

/// Flights into an object store: create-only, the flight's manifest last, goes on where it ended.
///
/// Credentials, region and endpoint are taken from the environment: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY,
/// AWS_REGION, AWS_ENDPOINT_URL, AWS_ALLOW_HTTP.
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// s3://BUCKET/PREFIX, or file:///DIRECTORY
    #[arg(long, value_name = "URL")]
    to: String,
    /// One flight, for example f0001 [default: all of them]
    #[arg(long)]
    flight: Option<String>,
    /// The aircraft's registration: letters, digits, '.', '_', '-' [default: the installation's name]
    #[arg(long, value_name = "NAME")]
    aircraft: Option<String>,
    /// The kind of aircraft, for tables and figures
    #[arg(long, value_name = "TYPE")]
    aircraft_type: Option<String>,
    /// Objects at a time
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=64))]
    jobs: u16,
    /// How often a request that failed is repeated
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(0..=20))]
    retries: u32,
    /// One JSON object per flight
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    if args.aircraft.as_deref().is_some_and(|name| !Aircraft::is_name(name)) {
        let what = "--aircraft holds more than letters, digits, '.', '_', '-' (64 at most, not '.' first)";
        return Err(Failure::Usage(format!("{what}; give its registration")));
    }
    let flights = super::stores::flights(&args.store, args.flight.as_deref())?;
    let target = Target::open(&args.to, Settings { jobs: args.jobs.into(), retries: args.retries })?;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(|e| Failure::Undone(format!("could not start: {e}")))?;
    let mut all = true;
    for flight in &flights {
        let bar = super::copy::bar(0, &flight.id);
        let progress = |length, whole| {
            bar.set_length(whole);
            bar.inc(length);
        };
        let outcome = aircraft(args, flight).map_err(UploadError::from).and_then(|aircraft| {
            let work = upload::flight(&target, &args.store, flight, &aircraft, &progress);
            runtime.block_on(work)
        });
        bar.finish_and_clear();
        all &= outcome.is_ok();
        say(args, flight, &target, &outcome)?;
        if outcome.is_err_and(|error| error.concerns_all()) {
            break;
        }
    }
    Ok(Done::all(all))
}

fn aircraft(args: &Args, flight: &FlightRef) -> Result<Aircraft, StoreError> {
    let name = match &args.aircraft {
        Some(name) => name.clone(),
        None => Aircraft::of_installation(&args.store, flight)?,
    };
    Ok(Aircraft { name, kind: args.aircraft_type.clone() })
}

fn say(
    args: &Args,
    flight: &FlightRef,
    target: &Target,
    outcome: &Result<(Sent, Manifest), UploadError>,
) -> Result<(), Failure> {
    let id = &flight.id;
    let line = match (outcome, args.json) {
        (Ok((sent, manifest)), true) => serde_json::json!({
            "flight": id, "status": "ok", "aircraft": manifest.aircraft, "aircraft_type": manifest.aircraft_type,
            "recorder": manifest.recorder, "objects": sent.objects, "bytes": sent.bytes, "sent": sent.sent,
            "sent_bytes": sent.sent_bytes, "manifest": target.shown(&manifest.key()),
        })
        .to_string(),
        (Ok((sent, manifest)), false) => format!(
            "{id}  published, {} objects ({:.1} MB), {} of them sent now ({:.1} MB): {}",
            sent.objects,
            sent.bytes as f64 / 1e6,
            sent.sent,
            sent.sent_bytes as f64 / 1e6,
            target.shown(&manifest.key())
        ),
        (Err(error), true) => {
            serde_json::json!({"flight": id, "status": "failed", "reason": error.to_string()}).to_string()
        }
        (Err(_), false) => format!("{id}  not published"),
    };
    super::print(&line)?;
    if let Err(error) = outcome {
        eprintln!("wingd: {id}: {error}");
    }
    Ok(())
}
