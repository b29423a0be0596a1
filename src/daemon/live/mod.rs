//! Live mode takes frames between the series and solves them as they come (docs/live.md).
//!
//! | thread | task | waits for |
//! |---|---|---|
//! | recorder | takes a frame at each tick and hands it on | as in series |
//! | live-feed | takes frames while the recorder waits for the disk during a series | the recorder |
//! | live | has the newest frame solved and publishes the result | the solver, up to its deadline |
//! | live-solver | holds the state of the adjustment; abandoned if it does not return | |
//! | live-store | makes results durable within seconds | the disk |
//! | live-frames | keeps raw frames | the disk |
//! | main | serves listeners at the socket, sends datagrams, publishes the state once per second | |
//!
//! All queues between the threads are bounded: one frame, 600 results, `ring_mb` of frames, 64 lines. Capturing goes before
//! live solving, live solving before the solving of series, and that before the page's image.

mod config;
mod context;
mod events;
mod feeder;
mod frames;
mod mailbox;
mod meter;
mod preview;
mod publisher;
mod result;
mod solving;
mod state;
mod storing;
mod table;

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;

pub use config::{KeepConfig, LiveConfig};
pub use result::DATAGRAM_POINTS;

use super::core::{Core, DrainedThreads};
use super::memory;
use super::solver::CurrentSolver;
use super::worker::Worker;
use context::LiveContext;
pub(crate) use feeder::Feeder;
use frames::{RawFrameBuffer, RawFrameWriter};
use mailbox::Mailbox;
use preview::Preview;
pub(crate) use publisher::ResultPublisher;
use solving::LiveSolver;
use storing::LiveResultWriter;

/// Maximum time that the end of the recorder waits for the last results.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(4);

/// Starts the threads; returns `None` if live mode is off. If a thread cannot be started, the status reports it. While there
/// is no solver, frames are only recorded.
pub(crate) fn start_live(
    core: &Core,
    config: &LiveConfig,
    current: CurrentSolver,
) -> Option<(Feeder, DrainedThreads, ResultPublisher)> {
    let rate_hz = config.rate_hz?;
    let mut config = config.clone();
    let wanted_mb = config.keep.ring_mb;
    let limit_mb = memory::process_limit_mb(Path::new("/")).unwrap_or(u64::MAX);
    config.keep.ring_mb = wanted_mb.min(memory::largest_ring_mb(limit_mb));
    let shared = LiveContext::new(core, &config);
    if config.keep.ring_mb < wanted_mb {
        let used_mb = config.keep.ring_mb;
        let problem = format!(
            "[live.keep] ring_mb = {wanted_mb} does not fit into the service's limit of {limit_mb} MB"
        );
        shared.set_fault("memory", &format!("{problem}; {used_mb} MB are used"));
    }
    shared.update(|live| live.wanted_hz = rate_hz);
    let period = Duration::from_secs_f64(1.0 / rate_hz);
    core.board.expect_results(period);
    if current.get().is_none() {
        shared.set_fault(
            "solver",
            "live frames are not solved: no installation with an orientation; run `wingd check`",
        );
    }
    let mailbox = Arc::new(Mailbox::default());
    let raw = Arc::new(RawFrameBuffer::new(shared.config.keep.clone()));
    let preview = Arc::new(Preview::default());
    let (messages, _) = tokio::sync::broadcast::channel(publisher::MAX_WAITING);
    let publisher = ResultPublisher {
        messages,
        preview,
        history: Arc::default(),
        shared: shared.clone(),
    };
    core.board.show_live(Arc::new(publisher.clone()));
    let (rows, inbox) = sync_channel(storing::MAX_WAITING);
    let solving = LiveSolver {
        shared: shared.clone(),
        mailbox: mailbox.clone(),
        current,
        solver: None,
        raw: raw.clone(),
        publisher: publisher.clone(),
        rows,
        worker: Worker::new("live-solver", solving::MAX_HANGING, core.halt.clone()),
    };
    let storing = LiveResultWriter {
        shared: shared.clone(),
    };
    let keeper = RawFrameWriter::new(shared.clone(), raw.clone());
    let mut threads = DrainedThreads::new(DRAIN_TIMEOUT);
    let started = threads
        .spawn("live", move || solving.run())
        .and(threads.spawn("live-store", move || storing.run(&inbox)))
        .and(threads.spawn("live-frames", move || keeper.run()));
    if let Err(error) = started {
        shared.set_fault(
            "threads",
            &format!("a thread of live mode cannot be started: {error}; restart wingd"),
        );
    }
    let feeder = Feeder::new(shared, mailbox, raw, period);
    Some((feeder, threads, publisher))
}
