//! Live mode takes frames between the series and solves them as they come (docs/live.md).
//!
//! | thread | task | waits for |
//! |---|---|---|
//! | recorder | takes a frame at each tick and hands it on | as in series |
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
mod governor;
mod mailbox;
mod meter;
mod preview;
mod publisher;
mod result;
mod solving;
mod state;
mod storing;
mod table;

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel, sync_channel};
use std::time::Duration;

use serde_json::{Map, Value};

pub use config::{KeepConfig, LiveConfig};
pub use result::{DATAGRAM_POINTS, LiveResult};

use super::core::Core;
use super::solver::FrameTrackerFactory;
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

/// Handle of the threads of live mode.
pub(crate) struct LiveThreads {
    ended: Receiver<()>,
}

impl Drop for LiveThreads {
    /// Waits for a bounded time until the last results are durable. The recorder has ended before.
    fn drop(&mut self) {
        // An error means that all threads have ended.
        let _ = self.ended.recv_timeout(DRAIN_TIMEOUT);
    }
}

/// Starts the threads; returns `None` if live mode is off. If a thread cannot be started, the status reports it. `track`
/// creates the tracker of frames; without it frames are only recorded. `source` is the provenance of all results.
pub(crate) fn start_live(
    core: &Core,
    config: &LiveConfig,
    track: Option<FrameTrackerFactory>,
    source: Map<String, Value>,
) -> Option<(Feeder, LiveThreads, ResultPublisher)> {
    let rate_hz = config.rate_hz?;
    let shared = LiveContext::new(core, config);
    shared.update(|live| (live.wanted_hz, live.allowed_hz) = (rate_hz, rate_hz));
    core.board.expect_results(Some(Duration::from_secs_f64(1.0 / rate_hz)));
    if track.is_none() {
        shared
            .set_fault("solver", "live frames are not solved: no installation with an orientation; run `wingd check`");
    }
    let mailbox = Arc::new(Mailbox::default());
    let raw = Arc::new(RawFrameBuffer::new(shared.config.keep.clone()));
    let preview = Arc::new(Preview::default());
    let (messages, _) = tokio::sync::broadcast::channel(publisher::MAX_WAITING);
    let publisher = ResultPublisher { messages, preview, shared: shared.clone() };
    let (rows, inbox) = sync_channel(storing::MAX_WAITING);
    let (done, ended) = channel();
    let solving = LiveSolver {
        shared: shared.clone(),
        mailbox: mailbox.clone(),
        track,
        raw: raw.clone(),
        publisher: publisher.clone(),
        rows,
        worker: Worker::new("live-solver", solving::MAX_HANGING, core.halt.clone()),
    };
    let storing = LiveResultWriter { shared: shared.clone(), source };
    let keeper = RawFrameWriter { shared: shared.clone(), raw: raw.clone() };
    spawn_thread(&shared, "live", &done, move || solving.run());
    spawn_thread(&shared, "live-store", &done, move || storing.run(&inbox));
    spawn_thread(&shared, "live-frames", &done, move || keeper.run());
    Some((Feeder::new(shared, mailbox, raw), LiveThreads { ended }, publisher))
}

fn spawn_thread(shared: &LiveContext, name: &'static str, done: &Sender<()>, work: impl FnOnce() + Send + 'static) {
    let done = done.clone();
    let thread = Core::spawn_thread(name, move || {
        work();
        drop(done);
    });
    if let Err(error) = thread {
        shared.set_fault("threads", &format!("the thread {name} cannot be started: {error}; restart wingd"));
    }
}
