//! The recorder: schedule, capture, processing, status, shutdown.
//!
//! | thread | does | waits for |
//! |---|---|---|
//! | recorder | schedule, series, store | the clock, commands, the camera up to its hard limit |
//! | camera | the driver's calls | the hardware; given up where it does not return |
//! | processing | solves what the store says is unsolved | the end of a series, the solver up to its deadline |
//! | solver | one frame; given up where it does not return | |
//! | power | looks at the supply | |
//! | aircraft-feed, aircraft-store | the aircraft's data | the feed; the disk |
//! | live, live-solver, live-store, live-frames | frames between the series ([`live`]) | see there |
//! | main | signals, the status socket, the service manager | all of these |

pub mod aircraft;
mod capture;
mod halt;
mod judging;
pub mod live;
pub mod machine;
mod metrics;
pub mod power;
mod processing;
mod pulse;
mod recorder;
pub mod schedule;
mod socket;
mod status;

use std::sync::Arc;
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use serde::{Deserialize, Serialize};

pub use aircraft::{AircraftConfig, AircraftStatus};
pub use capture::CameraFactory;
pub use live::{LiveConfig, LiveStatus, Track, Tracking};
pub use power::PowerConfig;
pub use schedule::Align;
pub use socket::{StatusConfig, ask};
pub use status::{Activity, Board, CameraStatus, Counts, Health, Noted, Status, StoreStatus};

use crate::camera::Format;
use crate::camera::freshness::Freshness;
use crate::clock::Clock;
use crate::installation::KeyFault;
use crate::record::ImageRecord;
use crate::store::{Inputs, Recovery, Store};
use halt::Halt;
use pulse::Pulse;
use recorder::{Command, Recorder};

/// `[series]` of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SeriesConfig {
    /// From the beginning of one series to that of the next.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub interval: Duration,
    /// Per series.
    pub shots: u32,
    /// Pause between two shots.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub gap: Duration,
    /// The camera must deliver within; a quarter more and its call is given up. Machine time.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub shot_deadline: Duration,
    /// Opening the camera must be done within. Machine time.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub open_deadline: Duration,
    /// More attempts at a shot that failed.
    pub retries: u32,
    /// `start` or `clock`.
    pub align: Align,
    /// The daemon ends by itself when the next series would begin later than this after the first.
    #[serde(
        with = "jiff::fmt::serde::unsigned_duration::friendly::compact::optional",
        skip_serializing_if = "Option::is_none"
    )]
    pub until: Option<Duration>,
    /// A frame that equals one of so many before it is stale.
    pub stale_window: usize,
}

impl Default for SeriesConfig {
    fn default() -> Self {
        Self {
            interval: Duration::from_secs(3600),
            shots: 10,
            gap: Duration::from_secs(2),
            shot_deadline: Duration::from_secs(20),
            open_deadline: Duration::from_secs(30),
            retries: 2,
            align: Align::Start,
            until: None,
            stale_window: 16,
        }
    }
}

impl SeriesConfig {
    /// Every fault, at its key of the whole file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let mut faults = Vec::new();
        let mut must = |holds: bool, key: &str, problem: &str, mend: &str| {
            if !holds {
                faults.push(KeyFault::new(format!("series.{key}"), problem, mend));
            }
        };
        let positive = "must be longer than 0";
        must(!self.interval.is_zero(), "interval", positive, "for example \"1h\"");
        must((1..=9999).contains(&self.shots), "shots", "must be 1 to 9999", "correct it");
        must(!self.shot_deadline.is_zero(), "shot_deadline", positive, "for example \"20s\"");
        must(!self.open_deadline.is_zero(), "open_deadline", positive, "for example \"30s\"");
        must(self.retries <= 10, "retries", "must be at most 10", "correct it");
        let least = self.gap.saturating_mul(self.shots.saturating_sub(1));
        must(
            least < self.interval || self.interval.is_zero(),
            "interval",
            "is shorter than the series' gaps together",
            "lengthen it, or lower shots or gap",
        );
        faults
    }

    fn timetable(&self) -> schedule::Timetable {
        schedule::Timetable { interval: self.interval, align: self.align, until: self.until }
    }
}

/// File name, bytes, how to read them -> the result.
pub type Solve = Arc<dyn Fn(&str, &[u8], &Format) -> ImageRecord + Send + Sync>;

