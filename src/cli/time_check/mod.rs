//! `wingd time-check` reads photographs of a screen that shows the clock: instants of exposure are checked, delays measured.

mod answer;
mod page;

use std::path::PathBuf;

use super::{Done, Failure, RIGHTS, frames, print, stores, unwritable};
use crate::camera::Format;
use crate::clock::exposure::Exposure;
use crate::measure::time_code::{self, Screen};
use crate::pipeline::guard::{BROKE_OFF, guarded};
use crate::pipeline::stages;
use crate::record::Reason;
use crate::store::{self, FrameRef, RealDisk};

/// Photographs of a screen that shows the clock -> instants of exposure checked, the delay for [camera].
#[derive(clap::Args)]
pub struct Args {
    /// The store that holds the photographs
    #[arg(required_unless_present = "page")]
    store: Option<PathBuf>,
    /// Write the page that shows the clock, and nothing else; open it in a browser on the recorder's computer
    #[arg(long, value_name = "FILE.html", conflicts_with_all = ["store", "flight", "series", "json"])]
    page: Option<PathBuf>,
    /// One flight, for example f0001 [default: all of them]
    #[arg(long)]
    flight: Option<String>,
    /// One series, for example s000003 [default: all of them]
    #[arg(long)]
    series: Option<String>,
    /// Frames a second of the screen; the page tells it
    #[arg(long, value_name = "HZ", default_value_t = 60.0)]
    refresh_hz: f64,
    /// From drawing to light just above the middle of the screen, ms
    #[arg(long, value_name = "MS", default_value_t = LATENCY_MS)]
    latency_ms: f64,
    /// Its standard deviation, ms [default: that of anywhere in 10 to 50 ms]
    #[arg(long, value_name = "MS", default_value_t = LATENCY_WIDTH_MS / 12f64.sqrt(), hide_default_value = true)]
    latency_sigma_ms: f64,
    /// One JSON object per picture, and one of them all
    #[arg(long)]
    json: bool,
    /// Images worked on at once [default: the cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
}

/// From drawing to light a browser, a compositor and a screen take one to three frames at 60 Hz: anywhere in 10 to 50 ms, an
/// assumption where nobody measured it.
const LATENCY_MS: f64 = 30.0;
const LATENCY_WIDTH_MS: f64 = 40.0;
/// A screen that is further off the recorder's clock does not show it, s; longer than a shot takes.
const MAX_OFFSET_S: f64 = 60.0;

/// What one photograph tells; times in s.
#[derive(Clone)]
pub(super) struct Reading {
    /// Series and file.
    image: String,
    /// Middle of the exposure by the screen, UTC.
    shown: jiff::Timestamp,
    /// Its standard deviation, the latency's left out.
    sigma_s: f64,
    /// Ticks that the exposure saw.
    ticks: u32,
    /// The camera was asked, less `shown`.
    command_s: f64,
    /// The exposure of the record less `shown`.
    exposure_s: Option<f64>,
    /// As it stands in the record.
    exposure: Option<Exposure>,
}

impl Reading {
    /// From the event that tells the exposure (stamp, edge, trigger) to the middle of the exposure by the screen.
    fn delay_s(&self) -> Option<f64> {
        Some(self.exposure.as_ref()?.exposure_delay_s? - self.exposure_s?)
    }
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    if let Some(file) = &args.page {
        std::fs::write(file, page::page()).map_err(unwritable(file, RIGHTS))?;
        print(&format!("{}: open it on the recorder's computer, full screen", file.display()))?;
        return Ok(Done::All);
    }
    let screen = screen(args)?;
    let chosen = chosen(args)?;
    let mut readings = Vec::new();
    let work = |frame: &FrameRef| {
        let name = format!("{}/{}", frame.series.id, frame.entry.file);
        let read = guarded(|| reading(frame, &name, &screen)).unwrap_or_else(|| Err(BROKE_OFF.into()));
        read.map_err(|reason| (name, reason))
    };
    frames::run(&chosen, args.jobs, "reading", work, |read| {
        if args.json {
            print(&answer::json_line(&read, &screen).to_string())?;
        } else if let Err((name, reason)) = &read {
            print(&format!("{name}: failed: {reason}"))?;
        }
        readings.extend(read.ok());
        Ok(())
    })?;
    if readings.is_empty() {
        return Err(Failure::Failed(format!(
            "none of {} pictures tells a time; `wingd time-check --page FILE.html` writes the page to photograph",
            chosen.len()
        )));
    }
    let summary = answer::Summary::of(&readings, chosen.len(), &screen);
    print(&if args.json { summary.json().to_string() } else { summary.text(&readings, &screen) })?;
    Ok(Done::all(readings.len() == chosen.len()))
}

