//! Frames between the series, solved as they come (docs/live.md).
//!
//! | thread | does | waits for |
//! |---|---|---|
//! | recorder | takes a frame at each tick and hands it on | as in series |
//! | live | has frames solved, the newest first; gives the results out | the solver up to its deadline |
//! | live-solver | the state of the adjustment; given up where it does not return | |
//! | live-store | results become durable within seconds | the disk |
//! | live-frames | raw frames that are kept | the disk |
//! | main | the socket's listeners, datagrams | |
//!
//! Between them lies what is bounded: one frame, 600 results, `ring_mb` of frames, 64 lines. Capturing goes before live
//! solving, that before the solving of series, and that before the page's picture.

mod capture;
mod config;
mod events;
mod frames;
mod governor;
mod mailbox;
mod out;
mod preview;
mod result;
mod solving;
mod status;
mod storing;
mod table;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde_json::{Map, Value};

pub use config::{KeepConfig, LiveConfig};
pub use result::{DATAGRAM_POINTS, LiveResult};
pub use status::LiveStatus;

use super::halt::Halt;
use super::status::Board;
use crate::camera::Format;
use crate::clock::Clock;
use crate::measure::adjust::AdjustError;
use crate::pipeline::live::Told;
use crate::store::Store;
pub(crate) use capture::Feeder;
use frames::{Keeper, Raw};
use mailbox::Mailbox;
pub(crate) use out::Tap;
use preview::Preview;
use solving::Solving;
use storing::Storing;

/// Solves one frame after the other: its name, bytes, how to read them, when it was exposed (since boot, s).
pub type Tracking = Box<dyn FnMut(&str, &[u8], &Format, f64) -> Told + Send>;

/// Begins tracking, at the start and after a solver was given up.
pub type Track = Arc<dyn Fn() -> Result<Tracking, AdjustError> + Send + Sync>;

/// Niceness of solving series while frames are solved live.
pub(crate) const SERIES_NICE: i32 = 5;
/// Niceness of what is only shown.
const DISPLAY_NICE: i32 = 15;
/// What the end of the recorder waits for the last results.
const LAST_RESULTS: Duration = Duration::from_secs(4);

/// The calling thread gives way to those that are less nice. Best effort.
pub(crate) fn give_way(nice: i32) {
    // Of Linux: no process is named, and that is this thread.
    let _ = rustix::process::setpriority_process(None, nice);
}

/// What the threads share.
#[derive(Clone)]
pub(crate) struct Shared {
    config: LiveConfig,
    clock: Arc<dyn Clock>,
    board: Board,
    halt: Halt,
    skipped: Arc<AtomicU64>,
    faults: Arc<Mutex<BTreeMap<&'static str, String>>>,
}

impl Shared {
    fn update(&self, f: impl FnOnce(&mut LiveStatus)) {
        self.board.update(|status| f(status.live.get_or_insert_default()));
    }

    fn skipped(&self) -> u64 {
        self.skipped.load(Ordering::Relaxed)
    }

    fn skip(&self) {
        let skipped = self.skipped.fetch_add(1, Ordering::Relaxed) + 1;
        self.update(|live| live.skipped = skipped);
    }

    /// What is wrong with a part, until it is cleared; said once.
    fn fault(&self, part: &'static str, what: &str) {
        let mut faults = self.faults.lock().unwrap_or_else(PoisonError::into_inner);
        if faults.get(part).map(String::as_str) == Some(what) {
            return;
        }
        faults.insert(part, what.to_owned());
        drop(faults);
        tracing::warn!(part, what, "live mode");
        self.board.fault(what);
        self.update(|live| live.fault = Some(what.to_owned()));
    }

    fn clear(&self, part: &'static str) {
        let mut faults = self.faults.lock().unwrap_or_else(PoisonError::into_inner);
        if faults.remove(part).is_some() {
            let other = faults.values().next().cloned();
            drop(faults);
            tracing::info!(part, "live mode: works again");
            self.update(|live| live.fault = other);
        }
    }

    fn event(&self, raw: &Raw, reason: String, at_s: f64, asked: bool) {
        if raw.event(reason.clone(), at_s, asked) {
            tracing::info!(reason, "event");
            self.update(|live| live.events += 1);
        }
    }
}

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

/// What live mode needs of the recorder.
pub(crate) struct Surroundings<'a> {
    pub config: &'a LiveConfig,
    pub store: &'a Arc<Store>,
    pub clock: &'a Arc<dyn Clock>,
    pub board: &'a Board,
    pub halt: &'a Halt,
    /// Begins solving; without it frames are recorded only.
    pub track: Option<Track>,
    /// What all results come from.
    pub source: Map<String, Value>,
}

/// Starts the threads; `None` where live mode is off. Where the machine gives no threads the status says so.
pub(crate) fn start(around: Surroundings) -> Option<(Feeder, Live, Tap)> {
    let rate_hz = around.config.rate_hz?;
    let shared = Shared {
        config: around.config.clone(),
        clock: around.clock.clone(),
        board: around.board.clone(),
        halt: around.halt.clone(),
        skipped: Arc::default(),
        faults: Arc::default(),
    };
    shared.update(|live| (live.wanted_hz, live.allowed_hz) = (rate_hz, rate_hz));
    if around.track.is_none() {
        shared.fault("solver", "there is no installation with an orientation: live frames are not solved");
    }
    let mailbox = Arc::new(Mailbox::default());
    let raw = Arc::new(Raw::new(shared.config.keep.clone()));
    let preview = Arc::new(Preview::default());
    let (results, _) = tokio::sync::broadcast::channel(out::WAITING);
    let tap = Tap { results, preview, shared: shared.clone() };
    let (rows, inbox) = sync_channel(storing::WAITING);
    let (done, ended) = channel();
    let solving = Solving {
        shared: shared.clone(),
        mailbox: mailbox.clone(),
        track: around.track,
        raw: raw.clone(),
        tap: tap.clone(),
        rows,
        running: Arc::default(),
    };
    let storing = Storing { shared: shared.clone(), store: around.store.clone(), source: around.source };
    let keeper = Keeper { shared: shared.clone(), store: around.store.clone(), raw: raw.clone() };
    spawn(&shared, "live", &done, move || solving.run());
    spawn(&shared, "live-store", &done, move || storing.run(&inbox));
    spawn(&shared, "live-frames", &done, move || keeper.run());
    Some((Feeder::new(shared, mailbox, raw), Live { ended }, tap))
}

fn spawn(shared: &Shared, name: &'static str, done: &Sender<()>, work: impl FnOnce() + Send + 'static) {
    let done = done.clone();
    let thread = std::thread::Builder::new().name(name.to_owned()).spawn(move || {
        work();
        drop(done);
    });
    if let Err(error) = thread {
        shared.fault("threads", &format!("no thread for {name}: {error}"));
    }
}
