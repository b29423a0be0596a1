//! Logging to the journal if the service manager provides one, else to standard error.

use std::io::IsTerminal;

use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// Starts logging at the level of `WINGD_LOG` (for example `info` or `wingd::daemon=debug`), else at `level`.
pub fn start_logging(level: LevelFilter) {
    let requested = std::env::var("WINGD_LOG")
        .ok()
        .and_then(|text| text.parse::<Targets>().ok());
    let filter = requested.unwrap_or_else(|| Targets::new().with_default(level));
    let registry = tracing_subscriber::registry().with(filter);
    let journal = std::env::var_os("JOURNAL_STREAM").and_then(|_| tracing_journald::layer().ok());
    let started = match journal {
        Some(journal) => registry.with(journal).try_init(),
        None => {
            let plain = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
            let layer = tracing_subscriber::fmt::layer()
                .with_writer(std::io::stderr)
                .with_ansi(!plain && std::io::stderr().is_terminal());
            registry.with(layer).try_init()
        }
    };
    // A second start, as in a test, keeps the first.
    drop(started);
}
