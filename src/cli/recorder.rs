//! Construction of the daemon's parts from a configuration, for `wingd run` and `wingd demo`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::config::{Config, SolveConfig};
use crate::daemon::{
    self, DaemonParts, DaemonStatus, FrameTrackerFactory, Observer, PAGE_PART, SOLVER_PART, Solver,
    SolverSource, StatusBoard,
};
use wingd_base::clock::Clock;
use wingd_base::failure::{Failure, TaskResult};
use wingd_base::fault::Fault;
use wingd_evaluation::inputs::stop_signal;
use wingd_evaluation::installation;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::pipeline;
use wingd_evaluation::pipeline::live::Tracker;
use wingd_measure::adjust::AdjustmentMethod;
use wingd_measure::setup::Orientation;
use wingd_pages as http;
use wingd_pages::access::Access;
use wingd_pages::section::ServeConfig;
use wingd_store::{Inputs, RealDisk, Recovery, Store};

/// An opened store and the result of its recovery.
pub struct OpenedStore {
    pub store: Arc<Store>,
    pub recovery: Recovery,
}

/// Opens the store; creates it if there is none.
pub fn open_store(config: &Config) -> TaskResult<OpenedStore> {
    let begin = Instant::now();
    let (store, recovery) = Store::open(Arc::new(RealDisk), config.store.clone())
        .map_err(|error| Failure::Failed(error.to_string()))?;
    let took_ms = begin.elapsed().as_millis() as u64;
    if let Ok(Some(signer)) = store.signer() {
        tracing::info!(key = %signer.path().display(), public = signer.public_key_hex(), "flights are signed");
    }
    tracing::info!(
        recovered = recovery.series.len(),
        set_aside = recovery.set_aside.len(),
        took_ms,
        "store is open"
    );
    Ok(OpenedStore {
        store: Arc::new(store),
        recovery,
    })
}

/// Returns the source of the solver of an installation, which is read again each time: an installation that has appeared or
/// changed is taken up as soon as two readings agree, so that no half-written one is. Errors are in the status; recording goes
/// on, and so does solving with the installation before.
fn watch_installation(
    directory: PathBuf,
    config: SolveConfig,
    store: Arc<Store>,
    board: StatusBoard,
) -> SolverSource {
    let mut last = None;
    Box::new(move |current| {
        let read = installation::load(&directory).and_then(|read| {
            build_solver(&read, &config)
                .map(|solver| (read, solver))
                .map_err(|fault| vec![fault])
        });
        let fault = read.as_ref().err().map(|faults| {
            let means = if current.is_some() {
                "solved with the installation before"
            } else {
                "recorded but not solved"
            };
            format!(
                "frames are {means} until this error is fixed: {}",
                join_faults(faults)
            )
        });
        board.set_fault(SOLVER_PART, fault);
        let key = read
            .as_ref()
            .map_or(String::new(), |(_, solver)| solver.inputs.key(""));
        let settled = last.replace(key.clone()).is_none_or(|before| before == key);
        let (installation, solver) = read.ok()?;
        if !settled || current.is_some_and(|current| current.inputs.key("") == key) {
            return None;
        }
        for doubt in installation::find_warnings(&installation) {
            tracing::warn!(%doubt, "warning of the installation");
        }
        let kept = installation.files().map_err(|fault| fault.to_string());
        if let Err(error) = kept.and_then(|files| {
            store
                .keep_installation(&files)
                .map_err(|error| error.to_string())
        }) {
            tracing::error!(error, "the installation is not kept in the store");
        }
        tracing::info!(directory = %directory.display(), "installation is read");
        Some(solver)
    })
}

fn join_faults(faults: &[Fault]) -> String {
    faults
        .iter()
        .map(Fault::to_string)
        .collect::<Vec<_>>()
        .join("; ")
}

/// Creates the on-board solver of an installation with an orientation.
fn build_solver(installation: &Installation, config: &SolveConfig) -> Result<Solver, Fault> {
    let orientation = installation.require_orientation()?.clone();
    let job = config.to_job();
    let inputs = Inputs::new(pipeline::provenance_map(installation, &job));
    let installation = Arc::new(installation.clone());
    let track = build_tracker(installation.clone(), orientation.clone(), job.clone());
    let solve = move |name: &str, bytes: &[u8], format: &wingd_evaluation::frame_format::Format| {
        pipeline::solve_frame(name, bytes, Some(format), &installation, &orientation, &job)
    };
    Ok(Solver {
        inputs,
        solve: Arc::new(solve),
        deadline: config.deadline,
        track: Some(track),
    })
}

/// Creates the tracker of live mode, which always uses the spatial method.
fn build_tracker(
    installation: Arc<Installation>,
    orientation: Orientation,
    job: pipeline::SolveJob,
) -> FrameTrackerFactory {
    let job = pipeline::SolveJob {
        method: AdjustmentMethod::Spatial,
        ..job
    };
    Arc::new(move || {
        let begun = Tracker::new(installation.clone(), orientation.clone(), job.clone());
        let mut tracker =
            begun.inspect_err(|why| tracing::error!(%why, "live frames are not solved"))?;
        let track =
            move |name: &str,
                  bytes: &[u8],
                  format: &wingd_evaluation::frame_format::Format,
                  at_s: f64| { tracker.track_frame(name, bytes, Some(format), at_s) };
        Ok(Box::new(track))
    })
}

