//! `wingd prune` is the only command that deletes recorded data.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::stores::{self, flights};
use super::{Done, Failure, frames, print};
use crate::report::number::count;
use crate::store::prune::{Proof, prove};
use crate::store::{RealDisk, Store};

/// Delete flights of which a verified copy holds every byte.
#[derive(clap::Args)]
pub struct Args {
    /// The store; its recorder must be stopped
    store: PathBuf,
    /// The copy, as `wingd copy` or `wingd fetch` made it; every file of it is read and checked first
    #[arg(long, value_name = "DIR")]
    verified_copy: PathBuf,
    /// One flight, for example f0001 [default: all but the newest]
    #[arg(long)]
    flight: Option<String>,
    /// So many of the newest flights stay
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "flight")]
    keep: usize,
    /// Say what would be deleted, and delete nothing
    #[arg(long)]
    dry_run: bool,
    /// One JSON object per flight: flight, deleted, bytes, reason
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let mut flights = flights(&args.store, args.flight.as_deref())?;
    if args.flight.is_none() {
        flights.truncate(flights.len().saturating_sub(args.keep));
    }
    let store = if args.dry_run { None } else { Some(open(&args.store)?) };
    let (mut freed, mut stay) = (0, 0);
    for flight in &flights {
        let busy = frames::busy("reading the copy");
        let proof = match &store {
            Some(store) => store.prune(flight, &args.verified_copy),
            None => prove(&RealDisk, &args.store, flight, &args.verified_copy),
        };
        drop(busy);
        let (bytes, why) = match proof? {
            Proof::Copied { bytes, .. } => (bytes, None),
            Proof::Stays(why) => (0, Some(why)),
        };
        freed += bytes;
        stay += usize::from(why.is_some());
        print(&line(args, &flight.id, bytes, why))?;
    }
    if args.json {
        return Ok(Done::all(stay == 0));
    }
    let free = if args.dry_run { "would be free" } else { "freed" };
    let stays = if stay == 1 { "stays" } else { "stay" };
    let kept = count(stay, "flight");
    print(&format!("{:.1} MB {free}; {kept} {stays} for want of proof", freed as f64 / 1e6))?;
    Ok(Done::all(stay == 0))
}

/// What became of a flight; `why` it stays.
fn line(args: &Args, flight: &str, bytes: u64, why: Option<String>) -> String {
    if args.json {
        let deleted = why.is_none() && !args.dry_run;
        return json!({"flight": flight, "deleted": deleted, "bytes": bytes, "reason": why}).to_string();
    }
    match why {
        Some(why) => format!("{flight}  stays: {why}"),
        None if args.dry_run => format!("{flight}  would be deleted, {:.1} MB", bytes as f64 / 1e6),
        None => format!("{flight}  deleted, {:.1} MB", bytes as f64 / 1e6),
    }
}

fn open(root: &Path) -> Result<Store, Failure> {
    let (store, _) = stores::open(root)?;
    store.sweep()?;
    Ok(store)
}
