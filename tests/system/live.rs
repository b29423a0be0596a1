//! Promise: live results are computed, published and durable within seconds, for any behaviour of listeners, solver and disk.

use crate::common::store_reading::read_live;
use std::io::{BufRead, BufReader};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Map, Value, json};
use wingd::camera::Camera;
use wingd::camera::replay::{ReplayCamera, ReplayConfig, ReplayFactory};
use wingd::clock::{Clock, SystemClock};
use wingd::daemon::{
    self, DaemonParts, DaemonStatus, LiveConfig, LiveStatus, SeriesConfig, Solver, StatusBoard,
    StatusConfig,
};
use wingd::daemon::{FrameTracker, live::KeepConfig};
use wingd::measure::view::SearchMode;
use wingd::pipeline::live::TrackedFrame;
use wingd::record::ImageRecord;
use wingd::store::disk::Disk;
use wingd::store::manifest::{SeriesCause, SeriesManifest, SeriesState};
use wingd::store::verify::verify_path;
use wingd::store::{Inputs, RealDisk, Store, StoreConfig, catalogue};

/// Long enough that a few dozen lines exceed the buffer of a socket.
const REMARK: usize = 30_000;

fn record(image: &str) -> ImageRecord {
    serde_json::from_value(json!({
        "image": image, "status": "ok", "method": "spatial", "variance_factor": 1.0, "redundancy": 3,
        "global_test": "passed", "sigma_kind": "prior", "model": {},
        "tip": {"marker": "M2", "deflection_m": 2.5, "sigma_deflection_m": 0.01}, "markers": [],
        "torsion": [{"name": "tip", "angle_deg": 1.0, "sigma_deg": 0.1, "twist_deg": null, "sigma_twist_deg": null}],
        "curve": [{"arc_length_m": 1.0, "span_m": 1.0, "deflection_m": 0.5, "sigma_deflection_m": 0.01, "twist_deg": 0.5,
            "sigma_twist_deg": 0.1}],
        "remarks": ["x".repeat(REMARK)], "timing_ms": {}
    }))
    .unwrap()
}

fn tracked_frame(image: &str) -> TrackedFrame {
    let (search, outlines) = (SearchMode::Guided, vec![]);
    TrackedFrame {
        record: record(image),
        search,
        mounting: 1,
        mount_disturbed: false,
        outlines,
        curvature: None,
    }
}

/// Live mode for some seconds with series in between, in real time.
pub struct LiveRun {
    dir: tempfile::TempDir,
    live: LiveConfig,
    reserve_mb: u64,
    pub seconds: f64,
    /// Calls of the solver that panic.
    panics: Vec<usize>,
    pub disk: Arc<dyn Disk>,
    /// Makes the camera from one that replays the frames.
    pub camera: Arc<dyn Fn(ReplayCamera) -> Box<dyn Camera> + Send + Sync>,
}