/// Runs the daemon until the end of its timetable or a signal to stop.
pub fn run_recorder(
    config: &Config,
    clock: Arc<dyn Clock>,
    origin: Duration,
    opened: OpenedStore,
    observer: Observer,
) -> TaskResult<DaemonStatus> {
    let OpenedStore { store, recovery } = opened;
    let board = StatusBoard::new(clock.clone());
    let watch = |directory| {
        watch_installation(
            directory,
            config.solve.clone(),
            store.clone(),
            board.clone(),
        )
    };
    let solver = config.installation.clone().map(watch);
    let page = config
        .serve
        .as_ref()
        .and_then(|serve| RecorderPage::start(serve, config, &board));
    let parts = DaemonParts {
        series: config.series.clone(),
        power: config.power.clone(),
        live: config.live.clone(),
        status: Some(config.status.clone()),
        store,
        recovery,
        cameras: config.camera.factory(clock.clone(), origin),
        clock,
        solver,
        observer,
    };
    let ended = daemon::run(parts, &board).map_err(|e| Failure::Failed(e.to_string()));
    drop(page);
    ended
}

/// Web page of a running recorder, served on its own thread. Recording goes on without it: a page that cannot be served is
/// a fault in the status, and tried again.
struct RecorderPage {
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

/// Time allowed for open downloads when the page ends.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(1);
/// Pause before a page that cannot be served is tried again: address, token or certificate may appear later.
const PAGE_RETRY_PAUSE: Duration = Duration::from_secs(10);

/// Everything from which the page is opened.
#[derive(Clone)]
struct PageSource {
    serve: ServeConfig,
    board: StatusBoard,
    site: http::Site,
}

impl PageSource {
    /// Opens the page: reads its secrets and binds its address. The error is for the status.
    fn open(self) -> Result<(http::Site, Access, std::net::TcpListener), String> {
        let place = |key: &str| ("wingd.toml".into(), format!("serve.{key}"));
        let (address, access) = self
            .serve
            .resolve(place)
            .map_err(|faults| join_faults(&faults))?;
        for warning in self.serve.warnings() {
            tracing::warn!(warning, "web page");
        }
        let bound = std::net::TcpListener::bind(address).and_then(|listener| {
            listener.set_nonblocking(true)?;
            Ok(listener)
        });
        let listener = bound.map_err(|error| format!("{address}: {error}"))?;
        Ok((self.site, access, listener))
    }

    /// Serves the page until `end`, retrying while it cannot be opened.
    async fn serve_until(self, end: impl Future<Output = ()>) -> std::io::Result<()> {
        let board = self.board.clone();
        let report = |fault: Option<String>| {
            board.set_fault(PAGE_PART, fault);
        };
        tokio::pin!(end);
        loop {
            let source = self.clone();
            let opening = tokio::task::spawn_blocking(move || source.open());
            let opened =
                tokio::select! { opened = opening => opened?, () = &mut end => return Ok(()) };
            match opened {
                Ok((site, access, listener)) => {
                    report(None);
                    tracing::info!(address = self.serve.listen, "web page");
                    return http::serve(
                        site,
                        access,
                        tokio::net::TcpListener::from_std(listener)?,
                        end,
                    )
                    .await;
                }
                Err(why) => report(Some(why)),
            }
            tokio::select! { () = tokio::time::sleep(PAGE_RETRY_PAUSE) => {}, () = &mut end => return Ok(()) }
        }
    }
}

impl RecorderPage {
    fn start(serve: &ServeConfig, config: &Config, board: &StatusBoard) -> Option<Self> {
        let site = http::Site {
            root: config.store.path.clone(),
            recorder: Some(Arc::new(board.clone())),
        };
        let source = PageSource {
            serve: serve.clone(),
            board: board.clone(),
            site,
        };
        let (stop, stopped) = tokio::sync::oneshot::channel();
        // The page ends with the recorder, or at the signal that stops it.
        let end = async {
            tokio::select! { _ = stopped => {}, () = stop_signal() => {} }
        };
        let report = |board: &StatusBoard, error: std::io::Error| {
            board.set_fault(PAGE_PART, Some(format!("{error}; restart wingd")));
        };
        let page_board = board.clone();
        let thread = std::thread::Builder::new()
            .name("page".to_owned())
            .spawn(move || {
                let served = http::page_runtime().and_then(|runtime| {
                    let served = runtime.block_on(source.serve_until(end));
                    runtime.shutdown_timeout(SHUTDOWN_TIMEOUT);
                    served
                });
                served.unwrap_or_else(|error| report(&page_board, error));
            });
        let thread = thread.map_err(|error| report(board, error)).ok()?;
        Some(Self {
            stop: Some(stop),
            thread: Some(thread),
        })
    }
}

impl Drop for RecorderPage {
    fn drop(&mut self) {
        let _ = self.stop.take().map(|stop| stop.send(()));
        let _ = self.thread.take().map(std::thread::JoinHandle::join);
    }
}