/// How frames are solved, one at a time.
#[derive(Clone)]
pub struct Solver {
    /// What the results depend on beside the frame.
    pub inputs: Inputs,
    /// Does it.
    pub solve: Solve,
    /// A frame that takes longer is given up and recorded as failed. Machine time.
    pub deadline: Duration,
    /// Solves live frames one after the other; none, and they are recorded only.
    pub track: Option<Track>,
}

/// Something that a progress display may show.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A series begins.
    SeriesBegan {
        /// Its name.
        series: String,
        /// Its flight's.
        flight: String,
    },
    /// A frame is durable.
    FrameStored {
        /// Its series.
        series: String,
        /// From 1.
        shot: u32,
        /// In the series' folder.
        file: String,
        /// Hex.
        sha256: String,
    },
    /// A shot without a frame.
    ShotFailed {
        /// Its series.
        series: String,
        /// From 1.
        shot: u32,
    },
    /// A series is in its flight's folder.
    SeriesClosed {
        /// Its name.
        series: String,
        /// Every planned shot was tried.
        complete: bool,
    },
    /// The store took no series.
    Refused {
        /// Why.
        reason: String,
    },
    /// A frame has its result.
    Solved {
        /// Its series.
        series: String,
        /// In the series' folder.
        file: String,
        /// With numbers.
        ok: bool,
    },
}

/// Called on the daemon's threads; must return soon.
pub type Observer = Arc<dyn Fn(&Event) + Send + Sync>;

/// Everything that the daemon is made of.
pub struct Parts {
    /// `[series]`.
    pub series: SeriesConfig,
    /// `[power]`.
    pub power: PowerConfig,
    /// `[live]`.
    pub live: LiveConfig,
    /// `[status]`; none, and no socket is opened.
    pub status: Option<StatusConfig>,
    /// Open for writing.
    pub store: Arc<Store>,
    /// What opening the store recovered; logged.
    pub recovery: Recovery,
    /// Of the schedule and the stamps.
    pub clock: Arc<dyn Clock>,
    /// Makes cameras.
    pub cameras: CameraFactory,
    /// None, and frames are recorded only.
    pub solver: Option<Solver>,
    /// For a progress display.
    pub observer: Observer,
}

/// Why the daemon could not work.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// The machine gave no thread or event loop.
    #[error("the daemon cannot start: {0}; free memory or raise the limit of threads")]
    Machine(#[from] std::io::Error),
    /// A fault of the program.
    #[error("the {0} thread broke off; what is stored is safe, restart wingd (and tell the developers)")]
    Broken(&'static str),
    /// Something did not let go.
    #[error(
        "not stopped in good order within {within_s} s; what is stored is safe, and a series under way is recovered at the next start"
    )]
    Late {
        /// The limit.
        within_s: f64,
    },
}

/// Runs until the timetable is over (what is left is solved then) or until SIGTERM or SIGINT: the shot and
/// the frame under way are finished or given up, the series is closed, all within `[power] stop_within`.
pub fn run(parts: Parts, board: &Board) -> Result<Status, DaemonError> {
    judging::log_recovery(&parts.recovery);
    board.update(|status| {
        status.store.path = parts.store.root().display().to_string();
        status.store.reserve_mb = parts.store.reserve_mb();
        status.store.free_mb = parts.store.free_mb().ok();
        status.flight = parts.store.current_flight();
        status.shots_per_series = parts.series.shots;
    });
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let halt = Halt::default();
    let (commands, inbox) = channel();
    let (wake, woken) = channel();
    let socket = parts.status.clone();
    let processing = parts.solver.clone().map(|solver| processing::Processing {
        store: parts.store.clone(),
        solver,
        board: board.clone(),
        observer: parts.observer.clone(),
        halt: halt.clone(),
        running: Arc::new(()),
        gives_way: parts.live.on(),
    });
    let (config, store, clock) = (&parts.live, &parts.store, &parts.clock);
    let feed =
        config.aircraft_data.as_ref().map(|config| aircraft::listen(config, store, clock, board, &halt));
    let track = parts.solver.as_ref().and_then(|solver| solver.track.clone());
    let source = parts.solver.as_ref().map(|solver| solver.inputs.provenance.clone()).unwrap_or_default();
    let around = live::Surroundings { config, store, clock, board, halt: &halt, track, source };
    let (feeder, live, tap) = match live::start(around) {
        Some((feeder, live, tap)) => (Some(feeder), Some(live), Some(tap)),
        None => (None, None, None),
    };
    let recorder = Recorder {
        camera: capture::Host::new(parts.cameras, parts.series.open_deadline, halt.clone()),
        freshness: Freshness::remembering(parts.series.stale_window),
        camera_clock_offset_s: None,
        config: parts.series,
        store: parts.store,
        clock: parts.clock,
        board: board.clone(),
        observer: parts.observer,
        inbox,
        wake,
        opened: None,
        triggered: false,
        halt: halt.clone(),
        live: feeder,
    };
    let _watch = power::watch(&parts.power, &halt, commands.clone(), board);
    let stop_within = parts.power.stop_within;
    let (done, finished) = tokio::sync::oneshot::channel();
    let threads = std::thread::Builder::new().name("wingd".to_owned()).spawn(move || {
        let result = work(recorder, processing, woken);
        let _ = done.send(());
        result
    })?;
    let stopped = runtime.block_on(attend((socket, tap), board, commands, (&halt, stop_within), finished));
    drop((feed, live));
    runtime.shutdown_background();
    if !stopped {
        return Err(DaemonError::Late { within_s: stop_within.as_secs_f64() });
    }
    join(threads, "main")??;
    Ok(board.snapshot())
}