impl LiveRun {
    pub fn new(rate_hz: f64) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("frames");
        std::fs::create_dir(&folder).unwrap();
        for i in 0..50_u8 {
            let grey: Vec<u8> = (0..32 * 32)
                .map(|k| (k * (i as usize + 3) % 251) as u8)
                .collect();
            let mut bytes = Vec::new();
            let encoder = jpeg_encoder::Encoder::new(&mut bytes, 90);
            encoder
                .encode(&grey, 32, 32, jpeg_encoder::ColorType::Luma)
                .unwrap();
            std::fs::write(folder.join(format!("f{i:02}.jpg")), bytes).unwrap();
        }
        let live = LiveConfig {
            rate_hz: Some(rate_hz),
            socket: Some(dir.path().join("live.sock")),
            ..LiveConfig::default()
        };
        Self {
            dir,
            live,
            reserve_mb: 0,
            seconds: 2.2,
            panics: vec![],
            disk: Arc::new(RealDisk),
            camera: Arc::new(|replay| Box::new(replay)),
        }
    }

    pub fn root(&self) -> PathBuf {
        self.dir.path().join("store")
    }

    pub fn run_flight(&self) -> DaemonStatus {
        let mut config = StoreConfig::new(self.root());
        config.reserve_mb = self.reserve_mb;
        let (store, recovery) = Store::open(self.disk.clone(), config).unwrap();
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        let replay = ReplayConfig::from_folder(self.dir.path().join("frames"));
        let cameras = ReplayFactory::new(replay, clock.clone(), clock.since_boot());
        let board = StatusBoard::new(clock.clone());
        let mut provenance = Map::new();
        provenance.insert("installation".to_owned(), Value::from("test"));
        let (calls, panics) = (Arc::new(AtomicUsize::new(0)), self.panics.clone());
        let track = move || {
            let (calls, panics) = (calls.clone(), panics.clone());
            let track: FrameTracker = Box::new(move |image, _, _, _| {
                let call = calls.fetch_add(1, Ordering::Relaxed) + 1;
                assert!(!panics.contains(&call), "as the test asks");
                tracked_frame(image)
            });
            Ok(track)
        };
        let parts = DaemonParts {
            live: self.live.clone(),
            series: SeriesConfig {
                interval: Duration::from_secs(1),
                shots: 2,
                gap: Duration::from_millis(10),
                until: Some(Duration::from_secs_f64(self.seconds)),
                ..SeriesConfig::default()
            },
            power: daemon::PowerConfig::default(),
            status: Some(StatusConfig {
                socket: self.dir.path().join("wingd.sock"),
            }),
            store: Arc::new(store),
            recovery,
            clock,
            cameras: Arc::new({
                let camera = self.camera.clone();
                move || camera(cameras.make())
            }),
            solver: Some(
                Solver {
                    inputs: Inputs::new(provenance),
                    solve: Arc::new(|image, _, _| record(image)),
                    deadline: Duration::from_secs(60),
                    track: Some(Arc::new(track)),
                }
                .into_source(),
            ),
            observer: Arc::new(|_| ()),
        };
        daemon::run(parts, &board).unwrap();
        board.snapshot()
    }

    /// Lines from the socket, from its creation to its end.
    pub fn listener(&self) -> std::thread::JoinHandle<Vec<String>> {
        let path = self.dir.path().join("live.sock");
        std::thread::spawn(move || {
            let lines = BufReader::new(connected(&path)).lines();
            lines.map_while(Result::ok).collect()
        })
    }
}

fn connected(path: &Path) -> UnixStream {
    let end = Instant::now() + Duration::from_secs(30);
    loop {
        match UnixStream::connect(path) {
            Ok(stream) => return stream,
            Err(_) if Instant::now() < end => std::thread::sleep(Duration::from_millis(5)),
            Err(error) => panic!("{}: {error}", path.display()),
        }
    }
}

/// Numbers of the frames with stored results.
fn stored(root: &Path) -> Vec<f64> {
    let mut numbers = vec![];
    for flight in catalogue::list_flights(&RealDisk, root).unwrap() {
        for (head, rows) in read_live(&RealDisk, root, &flight).unwrap().0 {
            let columns = head.table.columns.iter();
            let before = columns.take_while(|column| column.name != "number");
            let at: usize = before.map(|column| column.width).sum();
            numbers.extend(rows.iter().map(|row| row[at]));
        }
    }
    numbers
}

fn series(root: &Path) -> Vec<SeriesManifest> {
    let flights = catalogue::list_flights(&RealDisk, root).unwrap();
    let all = flights
        .iter()
        .flat_map(|flight| catalogue::list_series(&RealDisk, flight).unwrap());
    all.map(|series| catalogue::read_series_manifest(&RealDisk, &series).unwrap())
        .collect()
}

fn assert_sound(root: &Path) {
    let report = verify_path(&RealDisk, root);
    assert!(report.is_sound(), "{:#?}", report.faults);
}

fn live_status(status: &DaemonStatus) -> &LiveStatus {
    status.live.as_ref().unwrap()
}

