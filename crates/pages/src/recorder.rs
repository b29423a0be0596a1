//! The running recorder, as its pages see it.

use std::sync::Arc;

use serde_json::Value;
use tokio::sync::broadcast::Receiver;

/// Recorder in the process of the pages.
pub trait Recorder: Send + Sync {
    /// Returns the present state.
    fn state(&self) -> RecorderState;

    /// Returns the live results; `None` if live mode is off.
    fn live(&self) -> Option<Arc<dyn LiveResults>>;
}

/// State of a recorder.
pub struct RecorderState {
    /// Health, one word.
    pub health: String,
    /// Health is `ok`.
    pub is_healthy: bool,
    /// Current activity, one word.
    pub activity: String,
    /// Reasons why the health is not `ok`, the most severe first.
    pub reasons: Vec<String>,
    /// Last fault in words.
    pub last_fault: Option<String>,
    /// Time until the next series, s.
    pub next_series_s: Option<f64>,
    /// Space that recording leaves free, MB.
    pub reserve_mb: u64,
    /// All of the status, as `wingd status --json` prints it.
    pub status: Value,
}

/// Live results of a recorder.
pub trait LiveResults: Send + Sync {
    /// Subscribes to results and states. A receiver that is too slow misses events and delays nobody.
    fn subscribe(&self) -> Receiver<Arc<LiveMessage>>;

    /// Returns the present state as one JSON object.
    fn state(&self) -> String;

    /// Returns the recent results as a JSON array, the oldest first, without curves and markers.
    fn history(&self) -> String;

    /// Returns a small image of the newest frame; `None` before the first. Decoding blocks the thread.
    fn newest_frame(&self) -> Option<Arc<PreviewImage>>;
}

/// Result of a frame, or the recorder's state, as sent to listeners.
pub struct LiveMessage {
    /// The state, which follows every second.
    pub is_state: bool,
    /// JSON object without a line end.
    pub json: String,
    /// ASCII datagram.
    pub datagram: String,
}

/// Small image of a frame.
pub struct PreviewImage {
    /// Number of the frame.
    pub number: u64,
    /// Width and height of the frame, px; outlines refer to it.
    pub size: (usize, usize),
    /// JPEG file of the small image.
    pub jpeg: Vec<u8>,
}
