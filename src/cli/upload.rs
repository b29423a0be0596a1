//! `wingd upload` brings flights into an object store.

use std::path::PathBuf;

use super::{Done, Failure};
use crate::upload::{About, Outcome, Settings, Target, Upload};

/// Flights into an object store: what exists first, then results, then frames; create-only, goes on where it ended.
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
    /// The aircraft's registration: letters, digits, '.', '_', '-' [default: recorder-ID, one for each recorder]
    #[arg(long, value_name = "NAME", value_parser = name)]
    aircraft: Option<String>,
    /// The kind of aircraft, for tables and figures
    #[arg(long, value_name = "TYPE", value_parser = name)]
    aircraft_type: Option<String>,
    /// Which wing of it [default: the installation's side]
    #[arg(long, value_name = "NAME", value_parser = name)]
    wing: Option<String>,
    /// Objects at a time, at most; on a slow link one
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=64))]
    jobs: u16,
    /// How often a request that failed is repeated
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(0..=20))]
    retries: u32,
    /// Bytes a second at most, as 250k or 2M
    #[arg(long, value_name = "RATE", value_parser = rate)]
    limit_rate: Option<u64>,
    /// Put the right bytes in place of objects that were changed or damaged there, and those that are gone
    #[arg(long)]
    repair: bool,
    /// One JSON object per flight
    #[arg(long)]
    json: bool,
}

fn name(text: &str) -> Result<String, String> {
    match About::is_name(text) {
        true => Ok(text.to_owned()),
        false => Err("give letters, digits, '.', '_', '-' (64 at most, not '.' first)".to_owned()),
    }
}

/// Bytes a second; k, M, G count in thousands.
fn rate(text: &str) -> Result<u64, String> {
    let wrong = || "give bytes a second, as 250k or 2M".to_owned();
    let unit = text.chars().last().map(|c| c.to_ascii_lowercase());
    let factor = match unit {
        Some('k') => 1_000,
        Some('m') => 1_000_000,
        Some('g') => 1_000_000_000,
        _ => 1,
    };
    let digits = if factor == 1 { text } else { text.get(..text.len() - 1).unwrap_or_default() };
    let number: u64 = digits.parse().map_err(|_| wrong())?;
    number.checked_mul(factor).filter(|rate| *rate >= 1_000).ok_or_else(wrong)
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let flights = super::stores::flights(&args.store, args.flight.as_deref())?;
    let settings = Settings { jobs: args.jobs.into(), retries: args.retries, limit: args.limit_rate };
    let target = Target::open(&args.to, settings)?;
    let about = About {
        aircraft: args.aircraft.clone(),
        aircraft_type: args.aircraft_type.clone(),
        wing: args.wing.clone(),
    };
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(|e| Failure::Failed(format!("could not start: {e}")))?;
    let bar = super::copy::bar(0, "upload");
    let progress = |length| bar.inc(length);
    let upload = Upload {
        target: &target,
        root: &args.store,
        about: &about,
        repair: args.repair,
        progress: &progress,
    };
    let outcomes = runtime.block_on(upload.flights(&flights));
    bar.finish_and_clear();
    for (flight, outcome) in flights.iter().zip(&outcomes) {
        say(args, &flight.id, &target, outcome)?;
    }
    Ok(Done::all(outcomes.iter().all(Result::is_ok)))
}

fn say(args: &Args, id: &str, target: &Target, outcome: &Outcome) -> Result<(), Failure> {
    let line = match (outcome, args.json) {
        (Ok((sent, manifest)), true) => serde_json::json!({
            "flight": id, "status": "ok", "recorder": manifest.recorder, "aircraft": manifest.aircraft,
            "aircraft_type": manifest.aircraft_type, "wing": manifest.wing, "objects": sent.objects,
            "bytes": sent.bytes, "sent": sent.sent, "sent_bytes": sent.sent_bytes, "repaired": sent.repaired,
            "aged": sent.aged, "manifest": target.shown(&manifest.key()),
        })
        .to_string(),
        (Ok((sent, manifest)), false) => {
            let more = |count: usize, what: &str| match count {
                0 => String::new(),
                n => format!(", {n} {what}"),
            };
            format!(
                "{id}  {}: {} objects ({:.1} MB) there, {} of them sent now ({:.1} MB){}{}: {}",
                manifest.aircraft,
                sent.objects,
                sent.bytes as f64 / 1e6,
                sent.sent,
                sent.sent_bytes as f64 / 1e6,
                more(sent.repaired, "in place of damaged ones"),
                more(sent.aged, "frames aged there"),
                target.shown(&manifest.key())
            )
        }
        (Err(error), true) => {
            serde_json::json!({"flight": id, "status": "failed", "reason": error.to_string()}).to_string()
        }
        (Err(_), false) => format!("{id}  not whole there"),
    };
    super::print(&line)?;
    if let Err(error) = outcome {
        eprintln!("wingd: {id}: {error}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_bytes_a_second() {
        assert_eq!(rate("250k"), Ok(250_000));
        assert_eq!(rate("2M"), Ok(2_000_000));
        assert_eq!(rate("9600"), Ok(9600));
        for wrong in ["", "k", "fast", "-1k", "1", "99999999999999G"] {
            assert!(rate(wrong).is_err(), "{wrong}");
        }
    }
}
