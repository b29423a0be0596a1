//! Promise: a day on in-seat power, which is switched off at every taxi, take-off and landing without warning, costs
//! at most the shot in progress; flights stay complete and separate.

use crate::common::store_reading::read_results;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::common::fake_disk::{DiskFault, FakeDisk, Survival};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use serde_json::Map;
use wingd::camera::Camera;
use wingd::camera::replay::{ReplayConfig, ReplayFactory};
use wingd::clock::{Clock, SimulatedClock, Stamp};
use wingd::daemon::{self, DaemonParts, Event, PowerConfig, SeriesConfig, Solver, StatusBoard};
use wingd::record::ImageRecord;
use wingd::store::verify::verify_path;
use wingd::store::{Disk, Inputs, Store, StoreConfig, catalogue};

use super::power_fails::picture;

/// Minutes of the day with power, flight by flight: at the gate, between taxi and take-off, in cruise, at the gate.
const POWERED_MIN: [&[(u64, u64)]; 3] = [
    &[(360, 385), (388, 402), (410, 560), (575, 600)],
    &[(800, 822), (826, 841), (850, 935), (948, 970)],
    &[(1200, 1231), (1236, 1250), (1259, 1400), (1412, 1439)],
];
const INTERVAL: Duration = Duration::from_secs(600);
const SHOTS: u32 = 3;
/// A turnaround is longer than the time without power in a flight.
const NEW_FLIGHT_AFTER: Duration = Duration::from_secs(90 * 60);
const ROOT: &str = "store";

/// Acknowledgements, which outlive the power supply of the machine.
#[derive(Default)]
struct Acknowledgements {
    /// Series, file, hash.
    frames: BTreeSet<[String; 3]>,
    solved: BTreeSet<[String; 2]>,
    begun: usize,
}

/// Runs from boot until the time is over; the power may fail before.
fn boot(
    disk: Arc<FakeDisk>,
    number: usize,
    minutes: (u64, u64),
    frames: &Path,
    heard: &Arc<Mutex<Acknowledgements>>,
) {
    let day: jiff::Timestamp = "2026-03-01T00:00:00Z".parse().unwrap();
    let utc = day + Duration::from_secs(60 * minutes.0);
    let start = Stamp {
        utc,
        utc_synchronised: false,
        boot_id: format!("boot {number}"),
        since_boot_s: 20.0,
    };
    let clock = Arc::new(SimulatedClock::starting_at(&start, None));
    let replay = ReplayConfig {
        folder: Some(frames.to_owned()),
        repeat: true,
        ..ReplayConfig::default()
    };
    let cameras = ReplayFactory::new(replay, clock.clone(), clock.since_boot());
    let config = StoreConfig {
        reserve_mb: 0,
        new_flight_after: NEW_FLIGHT_AFTER,
        ..StoreConfig::new(ROOT)
    };
    let Ok((store, recovery)) = Store::open(disk, config) else {
        return;
    };
    let heard = heard.clone();
    let parts = DaemonParts {
        live: wingd::daemon::LiveConfig::default(),
        series: SeriesConfig {
            interval: INTERVAL,
            shots: SHOTS,
            stale_window: 1,
            until: Some(Duration::from_secs(60 * (minutes.1 - minutes.0) - 30)),
            ..SeriesConfig::default()
        },
        power: PowerConfig::default(),
        status: None,
        store: Arc::new(store),
        recovery,
        clock: clock.clone(),
        cameras: Arc::new(move || Box::new(cameras.make()) as Box<dyn Camera>),
        solver: Some(
            Solver {
                inputs: Inputs::new(Map::new()),
                solve: Arc::new(|name, _, _| ImageRecord::failed(name, "a test")),
                deadline: Duration::from_secs(60),
                track: None,
            }
            .into_source(),
        ),
        observer: Arc::new(move |event| {
            let mut heard = heard.lock().unwrap();
            match event.clone() {
                Event::FrameStored {
                    series,
                    file,
                    sha256,
                    ..
                } => {
                    assert!(
                        heard.frames.insert([series, file, sha256]),
                        "a frame is promised twice"
                    );
                }
                Event::Solved { series, file, .. } => {
                    assert!(
                        heard.solved.insert([series, file]),
                        "a frame is solved twice"
                    );
                }
                Event::SeriesBegan { .. } => heard.begun += 1,
                _ => {}
            }
        }),
    };
    daemon::run(parts, &StatusBoard::new(clock)).unwrap();
}

