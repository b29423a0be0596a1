//! Promise: the daemon continues through any camera failure, and the store records what happened.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde_json::{Map, Value, json};
use wingd::camera::replay::{FaultKind, ReplayCamera, ReplayConfig, ReplayFactory, ScriptedFault};
use wingd::camera::{Camera, CameraError, CameraFrame, CameraInfo};
use wingd::clock::{Clock, SimulatedClock};
use wingd::daemon::{
    self, DaemonParts, DaemonStatus, Event, Health, SeriesConfig, Solver, StatusBoard, StatusConfig,
};
use wingd::record::ImageRecord;
use wingd::store::manifest::{SeriesCause, SeriesManifest, SeriesState};
use wingd::store::verify::verify_path;
use wingd::store::{Inputs, RealDisk, Store, StoreConfig, catalogue};
use wingd_evaluation::frame_format::Format;

/// JPEG files of different content.
fn frames(dir: &Path, count: u8) {
    for i in 0..count {
        let grey: Vec<u8> = (0..32 * 32)
            .map(|k| (k * (i as usize + 3) % 251) as u8)
            .collect();
        let mut bytes = Vec::new();
        let encoder = jpeg_encoder::Encoder::new(&mut bytes, 90);
        encoder
            .encode(&grey, 32, 32, jpeg_encoder::ColorType::Luma)
            .unwrap();
        std::fs::write(dir.join(format!("f{i:02}.jpg")), bytes).unwrap();
    }
}

fn fault(shot: u64, kind: FaultKind) -> ScriptedFault {
    ScriptedFault {
        shot,
        kind,
        lasting: Duration::from_secs(3),
    }
}

fn record(image: &str) -> ImageRecord {
    serde_json::from_value(json!({
        "image": image, "status": "ok", "method": "spatial", "variance_factor": 1.0, "redundancy": 3,
        "global_test": "passed", "sigma_kind": "prior", "model": {}, "tip": null, "markers": [],
        "torsion": [], "timing_ms": {}
    }))
    .unwrap()
}

/// A replay camera with frames on its card; a frame is deleted when our copy is durable.
struct CameraWithCard {
    replay: ReplayCamera,
    card: Arc<Mutex<Vec<Vec<u8>>>>,
    fetched: bool,
}

impl Camera for CameraWithCard {
    fn open(&mut self) -> Result<CameraInfo, CameraError> {
        self.replay.open()
    }
    fn recover(&mut self, _deadline: Duration) -> Result<Option<CameraFrame>, CameraError> {
        let left = self.card.lock().unwrap().last().cloned();
        self.fetched = left.is_some();
        Ok(left.map(|bytes| CameraFrame {
            bytes,
            format: Format::Jpeg,
            settings: Map::new(),
            exposed: None,
        }))
    }
    fn shoot(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError> {
        self.replay.shoot(deadline)
    }
    fn release_last(&mut self) -> Result<(), CameraError> {
        if std::mem::take(&mut self.fetched) {
            self.card.lock().unwrap().pop();
        }
        Ok(())
    }
    fn close(&mut self) {
        self.replay.close();
    }
}

pub struct Flight {
    card: Arc<Mutex<Vec<Vec<u8>>>>,
    pub dir: tempfile::TempDir,
    pub clock: Arc<SimulatedClock>,
    series: SeriesConfig,
    replay: ReplayConfig,
    solve: Arc<dyn Fn(&str) -> ImageRecord + Send + Sync>,
    solver_deadline: Duration,
    pub status: Option<StatusConfig>,
    events: Arc<Mutex<Vec<Event>>>,
}

impl Flight {
    pub fn new(faults: Vec<ScriptedFault>) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("frames");
        std::fs::create_dir(&folder).unwrap();
        frames(&folder, 40);
        let mut replay = ReplayConfig::from_folder(folder);
        replay.fault = faults;
        let series = SeriesConfig {
            shots: 4,
            shot_deadline: Duration::from_millis(200),
            open_deadline: Duration::from_millis(400),
            until: Some(Duration::from_secs(2 * 3600 + 1800)),
            ..SeriesConfig::default()
        };
        let clock = Arc::new(SimulatedClock::new(
            "boot",
            "2026-03-01T06:00:00Z".parse().unwrap(),
            None,
        ));
        let solve = Arc::new(|image: &str| record(image));
        let solver_deadline = Duration::from_secs(60);
        let (card, events) = (Arc::default(), Arc::default());
        Self {
            card,
            dir,
            clock,
            series,
            replay,
            solve,
            solver_deadline,
            status: None,
            events,
        }
    }

    fn root(&self) -> std::path::PathBuf {
        self.dir.path().join("store")
    }

