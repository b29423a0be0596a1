//! The daemon's threads begin together and end within a stated time.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::capture::Capture;
use super::command::Command;
use super::config::SeriesConfig;
use super::core::Core;
use super::event::Observer;
use super::live::{self, LiveConfig};
use super::power::{self, PowerConfig};
use super::processing::Processing;
use super::recorder::Recorder;
use super::shutdown::Halt;
use super::socket::{self, StatusConfig};
use super::solver::Solver;
use super::status::{Status, StatusBoard};
use super::watchdog::Pulse;
use super::{aircraft, endpoint, frame_storage};
use crate::camera::CameraFactory;
use crate::clock::Clock;
use crate::store::{Recovery, Store};

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
pub fn run(parts: Parts, board: &StatusBoard) -> Result<Status, DaemonError> {
    frame_storage::log_recovery(&parts.recovery);
    board.update(|status| {
        status.store.path = parts.store.root().display().to_string();
        status.store.reserve_mb = parts.store.reserve_mb();
        status.store.free_mb = parts.store.free_mb().ok();
        status.flight = parts.store.current_flight();
        status.shots_per_series = parts.series.shots;
    });
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let core = Core {
        store: parts.store,
        clock: parts.clock,
        board: board.clone(),
        halt: Halt::default(),
        observer: parts.observer,
    };
    let (commands, inbox) = channel();
    let (wake, woken) = channel();
    let feed = parts.live.aircraft_data.as_ref().map(|config| aircraft::listen(&core, config));
    let track = parts.solver.as_ref().and_then(|solver| solver.track.clone());
    let source = parts.solver.as_ref().map(|solver| solver.inputs.provenance.clone()).unwrap_or_default();
    let (feeder, live, tap) = live::start(&core, &parts.live, track, source)
        .map_or((None, None, None), |(feeder, live, tap)| (Some(feeder), Some(live), Some(tap)));
    let processing = parts.solver.map(|solver| Processing::new(&core, solver, parts.live.on()));
    power::watch(&core, &parts.power, commands.clone());
    let recorder = Recorder {
        core: core.clone(),
        capture: Capture::new(parts.cameras, &parts.series, &core),
        noted: 0,
        config: parts.series,
        inbox,
        wake,
        triggered: false,
        live: feeder,
    };
    let stop_within = parts.power.stop_within;
    let (done, finished) = tokio::sync::oneshot::channel();
    let threads = Core::spawn("wingd", move || {
        let result = work(recorder, processing, woken);
        let _ = done.send(());
        result
    })?;
    let stopped = runtime.block_on(attend((parts.status, tap), &core, commands, stop_within, finished));
    // The timetable may be over without anybody having asked for the end.
    core.halt.end(stop_within);
    drop((feed, live));
    runtime.shutdown_background();
    if !stopped {
        return Err(DaemonError::Late { within_s: stop_within.as_secs_f64() });
    }
    join(threads, "main")??;
    Ok(board.snapshot())
}

/// The recorder and the processing, until both have ended.
fn work(recorder: Recorder, processing: Option<Processing>, woken: Receiver<()>) -> Result<(), DaemonError> {
    let solving = processing.map(|processing| Core::spawn("processing", move || processing.run(&woken)));
    let solving = solving.transpose()?;
    let capturing = Core::spawn("recorder", move || recorder.run())?;
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
    core: &Core,
    commands: Sender<Command>,
    within: Duration,
    mut finished: tokio::sync::oneshot::Receiver<()>,
) -> bool {
    let mut in_time = true;
    if let Some(config) = &socket {
        match endpoint::listen(&config.socket) {
            Ok(listener) => {
                tokio::spawn(socket::serve(listener, core.board.clone(), commands.clone()));
            }
            Err(error) => {
                // Recording matters more than the word of it.
                tracing::error!(socket = %config.socket.display(), %error, "no status socket");
                core.board.fault(&format!("{}: {error}", config.socket.display()));
            }
        }
    }
    if let Some(tap) = tap {
        tokio::spawn(tap.serve());
    }
    tokio::spawn(notify_service_manager(core.board.clone()));
    tokio::select! {
        _ = &mut finished => {}
        () = stop_signal() => {
            tracing::info!(within_s = within.as_secs_f64(), "stopping: the shot under way is finished or given up");
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Stopping]);
            core.halt.end(within);
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
async fn notify_service_manager(board: StatusBoard) {
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
