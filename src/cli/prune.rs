//! `wingd prune` is the only command that deletes recorded data.

use std::path::PathBuf;

use serde_json::json;

use wingd_base::failure::{Completion, TaskResult};
use wingd_base::output::{print_line, show_busy};
use wingd_evaluation::inputs::stored_flights;
use wingd_evaluation::inputs::stored_flights::select_flights;
use wingd_evaluation::number::count_text;
use wingd_store::prune::{CopyProof, verify_copy};
use wingd_store::{RealDisk, Store};

/// Delete flights of which a verified copy holds every byte.
#[derive(clap::Args)]
pub struct PruneArgs {
    /// Store; its recorder must be stopped
    store: PathBuf,
    /// Copy made by `wingd copy`; all its files are read and verified first
    #[arg(long, value_name = "DIR")]
    verified_copy: PathBuf,
    /// Flight, for example f0001 [default: all but the newest]
    #[arg(long)]
    flight: Option<String>,
    /// Number of the newest flights to keep
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "flight")]
    keep: usize,
    /// Show the flights that would be deleted, without deleting them
    #[arg(long)]
    dry_run: bool,
    /// Print one JSON object per flight: flight, deleted, bytes, reason
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &PruneArgs) -> TaskResult<Completion> {
    let mut flights = select_flights(&args.store, args.flight.as_deref())?;
    let newest = if args.flight.is_none() {
        args.keep.min(flights.len())
    } else {
        0
    };
    flights.truncate(flights.len() - newest);
    let store = match args.dry_run {
        true => None,
        false => Some(stored_flights::open_store(&args.store)?.0),
    };
    store.as_ref().map_or(Ok(()), Store::remove_pruned)?;
    let (mut freed, mut stay) = (0, 0);
    for flight in &flights {
        let proof = show_busy("verifying the copy", || match &store {
            Some(store) => store.prune_flight(flight, &args.verified_copy),
            None => verify_copy(&RealDisk, &args.store, flight, &args.verified_copy),
        });
        let (bytes, why) = match proof? {
            CopyProof::Verified { bytes, .. } => (bytes, None),
            CopyProof::Unverified(why) => (0, Some(why)),
        };
        freed += bytes;
        stay += usize::from(why.is_some());
        print_line(&outcome_line(args, &flight.id, bytes, why))?;
    }
    if args.json {
        return Ok(Completion::from_success(stay == 0));
    }
    let free = if args.dry_run {
        "would be freed"
    } else {
        "freed"
    };
    let mut line = format!("{:.1} MB {free}", freed as f64 / 1e6);
    if stay > 0 {
        line.push_str(&format!(
            "; {} kept: the copy could not be verified",
            count_text(stay, "flight")
        ));
    }
    if newest > 0 {
        line.push_str(&format!(
            "; {} kept as the newest (--keep {})",
            count_text(newest, "flight"),
            args.keep
        ));
    }
    print_line(&line)?;
    Ok(Completion::from_success(stay == 0))
}

/// Describes the outcome for a flight; `why` is the reason for keeping it.
fn outcome_line(args: &PruneArgs, flight: &str, bytes: u64, why: Option<String>) -> String {
    if args.json {
        let deleted = why.is_none() && !args.dry_run;
        return json!({"flight": flight, "deleted": deleted, "bytes": bytes, "reason": why})
            .to_string();
    }
    match why {
        Some(why) => format!("{flight}  kept: {why}"),
        None if args.dry_run => format!("{flight}  would be deleted, {:.1} MB", bytes as f64 / 1e6),
        None => format!("{flight}  deleted, {:.1} MB", bytes as f64 / 1e6),
    }
}
