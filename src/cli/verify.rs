//! `wingd verify` checks every checksum and every invariant of a store or of a copy.

use std::path::PathBuf;

use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line, show_busy};
use wingd_base::text::printable_path;
use wingd_evaluation::number::count_text;
use wingd_store::RealDisk;
use wingd_store::signing::PublicKey;
use wingd_store::verify::{VerifyReport, verify_path, verify_with_key};

/// Check every checksum and every invariant of a store, or of a copied flight or series.
#[derive(clap::Args)]
pub struct VerifyArgs {
    /// Store, or the folder of a flight or series in it
    #[arg(value_name = "STORE")]
    store: PathBuf,
    /// Check all signatures with the public key in FILE (`[store] signing_key`)
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Print the report as one JSON object
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &VerifyArgs) -> TaskResult<Completion> {
    if !args.store.is_dir() {
        return Err(Failure::from_path_error(
            &args.store,
            "is not a directory; name a store",
        ));
    }
    let key = args
        .key
        .as_deref()
        .map(PublicKey::read)
        .transpose()
        .map_err(Failure::from_error)?;
    let report = show_busy("verifying", || match &key {
        Some(key) => verify_with_key(&RealDisk, &args.store, key),
        None => verify_path(&RealDisk, &args.store),
    });
    if args.json {
        print_json(&report)?;
    } else {
        for note in &report.notes {
            eprintln!("note: {}", printable_path(note));
        }
        print_line(&report_text(&report))?;
    }
    Ok(Completion::from_success(report.is_sound()))
}

fn report_text(report: &VerifyReport) -> String {
    let faults: String = report
        .faults
        .iter()
        .map(|fault| format!("{fault}\n"))
        .collect();
    let verdict = match report.faults.len() {
        0 => "all invariants hold".to_owned(),
        n => format!(
            "{} (docs/store.md explains each invariant and its remedy)",
            count_text(n, "error")
        ),
    };
    let results = count_text(report.results, "result");
    format!(
        "{faults}{} with their checksums, {results}: {verdict}",
        content_text(report)
    )
}

/// Counts flights, series and frames.
pub(super) fn content_text(report: &VerifyReport) -> String {
    let (flights, frames) = (
        count_text(report.flights, "flight"),
        count_text(report.frames, "frame"),
    );
    format!(
        "{flights}, {} series, {frames} ({:.1} MB)",
        report.series,
        report.bytes as f64 / 1e6
    )
}
