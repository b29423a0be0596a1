//! Objects that all threads of the daemon share, and the threads' priorities: capturing goes before live solving, live
//! solving before the solving of series, and that before everything that is only displayed.

use std::sync::Arc;

use super::event::Observer;
use super::shutdown::Halt;
use super::status::StatusBoard;
use crate::clock::Clock;
use crate::store::Store;

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
        std::thread::Builder::new().name(name.to_owned()).spawn(work)
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