    pub fn run_flight(&self) -> DaemonStatus {
        let mut config = StoreConfig::new(self.root());
        config.reserve_mb = 0;
        let (store, recovery) = Store::open(Arc::new(RealDisk), config).unwrap();
        let replay = ReplayFactory::new(
            self.replay.clone(),
            self.clock.clone(),
            self.clock.since_boot(),
        );
        let solve = self.solve.clone();
        let events = self.events.clone();
        let card = self.card.clone();
        let camera = move || CameraWithCard {
            replay: replay.make(),
            card: card.clone(),
            fetched: false,
        };
        let board = StatusBoard::new(self.clock.clone());
        let mut provenance = Map::new();
        provenance.insert("installation".to_owned(), Value::from("test"));
        let parts = DaemonParts {
            live: wingd::daemon::LiveConfig::default(),
            series: self.series.clone(),
            power: daemon::PowerConfig::default(),
            status: self.status.clone(),
            store: Arc::new(store),
            recovery,
            clock: self.clock.clone(),
            cameras: Arc::new(move || Box::new(camera()) as Box<dyn Camera>),
            solver: Some(
                Solver {
                    inputs: Inputs::new(provenance),
                    solve: Arc::new(move |image, _, _| solve(image)),
                    deadline: self.solver_deadline,
                    track: None,
                }
                .into_source(),
            ),
            observer: Arc::new(move |event| events.lock().unwrap().push(event.clone())),
        };
        daemon::run(parts, &board).unwrap()
    }

    pub fn manifests(&self) -> Vec<SeriesManifest> {
        let mut found = Vec::new();
        for flight in catalogue::list_flights(&RealDisk, &self.root()).unwrap() {
            for series in catalogue::list_series(&RealDisk, &flight).unwrap() {
                found.push(catalogue::read_series_manifest(&RealDisk, &series).unwrap());
            }
        }
        found
    }

    pub fn verify_store(&self) -> wingd::store::verify::VerifyReport {
        let report = verify_path(&RealDisk, &self.root());
        assert!(report.is_sound(), "{:#?}", report.faults);
        report
    }
}

/// Kinds of a shot's failures.
fn kinds(manifest: &SeriesManifest, shot: u32) -> Vec<&str> {
    let shot = manifest.shots.iter().find(|s| s.shot == shot).unwrap();
    shot.failures
        .iter()
        .map(|failure| failure.kind.as_str())
        .collect()
}

#[test]
fn an_undisturbed_flight_is_recorded_and_solved() {
    let flight = Flight::new(Vec::new());
    let status = flight.run_flight();
    let report = flight.verify_store();
    assert_eq!(
        (report.flights, report.series, report.frames, report.results),
        (1, 3, 12, 12)
    );
    assert_eq!(
        (
            status.counts.frames,
            status.counts.solved,
            status.counts.series_complete
        ),
        (12, 12, 3)
    );
    assert_eq!(status.health, Health::Ok);
    let started: Vec<f64> = flight
        .manifests()
        .iter()
        .map(|m| m.started.as_ref().unwrap().since_boot_s)
        .collect();
    assert_eq!(started, [30.0, 3630.0, 7230.0]);
    let manifest = &flight.manifests()[0];
    assert_eq!(
        manifest.shots[1].stamp.since_boot_s - manifest.shots[0].stamp.since_boot_s,
        2.0
    );
    assert_eq!(manifest.camera["name"], "replay");
    let stored = std::fs::read(flight.root().join("flights/f0001/s000002/0001.jpg")).unwrap();
    assert_eq!(
        stored,
        std::fs::read(flight.dir.path().join("frames/f04.jpg")).unwrap(),
        "bytes as sent"
    );
}

