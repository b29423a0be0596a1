//! `wingd run` is the recorder daemon.

use std::path::PathBuf;
use std::sync::Arc;

use tracing::level_filters::LevelFilter;

use super::{Completion, TaskResult, recorder};
use crate::clock::{Clock, SystemClock};
use crate::config;
use crate::report::ReportBuilder;

/// Record series of frames and solve them until stopped.
#[derive(clap::Args)]
pub struct RunArgs {
    /// Configuration [default: wingd.toml in this directory]
    #[arg(long, value_name = "wingd.toml")]
    config: Option<PathBuf>,
}

pub(super) fn run(args: &RunArgs, reports: Option<ReportBuilder>) -> TaskResult<Completion> {
    super::logging::start_logging(LevelFilter::INFO);
    let config = config::load_configuration(&super::default_paths::resolve_configuration(
        args.config.as_deref(),
    )?)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let opened = recorder::open_store(&config)?;
    let origin = clock.since_boot();
    recorder::run_recorder(&config, clock, origin, opened, Arc::new(|_| ()), reports)?;
    Ok(Completion::All)
}
