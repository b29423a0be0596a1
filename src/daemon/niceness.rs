//! Who goes before whom on the processor: capturing before live solving, that before the solving of series, and that before
//! what is only shown.

/// Niceness of solving series while frames are solved live.
pub(crate) const SERIES_NICE: i32 = 5;
/// Niceness of what is only shown.
pub(crate) const DISPLAY_NICE: i32 = 15;

/// The calling thread gives way to those that are less nice. Best effort.
pub(crate) fn give_way(nice: i32) {
    // Of Linux: no process is named, and that is this thread.
    let _ = rustix::process::setpriority_process(None, nice);
}
