//! These are the wishes of others to the recorder.

/// By way of a channel, whose other end is the recorder's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Command {
    /// An extra series, soon.
    Trigger,
    /// The same, as the first of a new flight.
    NewFlight,
    /// The halt has changed.
    Look,
}
