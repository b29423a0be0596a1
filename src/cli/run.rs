//! `wingd run` is the recorder daemon.

use std::path::PathBuf;
use std::sync::Arc;

use tracing::level_filters::LevelFilter;

use super::recorder;
use crate::config;
use wingd_base::clock::{Clock, SystemClock};
use wingd_base::failure::{Completion, TaskResult};

/// Record series of frames and solve them until stopped.
#[derive(clap::Args)]
pub struct RunArgs {
    /// Configuration [default: wingd.toml in this directory]
    #[arg(long, value_name = "wingd.toml")]
    config: Option<PathBuf>,
}

pub(super) fn run(args: &RunArgs) -> TaskResult<Completion> {
    wingd_base::logging::start_logging(LevelFilter::INFO);
    let config = config::load_configuration(
        &wingd_evaluation::inputs::default_paths::resolve_configuration(args.config.as_deref())?,
    )?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let opened = recorder::open_store(&config)?;
    let origin = clock.since_boot();
    recorder::run_recorder(&config, clock, origin, opened, Arc::new(|_| ()))?;
    Ok(Completion::All)
}