#[test]
fn a_listener_that_hangs_loses_lines_and_stops_nothing() {
    let mut ride = LiveRun::new(60.0);
    let udp = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    udp.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    ride.live.udp = Some(udp.local_addr().unwrap().to_string());
    let path = ride.dir.path().join("live.sock");
    let hanging = std::thread::spawn(move || connected(&path));
    let good = ride.listener();
    let status = ride.run_flight();
    let live = live_status(&status);
    let lines = good.join().unwrap();
    drop(hanging.join().unwrap());
    assert!(live.results > 60 && live.unsolvable == 0, "{live:?}");
    assert!(live.lines_lost > 0, "{live:?}");
    assert!(
        lines.len() as u64 + 40 > live.results,
        "{} of {}",
        lines.len(),
        live.results
    );
    let first: Value = serde_json::from_str(&lines[0]).unwrap();
    assert_eq!(
        (&first["status"], &first["search"], &first["mounting"]),
        (&json!("ok"), &json!("guided"), &json!(1))
    );
    assert!(
        first["latency_ms"].as_f64().unwrap() >= 0.0 && first["exposure_time"].is_string(),
        "{first}"
    );
    let mut datagram = [0; 2000];
    // The results' datagrams are interleaved with those of the state.
    let (text, length) = std::iter::from_fn(|| {
        let length = udp.recv(&mut datagram).ok()?;
        Some((
            String::from_utf8_lossy(&datagram[..length]).into_owned(),
            length,
        ))
    })
    .find(|(text, _)| !text.starts_with("WINGDH,"))
    .unwrap();
    let fields: Vec<&str> = text.trim_end().split(',').collect();
    assert_eq!(
        (fields[0], fields[4], fields[10], fields.len()),
        ("WINGD1", "1", "2.5000", 50),
        "{text}"
    );
    assert!(text.ends_with("\r\n") && length < 1400);
    let numbers = stored(&ride.root());
    assert_eq!(
        numbers.len() as u64,
        live.results,
        "every result is durable"
    );
    assert_eq!((live.stored, live.dropped), (live.results, 0));
    assert!(numbers.windows(2).all(|pair| pair[0] < pair[1]));
    assert_eq!(
        numbers.last().copied().unwrap_or_default() as u64,
        live.results + live.skipped
    );
    let complete = series(&ride.root())
        .iter()
        .filter(|s| s.state == SeriesState::Complete)
        .count();
    assert_eq!(
        (complete, status.counts.series_complete),
        (3, 3),
        "the timetable's series are complete"
    );
    assert_sound(&ride.root());
}

#[test]
fn a_frame_that_breaks_the_solver_costs_one_result() {
    let mut ride = LiveRun::new(20.0);
    ride.panics = vec![5, 11];
    let lines = ride.listener();
    let status = ride.run_flight();
    let live = live_status(&status);
    assert!(live.results > 15 && live.unsolvable == 2, "{live:?}");
    let broken: Vec<String> = lines
        .join()
        .unwrap()
        .into_iter()
        .filter(|l| l.contains("crashed"))
        .collect();
    assert_eq!(broken.len(), 2);
    assert_eq!(stored(&ride.root()).len() as u64, live.results);
    assert_eq!(live.fault, None, "the next frame is solved again");
    assert_sound(&ride.root());
}

#[test]
fn a_full_disk_is_reported_and_results_continue() {
    let mut ride = LiveRun::new(20.0);
    ride.reserve_mb = u64::MAX / 2;
    let lines = ride.listener();
    let status = ride.run_flight();
    let live = live_status(&status);
    assert_eq!((live.stored, status.counts.series_refused), (0, 3));
    let fault = live.fault.clone().unwrap_or_default();
    assert!(
        fault.contains("live results cannot be stored") && fault.contains("reserve"),
        "{fault}"
    );
    assert!(
        live.results > 15 && lines.join().unwrap().len() > 10,
        "{live:?}"
    );
    assert_sound(&ride.root());
}

#[test]
fn repeated_frames_are_reported_once() {
    let mut ride = LiveRun::new(20.0);
    ride.live.series = false;
    for i in 1..50 {
        let frames = ride.dir.path().join("frames");
        std::fs::copy(frames.join("f00.jpg"), frames.join(format!("f{i:02}.jpg"))).unwrap();
    }
    let status = ride.run_flight();
    let live = live_status(&status);
    let fault = live.fault.clone().unwrap_or_default();
    assert!(
        fault.starts_with("no live frame: camera delivered a bad frame: it is the same"),
        "{live:?}"
    );
    assert!(live.failed_shots > 0 && live.results == 1, "{live:?}");
    assert_sound(&ride.root());
}

