//! `wingd time-check` reads images of a screen that shows the clock, checks times of exposure and measures delays.

mod page;
mod summary;

use std::path::PathBuf;

use super::{CHECK_WRITE_ACCESS, Completion, Failure, image_batch, print_line, store_access, write_failure};
use crate::camera::Format;
use crate::clock::exposure::Exposure;
use crate::measure::time_code::{self, Screen};
use crate::pipeline::guard::{PANIC_REASON, catch_panic};
use crate::pipeline::stages;
use crate::record::Reason;
use crate::store::{self, FrameRef, RealDisk};

/// Check recorded times of exposure with images of a screen that shows the clock, and determine the delay for [camera].
#[derive(clap::Args)]
pub struct TimeCheckArgs {
    /// Store with the images
    #[arg(required_unless_present = "page")]
    store: Option<PathBuf>,
    /// Write the page that shows the clock, and exit; open it in a browser on the recorder's computer
    #[arg(long, value_name = "FILE.html", conflicts_with_all = ["store", "flight", "series", "json"])]
    page: Option<PathBuf>,
    /// Flight, for example f0001 [default: all flights]
    #[arg(long)]
    flight: Option<String>,
    /// Series, for example s000003 [default: all series]
    #[arg(long)]
    series: Option<String>,
    /// Refresh rate of the screen; the page shows it
    #[arg(long, value_name = "HZ", default_value_t = 60.0)]
    refresh_hz: f64,
    /// Latency from drawing to light just above the middle of the screen, ms
    #[arg(long, value_name = "MS", default_value_t = DEFAULT_LATENCY_MS)]
    latency_ms: f64,
    /// Standard deviation of the latency, ms [default: uniform between 10 and 50 ms]
    #[arg(long, value_name = "MS", default_value_t = LATENCY_RANGE_MS / 12f64.sqrt(), hide_default_value = true)]
    latency_sigma_ms: f64,
    /// Print one JSON object per image, and a summary
    #[arg(long)]
    json: bool,
    /// Images processed in parallel [default: number of cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
}

/// Default latency from drawing to light: a browser, a compositor and a screen take 1 to 3 frames at 60 Hz, assumed uniform
/// between 10 and 50 ms if not measured.
const DEFAULT_LATENCY_MS: f64 = 30.0;
const LATENCY_RANGE_MS: f64 = 40.0;
/// Maximum difference between screen and recorder's clock, s: longer than a shot takes. A larger one means that the screen
/// does not show that clock.
const MAX_OFFSET_S: f64 = 60.0;

/// Reading of one image; times in s.
#[derive(Clone)]
pub(super) struct ScreenReading {
    /// Series and file name.
    image: String,
    /// Middle of the exposure according to the screen, UTC.
    shown: jiff::Timestamp,
    /// Standard deviation of `shown`, without that of the latency.
    sigma_s: f64,
    /// Number of clock ticks during the exposure.
    ticks: u32,
    /// Command to the camera minus `shown`.
    command_s: f64,
    /// Recorded exposure minus `shown`.
    exposure_s: Option<f64>,
    /// Exposure as recorded.
    exposure: Option<Exposure>,
}

impl ScreenReading {
    /// Returns the delay from the recorded event (stamp, edge, trigger) to the middle of the exposure according to the
    /// screen.
    fn delay_s(&self) -> Option<f64> {
        Some(self.exposure.as_ref()?.exposure_delay_s? - self.exposure_s?)
    }
}

