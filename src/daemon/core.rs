//! All of the daemon's threads work with these. Capturing goes before live solving on the processor, that before the solving
//! of series, and that before what is only shown.

use std::sync::Arc;

use super::event::Observer;
use super::shutdown::Halt;
use super::status::StatusBoard;
use crate::clock::Clock;
use crate::store::Store;

/// Cheap to clone; all clones are of the same things.
#[derive(Clone)]
pub(crate) struct Core {
    /// Open for writing.
    pub store: Arc<Store>,
    /// Of the schedule and the stamps.
    pub clock: Arc<dyn Clock>,
    /// What the daemon says of itself.
    pub board: StatusBoard,
    /// A wish to stop, or word that the power fails.
    pub halt: Halt,
    /// A progress display.
    pub observer: Observer,
}

impl Core {
    /// A thread with this name.
    pub fn spawn<T: Send + 'static>(
        name: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> std::io::Result<std::thread::JoinHandle<T>> {
        std::thread::Builder::new().name(name.to_owned()).spawn(work)
    }
}

/// Niceness of solving series while frames are solved live.
pub(crate) const SERIES_NICE: i32 = 5;
/// Niceness of what is only shown.
pub(crate) const DISPLAY_NICE: i32 = 15;

/// The calling thread gives way to those that are less nice. Best effort.
pub(crate) fn give_way(nice: i32) {
    // Of Linux: no process is named, and that is this thread.
    let _ = rustix::process::setpriority_process(None, nice);
}
