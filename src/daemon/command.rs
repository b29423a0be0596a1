//! Commands to the recorder from other threads.

/// A command to the recorder, sent through its channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Command {
    /// Take an extra series now.
    Trigger,
    /// Take an extra series now and begin a new flight with it.
    NewFlight,
    /// Wake up: the [`Halt`](super::shutdown::Halt) has changed.
    HaltChanged,
}
