//! Events for a progress display.

use std::sync::Arc;

/// An event that a progress display may show.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A series begins.
    SeriesBegan {
        /// Name of the series.
        series: String,
        /// Name of the flight.
        flight: String,
    },
    /// A frame is durable.
    FrameStored {
        /// Name of the series.
        series: String,
        /// Number of the shot, from 1.
        shot: u32,
        /// File name in the folder of the series.
        file: String,
        /// SHA-256 of the file, hex.
        sha256: String,
    },
    /// A series was moved into its flight's folder.
    SeriesClosed {
        /// Name of the series.
        series: String,
        /// True if every planned shot was attempted.
        complete: bool,
    },
    /// A frame has its result.
    Solved {
        /// Name of the series.
        series: String,
        /// File name in the folder of the series.
        file: String,
        /// True if the result has numbers.
        ok: bool,
    },
}

/// Callback for events. It is called on the daemon's threads and must return soon.
pub type Observer = Arc<dyn Fn(&Event) + Send + Sync>;