#[test]
fn hangs_failures_and_truncated_or_repeated_frames_cost_only_their_shots() {
    use FaultKind::*;
    // Calls 1.. of the camera; a repeated shot is a call too.
    let script = vec![
        fault(2, Hang),
        fault(3, Busy),
        fault(5, Truncated),
        fault(7, Stale),
        fault(9, Gone),
        fault(11, Panic),
        fault(13, Timeout),
        fault(14, Refused),
    ];
    let flight = Flight::new(script);
    let status = flight.run_flight();
    let report = flight.verify_store();
    let manifests = flight.manifests();
    assert!(
        manifests
            .iter()
            .all(|m| m.state == SeriesState::Complete && m.shots.len() == 4)
    );
    // Series 1: call 1 succeeds; 2 hangs; 3 busy, 4 succeeds; 5 truncated, 6 succeeds.
    assert_eq!(kinds(&manifests[0], 2), ["timeout"]);
    assert!(
        manifests[0].shots[1].frame.is_none(),
        "a hung camera costs its shot"
    );
    assert_eq!(kinds(&manifests[0], 3), ["busy"]);
    assert_eq!(kinds(&manifests[0], 4), ["bad_frame"]);
    assert!(manifests[0].shots[2].frame.is_some() && manifests[0].shots[3].frame.is_some());
    // Series 2: 7 repeats, 8 succeeds; 9 gone, 10 succeeds; 11 panics, 12 succeeds; 13 times out.
    assert_eq!(kinds(&manifests[1], 1), ["stale"]);
    assert_eq!(kinds(&manifests[1], 2), ["gone"]);
    assert_eq!(kinds(&manifests[1], 3), ["gone"]);
    assert_eq!(kinds(&manifests[1], 4), ["timeout"]);
    // Series 3: 14 refused, the others succeed.
    assert_eq!(kinds(&manifests[2], 1), ["refused"]);
    assert_eq!(status.counts.frames, 9);
    assert_eq!(status.counts.failed_shots, 3);
    assert_eq!((status.counts.hangs, status.counts.stale_frames), (1, 1));
    assert_eq!(report.results, 9);
    let kept = manifests[0].shots[3].failures[0].kept_as.as_ref().unwrap();
    assert!(
        flight.root().join("partial").join(kept).is_file(),
        "the half frame is kept"
    );
    assert_eq!(
        manifests[1].shots[0].failures[0].kept_as, None,
        "an old frame is stored already"
    );
}

#[test]
fn of_a_shot_whose_frames_are_all_truncated_one_is_kept() {
    let flight = Flight::new(
        (1..=200)
            .map(|shot| fault(shot, FaultKind::Truncated))
            .collect(),
    );
    flight.run_flight();
    flight.verify_store();
    let manifests = flight.manifests();
    let shots: Vec<_> = manifests.iter().flat_map(|m| &m.shots).collect();
    assert!(
        shots
            .iter()
            .all(|shot| shot.failures.len() > 1 && shot.failures[0].kept_as.is_some())
    );
    let kept = std::fs::read_dir(flight.root().join("partial")).unwrap();
    assert_eq!(kept.count(), shots.len());
}

#[test]
fn a_camera_that_always_hangs_does_not_stop_the_daemon() {
    let flight = Flight::new((1..=200).map(|shot| fault(shot, FaultKind::Hang)).collect());
    let status = flight.run_flight();
    flight.verify_store();
    assert_eq!(flight.manifests().len(), 3);
    assert_eq!((status.counts.frames, status.counts.failed_shots), (0, 12));
    assert_eq!(status.health, Health::Failed);
    assert!(
        status.camera.hanging_calls <= 8,
        "{}",
        status.camera.hanging_calls
    );
}

#[test]
fn a_missing_camera_is_recorded() {
    let mut flight = Flight::new(Vec::new());
    flight.replay = ReplayConfig::from_folder("/nonexistent");
    let status = flight.run_flight();
    flight.verify_store();
    assert_eq!(status.counts.failed_shots, 12);
    let shot = &flight.manifests()[0].shots[0];
    assert!(
        shot.failures[0].reason.contains("/nonexistent"),
        "{:?}",
        shot.failures
    );
}

