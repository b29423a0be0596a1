//! `wingd demo` runs a bundled flight through the real daemon, without hardware or configuration.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use tracing::level_filters::LevelFilter;

use crate::camera::replay::ReplayConfig;
use crate::camera::section::CameraSection;
use crate::cli::recorder;
use crate::config::{Config, SolveConfig};
use crate::daemon::{Event, Observer, PowerConfig, SeriesConfig, StatusConfig};
use wingd_base::clock::{Clock, SimulatedClock};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_line, print_notes, write_output};
use wingd_desk::report as html;
use wingd_evaluation::installation;
use wingd_evaluation::pipeline::orienting;
use wingd_evaluation::results::{source, summary, table};
use wingd_store::{RealDisk, StoreConfig, verify};

/// Run a bundled flight of 8.5 hours through the real recorder: writes a store and a report.
#[derive(clap::Args)]
pub struct DemoArgs {
    /// Directory for input, store and report
    #[arg(long, value_name = "DIR", default_value = "wingd-demo")]
    output: PathBuf,
}

/// Lists files of `fixtures/demo`, each with its name and its bytes.
macro_rules! bundled {
    ($($name:literal)*) => {
        &[$(($name, include_bytes!(concat!("../../fixtures/demo/", $name)).as_slice())),*]
    };
}

const BUNDLED_FILES: &[(&str, &[u8])] = bundled![
    "README.md"
    "frames.toml"
    "frames/flight-01.jpg"
    "frames/flight-02.jpg"
    "frames/flight-03.jpg"
    "frames/flight-04.jpg"
    "frames/flight-05.jpg"
    "frames/flight-06.jpg"
    "frames/flight-07.jpg"
    "frames/flight-08.jpg"
    "frames/flight-09.jpg"
    "frames/flight-10.jpg"
    "frames/ground.jpg"
    "installation/camera.toml"
    "installation/installation.toml"
    "installation/survey.csv"
    "truth.json"
];

/// Duration of the demonstration flight.
const FLIGHT_DURATION: Duration = Duration::from_secs(8 * 3600 + 1800);
const SHOTS_PER_SERIES: u32 = 2;
/// Interval between series: the bundle shows the wing every 2 hours.
const SERIES_INTERVAL: Duration = Duration::from_secs(2 * 3600);
/// Simulated seconds per second: the time between two series passes at once.
const SPEED_UP: f64 = 20_000.0;
const TAKE_OFF_UNIX_S: i64 = 1_780_300_800;

pub(super) fn run(args: &DemoArgs) -> TaskResult<Completion> {
    wingd_base::logging::start_logging(LevelFilter::WARN);
    let input = args.output.join("input");
    unpack_files(&input)?;
    let installation = input.join("installation");
    orient_camera(&installation, &input.join("frames/ground.jpg"))?;
    record_flight(&args.output, &input, &installation)?;
    verify_and_report(&args.output, &installation)
}

/// Writes the bundled files, except those that exist with the same content.
fn unpack_files(input: &Path) -> TaskResult<()> {
    for (name, bytes) in BUNDLED_FILES {
        let path = input.join(name);
        if std::fs::read(&path).is_ok_and(|there| there == *bytes) {
            continue;
        }
        let made = path.parent().map_or(Ok(()), std::fs::create_dir_all);
        let written = made.and_then(|()| std::fs::write(&path, bytes));
        written
            .map_err(|error| Failure::from_write_error(&path, &error, "name another --output"))?;
    }
    Ok(())
}

/// Estimates the orientation from the ground frame, as `wingd orient` does.
fn orient_camera(directory: &Path, ground: &Path) -> TaskResult<()> {
    if installation::load(directory).is_ok_and(|i| i.orientation.is_some()) {
        return Ok(());
    }
    let installation = installation::load_without_orientation(directory)?;
    let bytes = std::fs::read(ground).map_err(|e| Failure::from_path_error(ground, e))?;
    let frame = orienting::process_ground_frame("ground.jpg", &bytes, &installation.setup);
    let mut frames = [frame.map_err(|e| Failure::from_path_error(ground, e))?];
    let fit = orienting::orient_frames(&installation.setup, &mut frames);
    let fit = fit.map_err(|e| Failure::from_path_error(ground, e))?;
    let [frame] = frames;
    let images = [(frame.processed.image, frame.processed.digest)];
    installation::write_orientation(&installation, &fit, &images, None)
        .map_err(|e| Failure::from_path_error(ground, e))
}

