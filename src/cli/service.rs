//! `wingd run` and `wingd demo` make the daemon's parts from a configuration here.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::{Failure, interrupt};
use crate::clock::Clock;
use crate::config::{Config, SolveConfig};
use crate::daemon::{self, Observer, Parts, Solver, Status, StatusBoard, Track};
use crate::http::section::ServeConfig;
use crate::installation::{self, Fault, Installation};
use crate::measure::adjust::Method;
use crate::measure::setup::Orientation;
use crate::pipeline::live::Tracker;
use crate::store::{Inputs, RealDisk, Recovery, Store};
use crate::{http, pipeline};

/// A store, and what was recovered as it was opened.
pub struct Opened {
    pub store: Arc<Store>,
    pub recovery: Recovery,
}

/// Opens the store, making it where there is none.
pub fn open_store(config: &Config) -> Result<Opened, Failure> {
    let begin = Instant::now();
    let (store, recovery) = Store::open(Arc::new(RealDisk), config.store.clone())
        .map_err(|error| Failure::Failed(error.to_string()))?;
    let took_ms = begin.elapsed().as_millis() as u64;
    if let Some(signer) = store.signer() {
        tracing::info!(key = %signer.path().display(), public = signer.public(), "flights are signed");
    }
    tracing::info!(
        recovered = recovery.series.len(),
        set_aside = recovery.set_aside.len(),
        took_ms,
        "store is open"
    );
    Ok(Opened { store: Arc::new(store), recovery })
}

/// Keeps the installation in the store. A fault costs the keeping, not the results: it is logged.
pub fn keep_installation(store: &Store, directory: &Path) {
    let files = installation::load(directory).and_then(|i| i.files().map_err(|fault| vec![fault]));
    match files.map(|files| store.keep_installation(&files)) {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::error!(%error, "the installation is not kept in the store"),
        Err(faults) => {
            for fault in faults {
                tracing::error!(%fault, "the installation is not kept in the store");
            }
        }
    }
}

/// Solves on board where there is an installation with an orientation.
pub fn solver(directory: &Path, config: &SolveConfig) -> Result<Solver, Vec<Fault>> {
    let installation = installation::load(directory)?;
    for doubt in installation::doubts(&installation) {
        tracing::warn!(%doubt, "to be looked at");
    }
    let orientation = installation.require_orientation().map_err(|f| vec![f])?.clone();
    let job = config.job();
    let inputs = Inputs::new(pipeline::inputs(&installation, &job));
    let installation = Arc::new(installation);
    let track = track(installation.clone(), orientation.clone(), job.clone());
    let solve = move |name: &str, bytes: &[u8], format: &crate::camera::Format| {
        pipeline::solve_frame(name, bytes, Some(format), &installation, &orientation, &job)
    };
    Ok(Solver { inputs, solve: Arc::new(solve), deadline: config.deadline, track: Some(track) })
}

/// Live frames are solved spatially, whatever `[solve] method` says.
fn track(installation: Arc<Installation>, orientation: Orientation, job: pipeline::Job) -> Track {
    let job = pipeline::Job { method: Method::Spatial, ..job };
    Arc::new(move || {
        let begun = Tracker::begin(installation.clone(), orientation.clone(), job.clone());
        let mut tracker = begun.inspect_err(|why| tracing::error!(%why, "live frames are not solved"))?;
        let track = move |name: &str, bytes: &[u8], format: &crate::camera::Format, at_s: f64| {
            tracker.frame(name, bytes, Some(format), at_s)
        };
        Ok(Box::new(track))
    })
}

/// Runs the daemon until its timetable is over or it is told to stop.
pub fn run(
    config: &Config,
    clock: Arc<dyn Clock>,
    origin: Duration,
    opened: Opened,
    solver: Option<Solver>,
    observer: Observer,
) -> Result<Status, Failure> {
    let Opened { store, recovery } = opened;
    let board = StatusBoard::new(clock.clone());
    let page = config.serve.as_ref().and_then(|serve| Page::open(serve, config, &board));
    let parts = Parts {
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

/// The page of a running recorder, on a thread of its own.
struct Page {
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

/// Why there is no page; all that is done about it is to say it.
#[derive(Debug, thiserror::Error)]
enum NoPage {
    #[error("{}", .0.iter().map(Fault::to_string).collect::<Vec<_>>().join("; "))]
    Faults(Vec<Fault>),
    #[error("{0}: {1}")]
    Bound(std::net::SocketAddr, std::io::Error),
    #[error(transparent)]
    Machine(#[from] std::io::Error),
}

/// For files that are being read when the page ends.
const LAST_WORK: Duration = Duration::from_secs(1);

impl Page {
    /// A page that cannot be shown costs the page, not the recording: it is logged and in the status.
    fn open(serve: &ServeConfig, config: &Config, board: &StatusBoard) -> Option<Self> {
        Self::start(serve, config, board)
            .map_err(|why| {
                tracing::error!(%why, "no page");
                board.fault(&format!("no page: {why}"));
            })
            .ok()
    }

    fn start(serve: &ServeConfig, config: &Config, board: &StatusBoard) -> Result<Self, NoPage> {
        let place = |key: &str| ("wingd.toml".into(), format!("serve.{key}"));
        let (address, access) = serve.open(place).map_err(NoPage::Faults)?;
        let listener = std::net::TcpListener::bind(address).map_err(|e| NoPage::Bound(address, e))?;
        listener.set_nonblocking(true)?;
        let setup = config.installation.as_deref().map(installation::load_without_orientation);
        let site = http::Site {
            root: config.store.path.clone(),
            setup: setup.and_then(Result::ok).map(|installation| installation.setup),
            status: Some(board.clone()),
            live: config.live.socket.clone(),
        };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime?;
        let (stop, stopped) = tokio::sync::oneshot::channel();
        let thread = std::thread::Builder::new().name("page".to_owned()).spawn(move || {
            let served = runtime.block_on(async {
                let listener = tokio::net::TcpListener::from_std(listener)?;
                // It ends with the recorder, or at the signal that ends the recorder.
                let end = async {
                    tokio::select! { _ = stopped => {}, () = interrupt() => {} }
                };
                http::serve(site, access, listener, end).await
            });
            if let Err(error) = served {
                tracing::error!(%error, "the page ended");
            }
            runtime.shutdown_timeout(LAST_WORK);
        });
        tracing::info!(address = serve.listen, "page");
        Ok(Self { stop: Some(stop), thread: Some(thread?) })
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        let _ = self.stop.take().map(|stop| stop.send(()));
        let _ = self.thread.take().map(std::thread::JoinHandle::join);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Format;
    use crate::record::Status;

    #[test]
    fn a_frame_at_which_the_decoder_breaks_has_a_record_on_board() {
        let directory = tempfile::tempdir().unwrap();
        let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev/installation");
        for name in ["installation.toml", "camera.toml", "survey.csv"] {
            std::fs::copy(fixture.join(name), directory.path().join(name)).unwrap();
        }
        let any = "camera_from_survey = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]\n";
        std::fs::write(directory.path().join("orientation.toml"), any).unwrap();
        let solver = solver(directory.path(), &SolveConfig::default()).unwrap();
        let record = (solver.solve)("0001.jpg", crate::pipeline::decode::BREAKS, &Format::Jpeg);
        assert_eq!(record.status, Status::Failed);
        assert!(record.reason.unwrap().contains("decoder broke off"));
    }
}
