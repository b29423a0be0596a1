//! A progress display gets these events.

use std::sync::Arc;

/// Something that a progress display may show.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A series begins.
    SeriesBegan {
        /// Its name.
        series: String,
        /// Its flight's.
        flight: String,
    },
    /// A frame is durable.
    FrameStored {
        /// Its series.
        series: String,
        /// From 1.
        shot: u32,
        /// In the series' folder.
        file: String,
        /// Hex.
        sha256: String,
    },
    /// A shot without a frame.
    ShotFailed {
        /// Its series.
        series: String,
        /// From 1.
        shot: u32,
    },
    /// A series is in its flight's folder.
    SeriesClosed {
        /// Its name.
        series: String,
        /// Every planned shot was tried.
        complete: bool,
    },
    /// The store took no series.
    Refused {
        /// Why.
        reason: String,
    },
    /// A frame has its result.
    Solved {
        /// Its series.
        series: String,
        /// In the series' folder.
        file: String,
        /// With numbers.
        ok: bool,
    },
}

/// Called on the daemon's threads; must return soon.
pub type Observer = Arc<dyn Fn(&Event) + Send + Sync>;