fn screen(args: &Args) -> Result<Screen, Failure> {
    let sound = (1.0..=1000.0).contains(&args.refresh_hz)
        && (0.0..=1000.0).contains(&args.latency_ms)
        && (0.0..=1000.0).contains(&args.latency_sigma_ms);
    if !sound {
        let text = "--refresh-hz must be in 1 to 1000, --latency-ms and --latency-sigma-ms in 0 to 1000";
        return Err(Failure::Usage(text.into()));
    }
    Ok(Screen {
        refresh_s: args.refresh_hz.recip(),
        latency_s: 1e-3 * args.latency_ms,
        latency_sigma_s: 1e-3 * args.latency_sigma_ms,
    })
}

/// The frames that the command is about, in order.
fn chosen(args: &Args) -> Result<Vec<FrameRef>, Failure> {
    let Some(root) = &args.store else { return Ok(Vec::new()) };
    let mut all = Vec::new();
    for flight in stores::flights(root, args.flight.as_deref())? {
        all.extend(stores::frames(&RealDisk, &flight, args.series.as_deref())?);
    }
    if all.is_empty() {
        let what = "there is no frame of that flight and series";
        return Err(Failure::Failed(format!("{}: {what}; see `ls flights/*` in it", root.display())));
    }
    Ok(all)
}

fn reading(frame: &FrameRef, name: &str, screen: &Screen) -> Result<Reading, Reason> {
    let bytes = store::read_frame(&RealDisk, frame).map_err(Reason::of)?;
    let format = Format::of_manifest(&frame.entry.format).map_err(Reason::of)?;
    let (sighting, raster) = stages::detect_only(name, &bytes, Some(&format));
    if let Some(reason) = sighting.failure {
        return Err(reason);
    }
    let Some(raster) = raster else { return Err(BROKE_OFF.into()) };
    let shown = time_code::read(&raster, &sighting.detections).map_err(Reason::of)?;
    let recorded = frame.exposure.as_ref().map_or(frame.stamp.utc, |exposure| exposure.exposure_time);
    let about_ms = 1e-6 * recorded.as_nanosecond() as f64;
    // The difference first: milliseconds since 1970 leave a float a quarter of a microsecond.
    let later_s = 1e-3 * (time_code::near(&shown, about_ms) - about_ms) + screen.late_s();
    if later_s.abs() > MAX_OFFSET_S {
        return Err(format!(
            "the screen is {later_s:+.0} s off the recorder's clock (or whole turns of 41.5 minutes more); show the recorder's own clock"
        )
        .into());
    }
    let apart = jiff::SignedDuration::try_from_secs_f64(later_s).unwrap_or_default();
    let less = |utc: jiff::Timestamp| utc.duration_since(recorded).as_secs_f64() - later_s;
    Ok(Reading {
        image: name.to_owned(),
        shown: recorded.checked_add(apart).unwrap_or(recorded),
        sigma_s: screen.read_sigma_s(1e-3 * shown.width_ms),
        ticks: shown.ticks,
        command_s: less(frame.stamp.utc),
        exposure_s: frame.exposure.as_ref().map(|exposure| less(exposure.exposure_time)),
        exposure: frame.exposure.clone(),
    })
}
