//! Objects that all threads of the daemon share, and the threads' priorities: capturing goes before live solving, live
//! solving before the solving of series, and that before everything that is only displayed.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use super::event::Observer;
use super::shutdown::Halt;
use super::status::StatusBoard;
use wingd_base::clock::Clock;
use wingd_store::Store;

/// Shared objects of the daemon. Cheap to clone; all clones refer to the same objects.
#[derive(Clone)]
pub(crate) struct Core {
    /// Store, open for writing.
    pub store: Arc<Store>,
    /// Clock of the schedule and of the time stamps.
    pub clock: Arc<dyn Clock>,
    /// Status of the daemon.
    pub board: StatusBoard,
    /// Stop requests and power failures.
    pub halt: Halt,
    /// Receiver of progress events.
    pub observer: Observer,
}

impl Core {
    /// Spawns a thread with this name.
    pub fn spawn_thread<T: Send + 'static>(
        name: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> std::io::Result<std::thread::JoinHandle<T>> {
        std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(work)
    }
}

/// Threads that end when the daemon ends, and store their last data before.
pub(crate) struct DrainedThreads {
    timeout: Duration,
    running: Option<Sender<()>>,
    ended: Receiver<()>,
}

impl DrainedThreads {
    /// Creates an empty set of threads, whose end is waited for at most for `timeout`.
    pub fn new(timeout: Duration) -> Self {
        let (running, ended) = channel();
        Self {
            timeout,
            running: Some(running),
            ended,
        }
    }

    /// Spawns a thread of the set.
    pub fn spawn(
        &mut self,
        name: &str,
        work: impl FnOnce() + Send + 'static,
    ) -> std::io::Result<()> {
        let running = self.running.clone();
        Core::spawn_thread(name, move || {
            work();
            drop(running);
        })
        .map(drop)
    }
}

impl Drop for DrainedThreads {
    /// Waits for a bounded time until all threads have ended. The daemon has been asked to end before.
    fn drop(&mut self) {
        self.running = None;
        // An error means that all threads have ended.
        let _ = self.ended.recv_timeout(self.timeout);
    }
}

/// Niceness of the thread that solves series while frames are solved live.
pub(crate) const SERIES_NICE: i32 = 5;
/// Niceness of threads whose results are only displayed.
pub(crate) const DISPLAY_NICE: i32 = 15;

/// Sets the niceness of the calling thread. Best effort.
pub(crate) fn lower_priority(nice: i32) {
    // On Linux, no process id means this thread.
    let _ = rustix::process::setpriority_process(None, nice);
}
