//! `wingd run` is the daemon.

use std::path::PathBuf;
use std::sync::Arc;

use super::{Done, Failure, service};
use crate::clock::{Clock, System};
use crate::config;

/// Record series and solve them until told to stop.
#[derive(clap::Args)]
pub struct Args {
    /// The configuration [default: wingd.toml of this folder]
    #[arg(long, value_name = "wingd.toml")]
    config: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    super::logging::start();
    let config = config::load(&super::default_paths::configuration(args.config.as_deref())?)?;
    let clock: Arc<dyn Clock> = Arc::new(System::new());
    // A fault of the installation must not keep the frames from being recorded: they are solved later.
    let solver = config.installation.as_deref().and_then(|directory| {
        service::solver(directory, &config.solve)
            .map_err(|faults| {
                for fault in &faults {
                    tracing::error!(%fault, "frames are recorded but not solved until this is mended");
                }
            })
            .ok()
    });
    let opened = service::open_store(&config)?;
    if let (Some(directory), true) = (config.installation.as_deref(), solver.is_some()) {
        service::keep_installation(&opened.store, directory);
    }
    let origin = clock.since_boot();
    service::run(&config, clock, origin, opened, solver, Arc::new(|_| ()))?;
    Ok(Done::All)
}
