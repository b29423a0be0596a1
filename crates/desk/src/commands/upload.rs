//! `wingd upload` uploads flights to an object store.

use std::path::PathBuf;

use crate::upload::{Upload, UploadOutcome, UploadSettings, UploadTarget, WingLabels};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{byte_progress, print_line};
use wingd_evaluation::inputs::stored_flights::select_flights;

/// Upload flights to an object store: inventory first, then results, then frames. Never overwrites; an interrupted upload
/// is resumed.
///
/// Credentials, region and endpoint are read from the environment: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION,
/// AWS_ENDPOINT_URL, AWS_ALLOW_HTTP.
#[derive(clap::Args)]
pub struct UploadArgs {
    /// Store
    store: PathBuf,
    /// Destination: s3://BUCKET/PREFIX, or file:///DIRECTORY
    #[arg(long, value_name = "URL")]
    to: String,
    /// Flight, for example f0001 [default: all flights]
    #[arg(long)]
    flight: Option<String>,
    /// Registration of the aircraft: letters, digits, '.', '_', '-' [default: recorder-ID, one per recorder]
    #[arg(long, value_name = "NAME", value_parser = parse_name)]
    aircraft: Option<String>,
    /// Type of the aircraft, for tables and figures
    #[arg(long, value_name = "TYPE", value_parser = parse_name)]
    aircraft_type: Option<String>,
    /// Wing of the aircraft [default: the installation's side]
    #[arg(long, value_name = "NAME", value_parser = parse_name)]
    wing: Option<String>,
    /// Maximum number of parallel transfers; use 1 on a slow link
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=64))]
    jobs: u16,
    /// Retries of a failed request
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(0..=20))]
    retries: u32,
    /// Maximum mean rate in bytes per second, for example 250k or 2M
    #[arg(long, value_name = "RATE", value_parser = parse_rate)]
    limit_rate: Option<u64>,
    /// Replace objects that were changed or damaged at the destination, and restore missing ones
    #[arg(long)]
    repair: bool,
    /// Print one JSON object per flight
    #[arg(long)]
    json: bool,
}

fn parse_name(text: &str) -> Result<String, String> {
    match WingLabels::is_valid_name(text) {
        true => Ok(text.to_owned()),
        false => Err("give letters, digits, '.', '_', '-' (64 at most, not '.' first)".to_owned()),
    }
}

/// Parses bytes per second; k, M, G are powers of 1000.
fn parse_rate(text: &str) -> Result<u64, String> {
    let wrong = || "give bytes per second, for example 250k or 2M".to_owned();
    let unit = text.chars().last().map(|c| c.to_ascii_lowercase());
    let factor = match unit {
        Some('k') => 1_000,
        Some('m') => 1_000_000,
        Some('g') => 1_000_000_000,
        _ => 1,
    };
    let digits = if factor == 1 {
        text
    } else {
        text.get(..text.len() - 1).unwrap_or_default()
    };
    let number: u64 = digits.parse().map_err(|_| wrong())?;
    number
        .checked_mul(factor)
        .filter(|rate| *rate >= 1_000)
        .ok_or_else(wrong)
}

/// Uploads the flights of a store, or the requested one, to an object store or a directory.
pub(super) fn run(args: &UploadArgs) -> TaskResult<Completion> {
    let flights = select_flights(&args.store, args.flight.as_deref())?;
    let settings = UploadSettings {
        jobs: args.jobs.into(),
        retries: args.retries,
        limit: args.limit_rate,
    };
    let target = UploadTarget::open(&args.to, settings)?;
    let about = WingLabels {
        aircraft: args.aircraft.clone(),
        aircraft_type: args.aircraft_type.clone(),
        wing: args.wing.clone(),
    };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build();
    let runtime = runtime.map_err(|e| Failure::Failed(format!("could not start: {e}")))?;
    let bar = byte_progress(0, "upload");
    let progress = |length| bar.inc(length);
    let upload = Upload {
        target: &target,
        root: &args.store,
        labels: &about,
        repair: args.repair,
        progress: &progress,
    };
    let outcomes = runtime.block_on(upload.upload_flights(&flights));
    bar.finish_and_clear();
    for (flight, outcome) in flights.iter().zip(&outcomes) {
        print_outcome(args, &flight.id, &target, outcome)?;
    }
    Ok(Completion::from_success(outcomes.iter().all(Result::is_ok)))
}

fn print_outcome(
    args: &UploadArgs,
    id: &str,
    target: &UploadTarget,
    outcome: &UploadOutcome,
) -> TaskResult<()> {
    let line = match (outcome, args.json) {
        (Ok((sent, manifest)), true) => serde_json::json!({
            "flight": id, "status": "ok", "recorder": manifest.recorder, "aircraft": manifest.aircraft,
            "aircraft_type": manifest.aircraft_type, "wing": manifest.wing, "objects": sent.objects,
            "bytes": sent.bytes, "sent": sent.sent, "sent_bytes": sent.sent_bytes, "repaired": sent.repaired,
            "aged": sent.expired, "manifest": target.display_url(&manifest.key()),
        })
        .to_string(),
        (Ok((sent, manifest)), false) => {
            let more = |count: usize, what: &str| match count {
                0 => String::new(),
                n => format!(", {n} {what}"),
            };
            format!(
                "{id}  {}: {} objects ({:.1} MB) uploaded, {} of them now ({:.1} MB){}{}: {}",
                manifest.aircraft,
                sent.objects,
                sent.bytes as f64 / 1e6,
                sent.sent,
                sent.sent_bytes as f64 / 1e6,
                more(sent.repaired, "replacing damaged ones"),
                more(sent.expired, "frames expired at the destination"),
                target.display_url(&manifest.key())
            )
        }
        (Err(error), true) => {
            serde_json::json!({"flight": id, "status": "failed", "reason": error.to_string()}).to_string()
        }
        (Err(_), false) => format!("{id}  not completely uploaded"),
    };
    print_line(&line)?;
    if let Err(error) = outcome {
        eprintln!("wingd: {id}: {error}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_bytes_per_second() {
        assert_eq!(parse_rate("250k"), Ok(250_000));
        assert_eq!(parse_rate("2M"), Ok(2_000_000));
        assert_eq!(parse_rate("9600"), Ok(9600));
        for wrong in ["", "k", "fast", "-1k", "1", "99999999999999G"] {
            assert!(parse_rate(wrong).is_err(), "{wrong}");
        }
    }
}
