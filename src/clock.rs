//! Time: UTC, time since boot, boot id. Nothing else in the project reads a clock.
//!
//! How the daemon's threads use it: the schedule and the gaps between shots are clock time and are
//! waited for by one thread only, the recorder. Every other thread may read the clock at any moment.
//! Limits that guard against hardware (the deadline of a shot) are always machine time, because a
//! hung camera hangs in machine time. [`Simulated`] time therefore moves only while the recorder
//! waits, and the times of a simulated flight do not depend on the speed of the machine.

pub mod exposure;
pub mod quality;

use std::sync::Mutex;
use std::time::Duration;

use quality::ClockQuality;

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

/// A source of time. [`System`] is the machine's; [`Simulated`] is driven by a test or by the demo.
pub trait Clock: Send + Sync {
    /// Now, in full.
    fn stamp(&self) -> Stamp;
    /// Since boot; never goes back.
    fn since_boot(&self) -> Duration;
    /// How far UTC may be trusted now.
    fn quality(&self) -> ClockQuality;
    /// How long the machine waits for `duration` to pass on this clock.
    fn machine_time(&self, duration: Duration) -> Duration {
        duration
    }
    /// Says that `duration` was waited for; moves a simulated clock on.
    fn advance(&self, _duration: Duration) {}
    /// Waits (or, for a simulated clock, moves time on by) `duration`.
    fn sleep(&self, duration: Duration) {
        std::thread::sleep(self.machine_time(duration));
        self.advance(duration);
    }
}

/// The machine's clock.
#[derive(Clone, Debug)]
pub struct SystemClock {
    boot_id: String,
}

impl SystemClock {
    /// Reads the boot id once; `unknown` where the kernel does not give one.
    pub fn new() -> Self {
        let id = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        let id = id.trim();
        Self { boot_id: if id.is_empty() { "unknown".to_owned() } else { id.to_owned() } }
    }
}

impl Default for SystemClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for SystemClock {
    #[allow(clippy::disallowed_methods)] // the one place where the wall clock is read
    fn stamp(&self) -> Stamp {
        Stamp {
            utc: jiff::Timestamp::now(),
            utc_synchronised: self.quality().synchronised,
            boot_id: self.boot_id.clone(),
            since_boot_s: self.since_boot().as_secs_f64(),
        }
    }

    fn quality(&self) -> ClockQuality {
        quality::read_kernel_quality()
            .filter(|quality| quality.synchronised)
            .unwrap_or_else(|| ClockQuality::without_kernel_values(utc_was_set()))
    }

    fn since_boot(&self) -> Duration {
        read_clock(rustix::time::ClockId::Boottime)
    }
}

fn read_clock(clock: rustix::time::ClockId) -> Duration {
    let time = rustix::time::clock_gettime(clock);
    Duration::new(u64::try_from(time.tv_sec).unwrap_or(0), u32::try_from(time.tv_nsec).unwrap_or(0))
}

/// The machine's time since boot, s: what cameras stamp with.
pub fn since_boot_s() -> f64 {
    read_clock(rustix::time::ClockId::Boottime).as_secs_f64()
}

/// The machine's monotonic time, s, which drivers stamp with: it stands still while the machine sleeps.
pub fn monotonic_s() -> f64 {
    read_clock(rustix::time::ClockId::Monotonic).as_secs_f64()
}

/// Time since boot of a monotonic time, s.
pub fn since_boot_from_monotonic(at_s: f64) -> f64 {
    at_s + (since_boot_s() - monotonic_s())
}

/// systemd-timesyncd leaves this file when it has set the clock since boot, and other services may; it is the only sign
/// where the kernel may not be asked, or is not informed (chrony without `rtcsync`).
fn utc_was_set() -> bool {
    std::path::Path::new("/run/systemd/timesync/synchronized").exists()
}

/// A clock that moves only by waiting: at once, or paced by a speed-up factor.
#[derive(Debug)]
pub struct SimulatedClock {
    boot_id: String,
    speed_up: Option<f64>,
    state: Mutex<SimulatedTime>,
}

#[derive(Clone, Copy, Debug)]
struct SimulatedTime {
    utc: jiff::Timestamp,
    since_boot: Duration,
}

impl SimulatedClock {
    /// Starts at `start`. Waiting takes no machine time with `speed_up = None`, and `1 / factor` of
    /// the simulated time otherwise; a factor that is not positive counts as `None`.
    pub fn starting_at(start: &Stamp, speed_up: Option<f64>) -> Self {
        let since_boot = Duration::try_from_secs_f64(start.since_boot_s).unwrap_or_default();
        Self {
            boot_id: start.boot_id.clone(),
            speed_up: speed_up.filter(|factor| factor.is_finite() && *factor > 0.0),
            state: Mutex::new(SimulatedTime { utc: start.utc, since_boot }),
        }
    }

    /// Starts 30 s after a boot named `boot_id`, with UTC at `utc`.
    pub fn new(boot_id: &str, utc: jiff::Timestamp, speed_up: Option<f64>) -> Self {
        let start = Stamp { utc, utc_synchronised: true, boot_id: boot_id.to_owned(), since_boot_s: 30.0 };
        Self::starting_at(&start, speed_up)
    }

    fn with_time<T>(&self, f: impl FnOnce(&mut SimulatedTime) -> T) -> T {
        f(&mut self.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner))
    }
}

impl Clock for SimulatedClock {
    fn stamp(&self) -> Stamp {
        let now = self.with_time(|time| *time);
        Stamp {
            utc: now.utc,
            utc_synchronised: true,
            boot_id: self.boot_id.clone(),
            since_boot_s: now.since_boot.as_secs_f64(),
        }
    }

    fn since_boot(&self) -> Duration {
        self.with_time(|time| time.since_boot)
    }

    fn quality(&self) -> ClockQuality {
        ClockQuality::exact()
    }

    fn machine_time(&self, duration: Duration) -> Duration {
        self.speed_up.map_or(Duration::ZERO, |factor| duration.div_f64(factor))
    }

    fn advance(&self, duration: Duration) {
        self.with_time(|time| {
            time.since_boot = time.since_boot.saturating_add(duration);
            if let Ok(utc) = time.utc.checked_add(duration) {
                time.utc = utc;
            }
        });
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn simulated_time_moves_only_by_waiting() {
        let clock = SimulatedClock::new("boot", "2026-03-01T06:00:00Z".parse().unwrap(), None);
        let before = clock.stamp();
        clock.sleep(Duration::from_secs(3600));
        let after = clock.stamp();
        assert_eq!(after.since_boot_s - before.since_boot_s, 3600.0);
        assert_eq!(after.utc, "2026-03-01T07:00:00Z".parse().unwrap());
    }

    #[test]
    fn system_time_since_boot_does_not_go_back() {
        let clock = SystemClock::new();
        let first = clock.since_boot();
        assert!(first > Duration::ZERO);
        assert!(clock.since_boot() >= first);
        assert!(!clock.stamp().boot_id.is_empty());
    }
}