pub(super) fn run(args: &TimeCheckArgs) -> Result<Completion, Failure> {
    if let Some(file) = &args.page {
        std::fs::write(file, page::clock_page()).map_err(write_failure(file, CHECK_WRITE_ACCESS))?;
        print_line(&format!("{}: open it on the recorder's computer, full screen", file.display()))?;
        return Ok(Completion::All);
    }
    let screen = screen_from_args(args)?;
    let chosen = select_frames(args)?;
    let mut readings = Vec::new();
    let work = |frame: &FrameRef| {
        let name = format!("{}/{}", frame.series.id, frame.entry.file);
        let read = catch_panic(|| read_screen(frame, &name, &screen)).unwrap_or_else(|| Err(PANIC_REASON.into()));
        read.map_err(|reason| (name, reason))
    };
    image_batch::run_jobs(&chosen, args.jobs, "reading", work, |read| {
        if args.json {
            print_line(&summary::json_line(&read, &screen).to_string())?;
        } else if let Err((name, reason)) = &read {
            print_line(&format!("{name}: failed: {reason}"))?;
        }
        readings.extend(read.ok());
        Ok(())
    })?;
    if readings.is_empty() {
        return Err(Failure::Failed(format!(
            "none of {} images shows a readable clock; `wingd time-check --page FILE.html` writes the page to photograph",
            chosen.len()
        )));
    }
    let summary = summary::TimeCheckSummary::from_readings(&readings, chosen.len(), &screen);
    print_line(&if args.json { summary.to_json().to_string() } else { summary.to_text(&readings, &screen) })?;
    Ok(Completion::from_success(readings.len() == chosen.len()))
}

fn screen_from_args(args: &TimeCheckArgs) -> Result<Screen, Failure> {
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

/// Selects the frames to read, in order.
fn select_frames(args: &TimeCheckArgs) -> Result<Vec<FrameRef>, Failure> {
    let Some(root) = &args.store else { return Ok(Vec::new()) };
    let mut all = Vec::new();
    for flight in store_access::select_flights(root, args.flight.as_deref())? {
        all.extend(store_access::flight_frames(&RealDisk, &flight, args.series.as_deref())?);
    }
    if all.is_empty() {
        let what = "no frame of that flight and series";
        return Err(Failure::Failed(format!("{}: {what}; list them with `ls flights/*` in the store", root.display())));
    }
    Ok(all)
}

fn read_screen(frame: &FrameRef, name: &str, screen: &Screen) -> Result<ScreenReading, Reason> {
    let bytes = store::read_frame(&RealDisk, frame).map_err(Reason::from_error)?;
    let format = Format::from_manifest(&frame.entry.format).map_err(Reason::from_error)?;
    let (processed, raster) = stages::detect_only(name, &bytes, Some(&format));
    if let Some(reason) = processed.failure {
        return Err(reason);
    }
    let Some(raster) = raster else { return Err(PANIC_REASON.into()) };
    let shown = time_code::read_time(&raster, &processed.detections).map_err(Reason::from_error)?;
    let recorded = frame.exposure.as_ref().map_or(frame.stamp.utc, |exposure| exposure.exposure_time);
    let about_ms = 1e-6 * recorded.as_nanosecond() as f64;
    // Subtract first: as a float, milliseconds since 1970 have a resolution of only 0.25 µs.
    let later_s = 1e-3 * (time_code::nearest_time(&shown, about_ms) - about_ms) + screen.display_delay_s();
    if later_s.abs() > MAX_OFFSET_S {
        return Err(format!(
            "the screen differs from the recorder's clock by {later_s:+.0} s (or by multiples of 41.5 minutes more); show the recorder's own clock"
        )
        .into());
    }
    let apart = jiff::SignedDuration::try_from_secs_f64(later_s).unwrap_or_default();
    let less = |utc: jiff::Timestamp| utc.duration_since(recorded).as_secs_f64() - later_s;
    Ok(ScreenReading {
        image: name.to_owned(),
        shown: recorded.checked_add(apart).unwrap_or(recorded),
        sigma_s: screen.read_sigma_s(1e-3 * shown.width_ms),
        ticks: shown.ticks,
        command_s: less(frame.stamp.utc),
        exposure_s: frame.exposure.as_ref().map(|exposure| less(exposure.exposure_time)),
        exposure: frame.exposure.clone(),
    })
}
