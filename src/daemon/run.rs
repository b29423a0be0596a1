//! Starts the daemon's threads and ends them within the configured time.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::signal::unix::{SignalKind, signal};

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
use super::solver::{CurrentSolver, SolverSource};
use super::status::{DaemonStatus, RESULTS_PART, StatusBoard};
use super::watchdog::ProgressCheck;
use super::{aircraft, frame_storage};
use crate::camera::CameraFactory;
use wingd_base::clock::Clock;
use wingd_store::{Recovery, Store};

/// Maximum number of threads for work that blocks the event loop: host names and previews.
const MAX_BLOCKING: usize = 4;

/// Parts from which the daemon is assembled.
pub struct DaemonParts {
    pub series: SeriesConfig,
    pub power: PowerConfig,
    pub live: LiveConfig,
    /// `[status]`; without it no socket is opened.
    pub status: Option<StatusConfig>,
    /// Store, open for writing.
    pub store: Arc<Store>,
    /// Outcome of opening the store, to be logged.
    pub recovery: Recovery,
    /// Clock of the schedule and of the time stamps.
    pub clock: Arc<dyn Clock>,
    /// Factory of cameras.
    pub cameras: CameraFactory,
    /// Source of the solver; without it frames are only recorded.
    pub solver: Option<SolverSource>,
    /// Receiver of progress events.
    pub observer: Observer,
}

/// Error that ends the daemon.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// A thread or the event loop could not be created.
    #[error("the daemon cannot start: {0}; free memory or raise the thread limit")]
    Machine(#[from] std::io::Error),
    /// A thread panicked.
    #[error(
        "the {0} thread crashed; stored data are safe; restart wingd and report this to the developers"
    )]
    Broken(&'static str),
    /// The threads did not end in time.
    #[error(
        "the daemon did not stop within {within_s} s; stored data are safe, and an open series is recovered at the next start"
    )]
    StopTimeout {
        /// Limit, s.
        within_s: f64,
    },
}

/// Runs until the timetable is over (the remaining frames are then solved) or until a signal to end. On a signal, the
/// current shot and frame are finished or abandoned and the series is closed, all within `[power] stop_within`.
pub fn run(parts: DaemonParts, board: &StatusBoard) -> Result<DaemonStatus, DaemonError> {
    frame_storage::log_recovery(&parts.recovery);
    board.update(|status| {
        status.store.path = parts.store.root().display().to_string();
        status.store.reserve_mb = parts.store.reserve_mb();
        status.store.free_mb = parts.store.free_mb().ok();
        status.flight = parts.store.current_flight();
        status.shots_per_series = parts.series.shots;
    });
    let runtime = tokio::runtime::Builder::new_current_thread()
        .max_blocking_threads(MAX_BLOCKING)
        .enable_all()
        .build()?;
    let core = Core {
        store: parts.store,
        clock: parts.clock,
        board: board.clone(),
        halt: Halt::default(),
        observer: parts.observer,
    };
    let (commands, inbox) = channel();
    let (wake, woken) = channel();
    let feed = parts
        .live
        .aircraft_data
        .as_ref()
        .map(|config| aircraft::start_feed(&core, config));
    let solver = CurrentSolver::default();
    let processing = parts
        .solver
        .map(|source| Processing::start(&core, source, solver.clone(), parts.live.is_enabled()));
    let (feeder, live, publisher) = live::start_live(&core, &parts.live, solver)
        .map_or((None, None, None), |(feeder, live, publisher)| {
            (Some(feeder), Some(live), Some(publisher))
        });
    power::watch_supply(&core, &parts.power, commands.clone());
    let recorder = Recorder {
        core: core.clone(),
        capture: Capture::new(parts.cameras, &parts.series, &core),
        noted_opening: 0,
        config: parts.series,
        inbox,
        wake,
        triggered: false,
        live: feeder,
    };
    let stop_within = parts.power.stop_within;
    let (done, finished) = tokio::sync::oneshot::channel();
    let threads = Core::spawn_thread("wingd", move || {
        let result = run_threads(recorder, processing, woken);
        let _ = done.send(());
        result
    })?;
    let stopped = runtime.block_on(serve_until_done(
        (parts.status, publisher),
        &core,
        commands,
        stop_within,
        finished,
    ));
    // The timetable may be over without a stop request.
    core.halt.end(stop_within);
    drop((feed, live));
    runtime.shutdown_background();
    if !stopped {
        return Err(DaemonError::StopTimeout {
            within_s: stop_within.as_secs_f64(),
        });
    }
    join_thread(threads, "main")??;
    Ok(board.snapshot())
}