#[test]
fn raw_frames_are_kept_by_number_and_around_an_event() {
    let mut ride = LiveRun::new(20.0);
    let second = Duration::from_secs(1);
    ride.live.keep = KeepConfig {
        every: 10,
        before: second,
        after: second / 2,
        ..KeepConfig::default()
    };
    let socket = ride.dir.path().join("wingd.sock");
    let asking = std::thread::spawn(move || {
        drop(connected(&socket));
        std::thread::sleep(Duration::from_millis(1200));
        daemon::query_daemon(&socket, "trigger").unwrap()
    });
    let status = ride.run_flight();
    asking.join().unwrap();
    let live = live_status(&status);
    let all = series(&ride.root());
    let event: Vec<_> = all
        .iter()
        .filter(|s| s.cause == SeriesCause::Event)
        .collect();
    assert_eq!((event.len(), live.events), (1, 1));
    assert!(
        event[0].remarks.iter().any(|r| r.contains("wingd trigger")),
        "{:?}",
        event[0].remarks
    );
    let times: Vec<f64> = event[0]
        .shots
        .iter()
        .map(|s| s.exposure.as_ref().unwrap().exposure_since_boot_s)
        .collect();
    assert!(
        times.len() > 10 && times.windows(2).all(|pair| pair[0] < pair[1]),
        "{times:?}"
    );
    assert!(times[times.len() - 1] - times[0] < 1.6 + 0.1, "{times:?}");
    let nth: usize = all
        .iter()
        .filter(|s| s.cause == SeriesCause::Live)
        .map(|s| s.shots.len())
        .sum();
    assert_eq!(nth as u64, live.frames / 10);
    assert_eq!(
        (live.kept_frames as usize, live.lost_frames),
        (nth + times.len(), 0)
    );
    assert_eq!(
        all.iter()
            .filter(|s| s.cause == SeriesCause::Triggered)
            .count(),
        1,
        "and an extra series"
    );
    assert!(
        all.iter()
            .all(|s| s.state == SeriesState::Complete && s.camera["name"] == "replay")
    );
    assert_sound(&ride.root());
}

#[test]
fn a_kill_costs_seconds_of_results_and_no_series() {
    let dir = tempfile::tempdir().unwrap();
    let config = crate::kill9::configuration(dir.path());
    let text = std::fs::read_to_string(&config)
        .unwrap()
        .replace("400ms", "1h");
    std::fs::write(
        &config,
        text + "[live]\nrate_hz = 5\nsocket = \"live.sock\"\n",
    )
    .unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_wingd"));
    let mut child = command
        .args(["run", "--config"])
        .arg(&config)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let lines = BufReader::new(connected(&dir.path().join("live.sock"))).lines();
    // Arrival time of each result.
    let mut came = vec![];
    for line in lines.map_while(Result::ok) {
        let result: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(result["status"], "ok", "{}", result["reason"]);
        came.push((result["number"].as_f64().unwrap(), Instant::now()));
        if came[0].1.elapsed() > Duration::from_secs(6) {
            break;
        }
    }
    child.kill().unwrap();
    let killed = Instant::now();
    child.wait().unwrap();
    let root = dir.path().join("store");
    assert_sound(&root);
    // The next start moves the file into its flight.
    let mut store = StoreConfig::new(&root);
    store.reserve_mb = 0;
    drop(Store::open(Arc::new(RealDisk), store).unwrap());
    assert_sound(&root);
    let numbers = stored(&root);
    let lost = came.iter().filter(|(number, _)| !numbers.contains(number));
    let oldest = lost
        .map(|(_, when)| killed.duration_since(*when))
        .max()
        .unwrap_or_default();
    assert!(
        !numbers.is_empty() && oldest < Duration::from_secs(5),
        "{oldest:?} of results are lost"
    );
    let scheduled: Vec<_> = series(&root)
        .into_iter()
        .filter(|s| s.cause == SeriesCause::Scheduled)
        .collect();
    assert!(
        scheduled
            .iter()
            .all(|s| s.state == SeriesState::Complete && s.shots.len() == 3)
    );
    assert_eq!(scheduled.len(), 1);
}