/// The recorder and the processing, until both have ended.
fn work(
    recorder: Recorder,
    processing: Option<processing::Processing>,
    woken: std::sync::mpsc::Receiver<()>,
) -> Result<(), DaemonError> {
    let solving = match processing {
        Some(processing) => {
            let thread = std::thread::Builder::new().name("processing".to_owned());
            Some(thread.spawn(move || processing.run(&woken))?)
        }
        None => None,
    };
    let capturing = std::thread::Builder::new().name("recorder".to_owned()).spawn(move || recorder.run())?;
    let captured = join(capturing, "recorder");
    let solved = solving.map_or(Ok(()), |thread| join(thread, "processing"));
    captured.and(solved)
}

fn join<T>(thread: JoinHandle<T>, name: &'static str) -> Result<T, DaemonError> {
    thread.join().map_err(|_| DaemonError::Broken(name))
}

/// Signals, the socket and the service manager, until the work is done (true) or the time for stopping is over.
async fn attend(
    (socket, tap): (Option<StatusConfig>, Option<live::Tap>),
    board: &Board,
    commands: Sender<Command>,
    (halt, within): (&Halt, Duration),
    mut finished: tokio::sync::oneshot::Receiver<()>,
) -> bool {
    let mut in_time = true;
    if let Some(config) = &socket {
        match socket::listen(&config.socket) {
            Ok(listener) => {
                tokio::spawn(socket::serve(listener, board.clone(), commands.clone()));
            }
            Err(error) => {
                // Recording matters more than telling about it.
                tracing::error!(socket = %config.socket.display(), %error, "no status socket");
                board.fault(&format!("{}: {error}", config.socket.display()));
            }
        }
    }
    if let Some(tap) = tap {
        tokio::spawn(tap.serve());
    }
    tokio::spawn(tell_service_manager(board.clone()));
    tokio::select! {
        _ = &mut finished => {}
        () = stop_signal() => {
            tracing::info!(within_s = within.as_secs_f64(), "stopping: the shot under way is finished or given up");
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Stopping]);
            halt.end(within);
            let _ = commands.send(Command::Look);
            in_time = tokio::time::timeout(within, finished).await.is_ok();
        }
    }
    if let Some(config) = &socket {
        let _ = std::fs::remove_file(&config.socket);
    }
    in_time
}

async fn stop_signal() {
    use tokio::signal::unix::{SignalKind, signal};
    match (signal(SignalKind::terminate()), signal(SignalKind::interrupt())) {
        (Ok(mut terminate), Ok(mut interrupt)) => {
            tokio::select! { _ = terminate.recv() => {}, _ = interrupt.recv() => {} }
        }
        _ => std::future::pending().await,
    }
}

/// READY once the threads run; WATCHDOG only while all that has work makes progress.
async fn tell_service_manager(board: Board) {
    let _ = sd_notify::notify(&[sd_notify::NotifyState::Ready]);
    let Some(watchdog) = sd_notify::watchdog_enabled() else { return };
    let mut pulse = Pulse::default();
    loop {
        if pulse.moved(board.beats()) {
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Watchdog]);
        }
        tokio::time::sleep(watchdog / 3).await;
    }
}