/// Runs the recorder and the processing until both have ended.
fn run_threads(
    recorder: Recorder,
    processing: Option<Processing>,
    woken: Receiver<()>,
) -> Result<(), DaemonError> {
    let board = recorder.core.board.clone();
    let report = {
        let board = board.clone();
        move |what: String| {
            board.set_fault(
                RESULTS_PART,
                Some(format!(
                    "frames are recorded but not solved: {what}; restart wingd"
                )),
            );
            board.beat_processing(false);
        }
    };
    // Frames can be solved later: only the end of the recorder ends the daemon.
    let solving = processing.map(|processing| {
        Core::spawn_thread("processing", {
            let report = report.clone();
            move || {
                if catch_unwind(AssertUnwindSafe(|| processing.run(&woken))).is_err() {
                    report("the processing crashed".to_owned());
                }
            }
        })
    });
    let solving = solving
        .transpose()
        .map_err(|error| report(error.to_string()))
        .ok()
        .flatten();
    let capturing = Core::spawn_thread("recorder", move || recorder.run())?;
    let captured = join_thread(capturing, "recorder");
    solving
        .map_or(Ok(()), |thread| join_thread(thread, "processing"))
        .and(captured)
}

fn join_thread<T>(thread: JoinHandle<T>, name: &'static str) -> Result<T, DaemonError> {
    thread.join().map_err(|_| DaemonError::Broken(name))
}

/// Serves signals, the socket and the service manager. Returns true when the work is done, false if the time for stopping
/// has passed.
async fn serve_until_done(
    (socket, publisher): (Option<StatusConfig>, Option<live::ResultPublisher>),
    core: &Core,
    commands: Sender<Command>,
    within: Duration,
    mut finished: tokio::sync::oneshot::Receiver<()>,
) -> bool {
    let mut in_time = true;
    let status = socket.map(|config| {
        tokio::spawn(socket::serve_status(
            config,
            core.board.clone(),
            commands.clone(),
        ))
    });
    if let Some(publisher) = publisher {
        tokio::spawn(publisher.serve());
    }
    tokio::spawn(notify_service_manager(core.board.clone()));
    tokio::select! {
        _ = &mut finished => {}
        () = wait_for_stop_signal() => {
            tracing::info!(within_s = within.as_secs_f64(), "stopping: the current shot is finished or abandoned");
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Stopping]);
            core.halt.end(within);
            let _ = commands.send(Command::HaltChanged);
            in_time = tokio::time::timeout(within, finished).await.is_ok();
        }
    }
    if let Some(status) = status {
        // Its socket is removed now, not after the last data are stored.
        status.abort();
        let _ = status.await;
    }
    in_time
}

/// Waits for a signal that would end the process; one that is ignored from the start (`nohup`) stays ignored.
async fn wait_for_stop_signal() {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    let mut signals = tokio::task::JoinSet::new();
    for kind in [
        SignalKind::terminate(),
        SignalKind::interrupt(),
        SignalKind::hangup(),
        SignalKind::user_defined1(),
        SignalKind::user_defined2(),
    ] {
        let is_ignored = ignored.unwrap_or(0) >> (kind.as_raw_value() - 1) & 1 == 1;
        if let (false, Ok(mut stream)) = (is_ignored, signal(kind)) {
            signals.spawn(async move { stream.recv().await });
        }
    }
    if signals.join_next().await.is_none() {
        std::future::pending().await
    }
}

/// Sends READY once the threads run, and WATCHDOG while every thread that has work makes progress.
async fn notify_service_manager(board: StatusBoard) {
    let _ = sd_notify::notify(&[sd_notify::NotifyState::Ready]);
    let Some(watchdog) = sd_notify::watchdog_enabled() else {
        return;
    };
    let mut pulse = ProgressCheck::default();
    loop {
        if pulse.has_progressed(board.beats()) {
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Watchdog]);
        }
        tokio::time::sleep(watchdog / 3).await;
    }
}
