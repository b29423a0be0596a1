//! `wingd time-check` reads images of a screen that shows the clock, checks times of exposure and measures delays.

use std::path::PathBuf;

use serde_json::{Value, json};

use super::{Completion, Failure, TaskResult, batch, print_json, print_line, write_output};
use crate::desk::stored_flights::{self, frame_name};
use crate::desk::time_check::{
    ConfigurationLines, NoConfiguration, ScreenReading, TimeCheckSummary,
};
use crate::desk::{CHECK_WRITE_ACCESS, clock_page};
use crate::measure::time_code::{DelayEstimate, ExposureTest, Screen};
use crate::record::Reason;
use crate::report::grid::{ColumnDefinition::One, Grid};
use crate::report::number::format_fixed;
use crate::store::{FrameRef, RealDisk};

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
/// Width of that uniform distribution, ms.
const LATENCY_RANGE_MS: f64 = 40.0;

pub(super) fn run(args: &TimeCheckArgs) -> TaskResult<Completion> {
    if let Some(file) = &args.page {
        write_output(file, clock_page::clock_page(), CHECK_WRITE_ACCESS)?;
        print_line(&format!(
            "{}: open it on the recorder's computer, full screen",
            file.display()
        ))?;
        return Ok(Completion::All);
    }
    let screen = screen_from_args(args)?;
    let chosen = select_frames(args)?;
    let mut readings = Vec::new();
    let work = |frame: &FrameRef, bytes: Result<&[u8], Reason>| {
        bytes
            .and_then(|bytes| ScreenReading::read(frame, bytes, &screen))
            .map_err(|why| (frame_name(frame), why))
    };
    batch::for_each_stored_frame(&chosen, args.jobs, "reading", work, |read| {
        if args.json {
            print_json(&reading_json(&read, &screen))?;
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
    let summary = TimeCheckSummary::from_readings(&readings, chosen.len(), &screen);
    print_line(&if args.json {
        summary_json(&summary).to_string()
    } else {
        summary_text(&summary, &readings, &screen)
    })?;
    Ok(Completion::from_success(readings.len() == chosen.len()))
}

fn screen_from_args(args: &TimeCheckArgs) -> TaskResult<Screen> {
    let sound = (1.0..=1000.0).contains(&args.refresh_hz)
        && (0.0..=1000.0).contains(&args.latency_ms)
        && (0.0..=1000.0).contains(&args.latency_sigma_ms);
    if !sound {
        let text =
            "--refresh-hz must be in 1 to 1000, --latency-ms and --latency-sigma-ms in 0 to 1000";
        return Err(Failure::Usage(text.into()));
    }
    Ok(Screen {
        refresh_s: args.refresh_hz.recip(),
        latency_s: 1e-3 * args.latency_ms,
        latency_sigma_s: 1e-3 * args.latency_sigma_ms,
    })
}

/// Selects the frames to read, in order.
fn select_frames(args: &TimeCheckArgs) -> TaskResult<Vec<FrameRef>> {
    let Some(root) = &args.store else {
        return Ok(Vec::new());
    };
    let mut all = Vec::new();
    for flight in stored_flights::select_flights(root, args.flight.as_deref())? {
        all.extend(stored_flights::flight_frames(
            &RealDisk,
            &flight,
            args.series.as_deref(),
        )?);
    }
    if all.is_empty() {
        let what = "no frame of that flight and series; list them with `ls flights/*` in the store";
        return Err(Failure::from_path_error(root, what));
    }
    Ok(all)
}

fn summary_json(summary: &TimeCheckSummary) -> Value {
    json!({ "summary": {
        "pictures": summary.pictures,
        "read": summary.command.map(|d| d.images),
        "command_less_shown": summary.command.as_ref().map(delay_json),
        "exposure_less_shown": summary.exposure.as_ref().map(|test| {
            let mut all = delay_json(&test.difference);
            all["stated_sigma_s"] = test.recorded_s.into();
            all["normalised"] = test.normalised.into();
            all["verdict"] = exposure_verdict_word(test).into();
            all
        }),
        "delay": summary.delay.as_ref().map(delay_json),
        "configuration": summary.lines.as_ref().ok().map(|lines| &lines.text),
        "reason": summary.lines.as_ref().err().map(NoConfiguration::to_string),
    }})
}

fn summary_text(summary: &TimeCheckSummary, readings: &[ScreenReading], screen: &Screen) -> String {
    let mut out = reading_table(readings).text();
    let ms = |seconds: f64| format!("{:.1}", 1e3 * seconds);
    let describe = |name: &str, d: &DelayEstimate| {
        let scatter = d.scatter_s.map_or("-".to_owned(), ms);
        format!(
            "{name}: mean {:+.1} ms, standard deviation {} ms; scatter {scatter} ms, of which {} ms from reading the clock\n",
            1e3 * d.mean_s,
            ms(d.mean_sigma_s),
            ms(d.read_sigma_s)
        )
    };
    out.push_str(&format!(
        "\n{} of {} images read; the standard deviation of each mean includes {} ms for the screen's latency, common to all images and not in the rows\n",
        readings.len(),
        summary.pictures,
        ms(screen.latency_sigma_s)
    ));
    out.push_str(
        &summary
            .command
            .as_ref()
            .map_or(String::new(), |d| describe("command minus screen", d)),
    );
    if let Some(test) = &summary.exposure {
        out.push_str(&describe("exposure minus screen", &test.difference));
        out.push_str(&format!(
            "recorded standard deviation {} ms: {} ({:.1} standard deviations)\n",
            ms(test.recorded_s),
            exposure_verdict_word(test),
            test.normalised
        ));
    }
    out.push_str(&summary.delay.as_ref().map_or(String::new(), |d| {
        describe("delay from stamp or edge to exposure", d)
    }));
    match &summary.lines {
        Ok(ConfigurationLines { text, section }) => {
            out.push_str(&format!("\nFor {section}:\n{text}"))
        }
        Err(reason) => out.push_str(&format!(
            "\nNo delay to enter in the configuration: {reason}\n"
        )),
    }
    out
}

fn exposure_verdict_word(test: &ExposureTest) -> &'static str {
    if test.agrees { "agrees" } else { "disagrees" }
}

fn delay_json(d: &DelayEstimate) -> Value {
    json!({
        "pictures": d.images, "mean_s": d.mean_s, "sigma_mean_s": d.mean_sigma_s, "scatter_s": d.scatter_s,
        "reading_sigma_s": d.read_sigma_s, "sigma_s": d.sigma_s,
    })
}

fn reading_table(readings: &[ScreenReading]) -> Grid {
    let ms = |seconds: Option<f64>| format_fixed(seconds.map(|s| 1e3 * s), 1);
    let recorded = |r: &ScreenReading| {
        r.exposure
            .as_ref()
            .map(|e| e.exposure_sigma_s.hypot(r.sigma_s))
    };
    Grid::for_rows(readings).columns(&[
        One("<image", &|r| r.image.clone()),
        One("<exposure on the screen (UTC)", &|r| {
            r.shown.strftime("%m-%d %H:%M:%S%.3f").to_string()
        }),
        One("sigma / ms", &|r| ms(Some(r.sigma_s))),
        One("ticks", &|r| r.ticks.to_string()),
        One("command minus screen / ms", &|r| ms(Some(r.command_s))),
        One("exposure minus screen / ms", &|r| ms(r.exposure_s)),
        One("sigma / ms", &|r| ms(recorded(r))),
    ])
}

/// Returns the JSON of an image; its standard deviations include the screen's latency.
fn reading_json(read: &Result<ScreenReading, (String, Reason)>, screen: &Screen) -> Value {
    match read {
        Err((image, reason)) => {
            json!({ "image": image, "status": "failed", "reason": reason.text() })
        }
        Ok(r) => {
            let sigma_s = r.sigma_s.hypot(screen.latency_sigma_s);
            let recorded_s = r.exposure.as_ref().map(|e| e.exposure_sigma_s);
            json!({
                "image": r.image, "status": "ok", "shown_time": r.shown, "sigma_shown_s": sigma_s, "ticks": r.ticks,
                "command_less_shown_s": r.command_s, "sigma_command_less_shown_s": sigma_s,
                "exposure_less_shown_s": r.exposure_s,
                "sigma_exposure_less_shown_s": recorded_s.map(|recorded| recorded.hypot(sigma_s)),
                "exposure_sigma_s": recorded_s,
                "exposure_source": r.exposure.as_ref().map(|e| e.exposure_source),
                "delay_s": r.delay_s(),
            })
        }
    }
}
