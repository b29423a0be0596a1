//! What `wingd run` and `wingd demo` share: the daemon's parts from a configuration.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::Failure;
use crate::clock::Clock;
use crate::config::{Config, SolveConfig};
use crate::daemon::{self, Board, Observer, Parts, Solver, Status};
use crate::installation::{self, Fault};
use crate::pipeline;
use crate::store::{Inputs, RealDisk, Recovery, Store};

/// Opens the store, making it where there is none.
pub fn open_store(config: &Config) -> Result<(Arc<Store>, Recovery), Failure> {
    let begin = Instant::now();
    let (store, recovery) = Store::open(Arc::new(RealDisk), config.store.clone())
        .map_err(|error| Failure::Undone(error.to_string()))?;
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
    Ok((Arc::new(store), recovery))
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
    let solve = move |name: &str, bytes: &[u8], format: &crate::camera::Format| {
        pipeline::solve_frame(name, bytes, Some(format), &installation, &orientation, &job)
    };
    Ok(Solver { inputs, solve: Arc::new(solve), deadline: config.deadline })
}

/// Runs the daemon until its timetable is over or it is told to stop.
pub fn run(
    config: &Config,
    clock: Arc<dyn Clock>,
    origin: Duration,
    opened: (Arc<Store>, Recovery),
    solver: Option<Solver>,
    observer: Observer,
) -> Result<Status, Failure> {
    let make = config.camera.factory(clock.clone(), origin);
    let (store, recovery) = opened;
    let board = Board::new(clock.clone());
    let parts = Parts {
        series: config.series.clone(),
        power: config.power.clone(),
        status: Some(config.status.clone()),
        store,
        recovery,
        clock,
        cameras: Box::new(move || Ok(make())),
        solver,
        observer,
    };
    daemon::run(parts, &board).map_err(|e| Failure::Undone(e.to_string()))
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