/// Flight -> series, and every frame with its number of results.
type Holdings = (BTreeMap<String, usize>, BTreeMap<[String; 3], usize>);

fn holdings(disk: &dyn Disk) -> Holdings {
    let (mut flights, mut frames) = Holdings::default();
    for flight in catalogue::list_flights(disk, Path::new(ROOT)).unwrap() {
        let all = catalogue::list_series(disk, &flight).unwrap();
        flights.insert(flight.id.clone(), all.len());
        for series in all {
            let results = read_results(disk, &series).unwrap();
            let manifest = catalogue::read_series_manifest(disk, &series).unwrap();
            for frame in manifest.shots.into_iter().filter_map(|shot| shot.frame) {
                let count = results
                    .iter()
                    .filter(|line| line.frame == frame.file)
                    .count();
                frames.insert([series.id.clone(), frame.file, frame.sha256], count);
            }
        }
    }
    (flights, frames)
}

fn day(seed: u64, frames: &Path) -> (usize, usize) {
    let mut random = StdRng::seed_from_u64(seed);
    let heard = Arc::new(Mutex::new(Acknowledgements::default()));
    let mut disk = Arc::new(FakeDisk::default());
    let periods: Vec<_> = POWERED_MIN.into_iter().flatten().copied().collect();
    for (number, minutes) in periods.iter().enumerate() {
        // The number of steps of these minutes, found on a copy; the power fails in the last third of them.
        let trial = Arc::new(disk.fork());
        boot(trial.clone(), number, *minutes, frames, &Arc::default());
        let steps = trial.steps();
        disk.set_faults(vec![DiskFault::PowerCut(
            random.random_range(steps * 2 / 3..=steps),
        )]);
        boot(disk.clone(), number, *minutes, frames, &heard);
        disk = Arc::new(disk.power_up(Survival::random(random.random())));
        let report = verify_path(disk.as_ref(), Path::new(ROOT));
        assert!(
            report.is_sound(),
            "day {seed}, boot {number}: {:#?}",
            report.faults
        );
    }
    // On the ground, in the evening: the rest is recovered and solved.
    boot(disk.clone(), periods.len(), (1440, 1442), frames, &heard);
    let report = verify_path(disk.as_ref(), Path::new(ROOT));
    assert!(report.is_sound(), "day {seed}: {:#?}", report.faults);
    let (flights, held) = holdings(disk.as_ref());
    let heard = heard.lock().unwrap();
    let lost: Vec<_> = heard
        .frames
        .iter()
        .filter(|frame| !held.contains_key(*frame))
        .collect();
    assert!(lost.is_empty(), "day {seed}: {lost:?}");
    assert!(
        held.values().all(|results| *results == 1),
        "day {seed}: every frame is solved once: {held:?}"
    );
    assert_eq!(flights.len(), POWERED_MIN.len(), "day {seed}: {flights:?}");
    (heard.frames.len(), heard.begun)
}

#[test]
fn a_day_of_in_seat_power_loses_nothing_acknowledged() {
    let dir = tempfile::tempdir().unwrap();
    for n in 0..200 {
        std::fs::write(dir.path().join(format!("{n:03}.jpg")), picture(n)).unwrap();
    }
    for seed in 0..8 {
        let (frames, begun) = day(seed, dir.path());
        println!("day {seed}: {begun} series begun, {frames} frames promised, all there");
        // By the timetable 45 to 50 series fit into the minutes with power.
        assert!(
            begun >= 40 && frames >= 100,
            "{begun} series, {frames} frames"
        );
    }
}