#[test]
fn capturing_never_waits_for_solving() {
    let mut flight = Flight::new(Vec::new());
    let events = flight.events.clone();
    let solved_before_the_end = Arc::new(AtomicUsize::new(0));
    let count = solved_before_the_end.clone();
    flight.solve = Arc::new(move |image| {
        let closed = |event: &&Event| matches!(event, Event::SeriesClosed { .. });
        // The first solution takes until all series are taken.
        for _ in 0..2000 {
            if events.lock().unwrap().iter().filter(closed).count() == 3 {
                return record(image);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        count.fetch_add(1, Ordering::Relaxed);
        record(image)
    });
    let status = flight.run_flight();
    assert_eq!(
        solved_before_the_end.load(Ordering::Relaxed),
        0,
        "capturing waited"
    );
    assert_eq!(status.counts.solved, 12);
}

#[test]
fn a_solver_that_panics_gives_a_failed_result_once() {
    let mut flight = Flight::new(Vec::new());
    flight.solve = Arc::new(|image| {
        if image == "0002.jpg" {
            panic!("on this frame")
        } else {
            record(image)
        }
    });
    let status = flight.run_flight();
    assert_eq!((status.counts.solved, status.counts.unsolvable), (9, 3));
    assert_eq!(flight.verify_store().results, 12);
    flight.clock.sleep(Duration::from_secs(600));
    flight.run_flight();
    assert_eq!(flight.verify_store().results, 12, "nothing is solved twice");
}

#[test]
fn a_solver_that_never_returns_costs_its_frame_only() {
    let mut flight = Flight::new(Vec::new());
    flight.solver_deadline = Duration::from_millis(300);
    let calls = Arc::new(AtomicUsize::new(0));
    flight.solve = Arc::new(move |image| {
        if calls.fetch_add(1, Ordering::Relaxed) == 1 {
            std::thread::sleep(Duration::from_secs(3600));
        }
        record(image)
    });
    let status = flight.run_flight();
    assert_eq!(
        (
            status.counts.frames,
            status.counts.solved,
            status.counts.unsolvable
        ),
        (12, 11, 1)
    );
    assert_eq!(status.counts.solver_hangs, 1);
    assert_eq!(flight.verify_store().results, 12);
    let results = flight.root().join("flights/f0001/s000001/results.jsonl");
    assert!(
        std::fs::read_to_string(results)
            .unwrap()
            .contains("no result after 300ms")
    );
}

#[test]
fn solvers_that_all_hang_end_the_solving_and_not_the_recording() {
    let mut flight = Flight::new(Vec::new());
    flight.solver_deadline = Duration::from_millis(200);
    flight.solve = Arc::new(|image| {
        std::thread::sleep(Duration::from_secs(3600));
        record(image)
    });
    let status = flight.run_flight();
    assert_eq!((status.counts.frames, status.counts.solver_hangs), (12, 2));
    assert!(status.last_fault.unwrap().what.contains("solvers hang"));
    flight.verify_store();
}

#[test]
fn a_restart_during_the_flight_continues_the_timetable() {
    let mut flight = Flight::new(Vec::new());
    flight.series.until = Some(Duration::from_secs(3600));
    flight.run_flight();
    assert_eq!(flight.manifests().len(), 2);
    flight.series.until = Some(Duration::from_secs(3 * 3600));
    let status = flight.run_flight();
    let started: Vec<f64> = flight
        .manifests()
        .iter()
        .map(|m| m.started.as_ref().unwrap().since_boot_s)
        .collect();
    assert_eq!(started, [30.0, 3630.0, 7230.0, 10830.0]);
    assert_eq!(status.flight.as_deref(), Some("f0001"));
    flight.verify_store();
}

#[test]
fn frames_left_on_the_cameras_card_are_fetched_once() {
    let flight = Flight::new(Vec::new());
    let picture = |name: &str| std::fs::read(flight.dir.path().join("frames").join(name)).unwrap();
    *flight.card.lock().unwrap() = vec![picture("f38.jpg"), picture("f39.jpg")];
    flight.run_flight();
    let manifests = flight.manifests();
    assert_eq!(manifests.len(), 4);
    assert_eq!(
        (manifests[0].cause, manifests[0].shots.len()),
        (SeriesCause::Recovered, 2)
    );
    assert!(
        flight.card.lock().unwrap().is_empty(),
        "deleted on the camera once durable"
    );
    assert_eq!(flight.verify_store().results, 14);
    // Stored, but the power failed before it was deleted on the card.
    *flight.card.lock().unwrap() = vec![picture("f39.jpg")];
    flight.clock.sleep(Duration::from_secs(1));
    let mut flight = flight;
    flight.series.until = Some(Duration::from_secs(4 * 3600));
    flight.run_flight();
    assert!(flight.card.lock().unwrap().is_empty());
    assert!(
        flight
            .manifests()
            .iter()
            .skip(4)
            .all(|m| m.cause == SeriesCause::Scheduled)
    );
}

#[test]
fn a_frame_that_crashes_the_program_is_given_up() {
    let flight = Flight::new(Vec::new());
    let mut config = StoreConfig::new(flight.root());
    config.reserve_mb = 0;
    // A recorded flight, and five starts that ended while its first frame was solved.
    flight.run_flight();
    for path in ["s000001", "s000002", "s000003"] {
        std::fs::remove_file(
            flight
                .root()
                .join("flights/f0001")
                .join(path)
                .join("results.jsonl"),
        )
        .unwrap();
    }
    let inputs = Inputs::new(Map::from_iter([(
        "installation".to_owned(),
        Value::from("test"),
    )]));
    for beginning in 1..=5 {
        let (store, _) = Store::open(Arc::new(RealDisk), config.clone()).unwrap();
        let first = store.unsolved_frames(&inputs).unwrap().remove(0);
        assert_eq!(store.begin_solving(&first, &inputs).unwrap(), beginning);
    }
    let status = flight.run_flight();
    assert_eq!((status.counts.solved, status.counts.unsolvable), (11, 1));
}
