//! `wingd demo` sends a bundled flight through the real daemon, with no hardware and no configuration.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use tracing::level_filters::LevelFilter;

use super::{Done, Failure, logging, print, service, unwritable};
use crate::camera::replay::ReplayConfig;
use crate::camera::section::CameraSection;
use crate::clock::{Clock, Simulated};
use crate::config::{Config, SolveConfig};
use crate::daemon::{Event, Observer, PowerConfig, SeriesConfig, StatusConfig};
use crate::installation;
use crate::pipeline::orienting;
use crate::report::{html, source, summary, table};
use crate::store::{RealDisk, StoreConfig, verify};

/// A bundled flight of 8.5 hours through the real daemon: ends with a store and a report.
#[derive(clap::Args)]
pub struct Args {
    /// Where input, store and report go
    #[arg(long, value_name = "DIR", default_value = "wingd-demo")]
    output: PathBuf,
}

/// Files of `fixtures/demo`, each with its name there and its bytes.
macro_rules! bundled {
    ($($name:literal)*) => {
        &[$(($name, include_bytes!(concat!("../../fixtures/demo/", $name)).as_slice())),*]
    };
}

const BUNDLE: &[(&str, &[u8])] = bundled![
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

/// The flight of the demonstration.
const FLIGHT: Duration = Duration::from_secs(8 * 3600 + 1800);
const SHOTS: u32 = 2;
/// The bundle shows the wing every two hours.
const INTERVAL: Duration = Duration::from_secs(2 * 3600);
/// Simulated seconds per second: an hour between two series passes in a moment.
const SPEED_UP: f64 = 20_000.0;
const TAKE_OFF: i64 = 1_780_300_800;

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    logging::start_at(LevelFilter::WARN);
    let input = args.output.join("input");
    unpack(&input)?;
    let installation = input.join("installation");
    orient(&installation, &input.join("frames/ground.jpg"))?;
    fly(&args.output, &input, &installation)?;
    finish(&args.output, &installation)
}

/// Writes the bundled files; those that are there already and equal stay.
fn unpack(input: &Path) -> Result<(), Failure> {
    for (name, bytes) in BUNDLE {
        let path = input.join(name);
        if std::fs::read(&path).is_ok_and(|there| there == *bytes) {
            continue;
        }
        let made = path.parent().map_or(Ok(()), std::fs::create_dir_all);
        let written = made.and_then(|()| std::fs::write(&path, bytes));
        written.map_err(unwritable(&path, "name another --output"))?;
    }
    Ok(())
}

/// The ground frame's orientation, as `wingd orient` finds it.
fn orient(directory: &Path, ground: &Path) -> Result<(), Failure> {
    if installation::load(directory).is_ok_and(|i| i.orientation.is_some()) {
        return Ok(());
    }
    let undone = |error: &dyn std::error::Error| Failure::Failed(format!("{}: {error}", ground.display()));
    let installation = installation::load_without_orientation(directory)?;
    let bytes = std::fs::read(ground).map_err(|e| undone(&e))?;
    let frame = orienting::sight("ground.jpg", &bytes, &installation);
    let mut frames = [frame.map_err(|e| undone(&e))?];
    let fit = orienting::orient(&installation.setup, &mut frames).map_err(|e| undone(&e))?;
    let [frame] = frames;
    let images = [(frame.sighting.image, frame.sighting.digest)];
    installation::write_orientation(&installation, &fit, &images).map_err(|e| undone(&e))
}

/// The daemon, until its timetable is over. A demo that was broken off goes on where it stopped.
fn fly(output: &Path, input: &Path, directory: &Path) -> Result<(), Failure> {
    let config = Config {
        installation: Some(directory.to_owned()),
        camera: CameraSection::Replay(ReplayConfig::list(input.join("frames.toml"))),
        series: SeriesConfig {
            interval: INTERVAL,
            shots: SHOTS,
            until: Some(FLIGHT),
            ..SeriesConfig::default()
        },
        store: StoreConfig { reserve_mb: 100, ..StoreConfig::at(output.join("store")) },
        live: crate::daemon::LiveConfig::default(),
        power: PowerConfig::default(),
        status: StatusConfig { socket: output.join("wingd.sock") },
        solve: SolveConfig::default(),
        serve: None,
    };
    let solver = service::solver(directory, &config.solve)?;
    let opened = service::open_store(&config)?;
    service::keep_installation(&opened.store, directory);
    let begun = opened.store.last_moment();
    let take_off = jiff::Timestamp::from_second(TAKE_OFF).unwrap_or_default();
    let clock: Arc<dyn Clock> = Arc::new(match &begun {
        Some(last) => Simulated::starting_at(last, Some(SPEED_UP)),
        None => Simulated::new("demo", take_off, Some(SPEED_UP)),
    });
    let origin = opened.store.series_of_boot("demo").first().copied().unwrap_or_else(|| clock.since_boot());
    service::run(&config, clock, origin, opened, Some(solver), progress())?;
    Ok(())
}

/// A bar on standard error: frames stored, and how many of them are solved.
fn progress() -> Observer {
    let series = FLIGHT.as_secs() / INTERVAL.as_secs() + 1;
    let bar = super::frames::progress((series * u64::from(SHOTS)) as usize, "flying");
    Arc::new(move |event| match event {
        Event::SeriesBegan { series, .. } => bar.set_message(format!("series {series}")),
        Event::Solved { .. } => bar.inc(1),
        _ => (),
    })
}

/// Verifies, writes the report, says where things are.
fn finish(output: &Path, directory: &Path) -> Result<Done, Failure> {
    let store = output.join("store");
    let checked = verify::verify(&RealDisk, &store);
    let setup = installation::load(directory)?.setup;
    let data = source::flight(&store, source::Choice::default(), Some(&setup))?;
    let page = output.join("report.html");
    std::fs::write(&page, html::page(&data)).map_err(unwritable(&page, "free space"))?;
    print(table::series(&summary::summaries(&data.series), false).trim_end())?;
    for fault in &checked.faults {
        eprintln!("wingd: invariant {}: {}: {}", fault.invariant, fault.path.display(), fault.what);
    }
    let sound = if checked.is_sound() { "sound" } else { "NOT SOUND" };
    print(&format!(
        "\nStore: {} ({sound}, {} frames)   Report: {}",
        store.display(),
        checked.frames,
        page.display()
    ))?;
    Ok(Done::all(checked.is_sound()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn files(folder: &Path) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
        entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
    }

    #[test]
    fn every_file_of_the_fixture_is_bundled() {
        let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/demo");
        let mut there = files(&fixture);
        there.sort();
        let mut bundled: Vec<PathBuf> = BUNDLE.iter().map(|(name, _)| fixture.join(name)).collect();
        bundled.sort();
        assert_eq!(bundled, there);
    }
}
