//! Time: UTC, time since boot, boot id. Nothing else in the project reads a clock.

use std::time::Duration;

/// A moment as a shot keeps it, so that times can be mended later.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Stamp {
    /// UTC as the machine believes it; may be 1970.
    pub utc: jiff::Timestamp,
    /// Whether the kernel says that UTC is synchronised.
    pub utc_synchronised: bool,
    /// Identifies the boot.
    pub boot_id: String,
    /// Since boot, s.
    pub since_boot_s: f64,
}

/// A source of time. [`System`] is the machine's; [`Manual`] is driven by a test or by the demo.
pub trait Clock: Send + Sync {
    /// Now, in full.
    fn stamp(&self) -> Stamp;
    /// Since boot; never goes back.
    fn since_boot(&self) -> Duration;
    /// Waits (or, for a simulated clock, moves time on by) `duration`.
    fn sleep(&self, duration: Duration);
}
