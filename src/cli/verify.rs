//! `wingd verify` checks every checksum and every invariant of a store or of a copy.

use std::path::PathBuf;
use std::sync::Arc;

use super::{Done, Failure, frames, print};
use crate::installation;
use crate::report::number::count;
use crate::store::signing::PublicKey;
use crate::store::verify::{Report, verify, verify_signed};
use crate::store::{self, RealDisk, catalogue};

/// Check every checksum and every invariant of a store, or of a copied flight or series.
#[derive(clap::Args)]
pub struct Args {
    /// The store, or a flight's or series' folder of it
    #[arg(value_name = "STORE")]
    store: PathBuf,
    /// Give a store of the old format (1) what notices changed results and missing series: an id, chains
    /// of digests, SHA256SUMS. Only a sound store is upgraded; no file but store.toml is changed
    #[arg(long)]
    upgrade: bool,
    /// With --upgrade: the installation that the results came from, to be kept in the store
    #[arg(long, value_name = "DIR", requires = "upgrade")]
    installation: Option<PathBuf>,
    /// Whether all of it was signed, too: with the key whose public half is in FILE (`[store] signing_key`)
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// The report as one JSON object
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    if !args.store.is_dir() {
        let what = format!("{}: is not a directory; name a store", args.store.display());
        return Err(Failure::Failed(what));
    }
    if args.upgrade {
        upgrade(args)?;
    }
    let key = args.key.as_deref().map(PublicKey::read).transpose();
    let busy = frames::busy("verifying");
    let report = match key.map_err(|error| Failure::Failed(error.to_string()))? {
        Some(key) => verify_signed(&RealDisk, &args.store, &key),
        None => verify(&RealDisk, &args.store),
    };
    drop(busy);
    if args.json {
        print(&serde_json::to_string(&report).unwrap_or_default())?;
    } else {
        for note in &report.notes {
            eprintln!("note: {note}");
        }
        print(&text(&report))?;
    }
    Ok(Done::all(report.is_sound()))
}

fn upgrade(args: &Args) -> Result<(), Failure> {
    catalogue::check_format(&RealDisk, &args.store)?;
    let installation = args.installation.as_deref().map(installation::load).transpose()?;
    let files = installation.map(|i| i.files()).transpose()?;
    Ok(store::upgrade(Arc::new(RealDisk), &args.store, files.as_deref())?)
}

fn text(report: &Report) -> String {
    let fault = |fault: &crate::store::verify::Fault| {
        format!("invariant {}: {}: {}\n", fault.invariant, fault.path.display(), fault.what)
    };
    let faults: String = report.faults.iter().map(fault).collect();
    let verdict = match report.faults.len() {
        0 => "all invariants hold".to_owned(),
        n => {
            format!("{} (docs/store.md says what each invariant means and how to mend it)", count(n, "fault"))
        }
    };
    format!(
        "{faults}{}, {} series, {} ({:.1} MB) with their checksums, {}: {verdict}",
        count(report.flights, "flight"),
        report.series,
        count(report.frames, "frame"),
        report.bytes as f64 / 1e6,
        count(report.results, "result")
    )
}