/// Runs the daemon until the end of its timetable. An interrupted demo is resumed.
fn record_flight(output: &Path, input: &Path, directory: &Path) -> TaskResult<()> {
    let config = Config {
        installation: Some(directory.to_owned()),
        camera: CameraSection::Replay(ReplayConfig::from_list(input.join("frames.toml"))),
        series: SeriesConfig {
            interval: SERIES_INTERVAL,
            shots: SHOTS_PER_SERIES,
            until: Some(FLIGHT_DURATION),
            ..SeriesConfig::default()
        },
        store: StoreConfig {
            reserve_mb: 100,
            ..StoreConfig::new(output.join("store"))
        },
        live: crate::daemon::LiveConfig::default(),
        power: PowerConfig::default(),
        status: StatusConfig {
            socket: output.join("wingd.sock"),
        },
        solve: SolveConfig::default(),
        serve: None,
    };
    let opened = recorder::open_store(&config)?;
    let begun = opened.store.last_moment();
    let take_off = jiff::Timestamp::from_second(TAKE_OFF_UNIX_S).unwrap_or_default();
    let clock: Arc<dyn Clock> = Arc::new(match &begun {
        Some(last) => SimulatedClock::starting_at(last, Some(SPEED_UP)),
        None => SimulatedClock::new("demo", take_off, Some(SPEED_UP)),
    });
    let origin = opened
        .store
        .series_starts_in_boot("demo")
        .first()
        .copied()
        .unwrap_or_else(|| clock.since_boot());
    recorder::run_recorder(&config, clock, origin, opened, flight_progress())?;
    Ok(())
}

/// Creates a progress bar of the frames solved, on standard error.
fn flight_progress() -> Observer {
    let series = FLIGHT_DURATION.as_secs() / SERIES_INTERVAL.as_secs() + 1;
    let bar =
        wingd_base::output::progress_bar((series * u64::from(SHOTS_PER_SERIES)) as usize, "flying");
    Arc::new(move |event| match event {
        Event::SeriesBegan { series, .. } => bar.set_message(format!("series {series}")),
        Event::Solved { .. } => bar.inc(1),
        _ => (),
    })
}

/// Verifies the store, writes the report, and prints the paths of both.
fn verify_and_report(output: &Path, directory: &Path) -> TaskResult<Completion> {
    let store = output.join("store");
    let checked = verify::verify_path(&RealDisk, &store);
    let setup = installation::load(directory)?.setup;
    let data = source::read_flight(&store, source::ResultChoice::default(), Some(&setup))?;
    let page = output.join("report.html");
    write_output(&page, html::report_page(&data), "free space")?;
    print_line(table::series_text(&summary::summarise_series(&data.series), false).trim_end())?;
    print_notes(&checked.faults);
    let sound = if checked.is_sound() {
        "sound"
    } else {
        "NOT SOUND"
    };
    print_line(&format!(
        "\nStore: {} ({sound}, {} frames)   Report: {}",
        store.display(),
        checked.frames,
        page.display()
    ))?;
    Ok(Completion::from_success(checked.is_sound()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(folder: &Path) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().path());
        entries
            .flat_map(|path| {
                if path.is_dir() {
                    files(&path)
                } else {
                    vec![path]
                }
            })
            .collect()
    }

    #[test]
    fn every_file_of_the_fixture_is_bundled() {
        let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/demo");
        let mut there = files(&fixture);
        there.sort();
        let mut bundled: Vec<PathBuf> = BUNDLED_FILES
            .iter()
            .map(|(name, _)| fixture.join(name))
            .collect();
        bundled.sort();
        assert_eq!(bundled, there);
    }
}
