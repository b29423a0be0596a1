//! Live mode takes frames between the series and solves them as they come (docs/live.md).
//!
//! | thread | does | waits for |
//! |---|---|---|
//! | recorder | takes a frame at each tick and hands it on | as in series |
//! | live | has frames solved, the newest first; gives the results out | the solver up to its deadline |
//! | live-solver | the state of the adjustment; given up where it does not return | |
//! | live-store | results become durable within seconds | the disk |
//! | live-frames | raw frames that are kept | the disk |
//! | main | the socket's listeners, datagrams, the state once a second | |
//!
//! Between them lies what is bounded: one frame, 600 results, `ring_mb` of frames, 64 lines. Capturing goes before live
//! solving, that before the solving of series, and that before the page's picture.

mod config;
mod events;
mod feeder;
mod frames;
mod governor;
mod mailbox;
mod meter;
mod out;
mod preview;
mod result;
mod shared;
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
use super::solver::Track;
use super::worker::Worker;
pub(crate) use feeder::Feeder;
use frames::{Keeper, Raw};
use mailbox::Mailbox;
pub(crate) use out::Tap;
use preview::Preview;
use shared::Shared;
use solving::Solving;
use storing::Storing;

/// What the end of the recorder waits for the last results.
const LAST_RESULTS: Duration = Duration::from_secs(4);

/// The threads of live mode.
pub(crate) struct Live {
    ended: Receiver<()>,
}

impl Drop for Live {
    /// The last results become durable, in a time that is bounded. The recorder has ended before.
    fn drop(&mut self) {
        // An error: all have ended.
        let _ = self.ended.recv_timeout(LAST_RESULTS);
    }
}

/// Starts the threads; `None` where live mode is off. Where the machine gives no threads the status says so. `track` begins
/// solving, without it frames are recorded only; `source` says what all results come from.
pub(crate) fn start(
    core: &Core,
    config: &LiveConfig,
    track: Option<Track>,
    source: Map<String, Value>,
) -> Option<(Feeder, Live, Tap)> {
    let rate_hz = config.rate_hz?;
    let shared = Shared::new(core, config);
    shared.update(|live| (live.wanted_hz, live.allowed_hz) = (rate_hz, rate_hz));
    core.board.expect_results(Some(Duration::from_secs_f64(1.0 / rate_hz)));
    if track.is_none() {
        shared.fault("solver", "there is no installation with an orientation: live frames are not solved");
    }
    let mailbox = Arc::new(Mailbox::default());
    let raw = Arc::new(Raw::new(shared.config.keep.clone()));
    let preview = Arc::new(Preview::default());
    let (given, _) = tokio::sync::broadcast::channel(out::WAITING);
    let tap = Tap { given, preview, shared: shared.clone() };
    let (rows, inbox) = sync_channel(storing::WAITING);
    let (done, ended) = channel();
    let solving = Solving {
        shared: shared.clone(),
        mailbox: mailbox.clone(),
        track,
        raw: raw.clone(),
        tap: tap.clone(),
        rows,
        worker: Worker::new("live-solver", solving::MAX_HANGING, core.halt.clone()),
    };
    let storing = Storing { shared: shared.clone(), source };
    let keeper = Keeper { shared: shared.clone(), raw: raw.clone() };
    spawn(&shared, "live", &done, move || solving.run());
    spawn(&shared, "live-store", &done, move || storing.run(&inbox));
    spawn(&shared, "live-frames", &done, move || keeper.run());
    Some((Feeder::new(shared, mailbox, raw), Live { ended }, tap))
}

fn spawn(shared: &Shared, name: &'static str, done: &Sender<()>, work: impl FnOnce() + Send + 'static) {
    let done = done.clone();
    let thread = Core::spawn(name, move || {
        work();
        drop(done);
    });
    if let Err(error) = thread {
        shared.fault("threads", &format!("no thread for {name}: {error}"));
    }
}
