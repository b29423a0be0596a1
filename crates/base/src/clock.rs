//! Time: UTC, time since boot, boot id. Nothing else in the project reads a clock.
//!
//! The schedule and the gaps between shots are clock time, and only one thread, the recorder, waits for them. Every other
//! thread may read the clock at any moment. Limits that guard against hardware (the deadline of a shot) are always machine
//! time, because a hung camera hangs in machine time. [`SimulatedClock`] therefore advances only while the recorder waits,
//! and the times of a simulated flight do not depend on the speed of the machine.

pub mod exposure;
pub mod quality;
pub mod written_time;

use std::sync::Mutex;
use std::time::Duration;

use quality::ClockQuality;

/// Moment as stored with a shot, so that times can be corrected later.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Stamp {
    /// UTC of this machine; may be 1970.
    pub utc: jiff::Timestamp,
    /// True if the kernel reports UTC as synchronised.
    pub utc_synchronised: bool,
    pub boot_id: String,
    /// Time since boot, s.
    pub since_boot_s: f64,
}

/// 1 January 1980: what is dated before, no digital camera has taken.
pub const FIRST_KNOWN_UTC: jiff::Timestamp = jiff::Timestamp::constant(315_532_800, 0);

/// Returns whether a time is known: a clock that was not set shows an earlier one than [`FIRST_KNOWN_UTC`].
pub fn is_known_time(utc: jiff::Timestamp) -> bool {
    utc >= FIRST_KNOWN_UTC
}

impl Stamp {
    /// Returns the time in UTC; `None` if it is not known: a clock that was never set, and the stamps of images that were
    /// imported without a time, count from 1970.
    pub fn known_utc(&self) -> Option<jiff::Timestamp> {
        is_known_time(self.utc).then_some(self.utc)
    }
}

/// Source of time: [`SystemClock`] of the machine, [`SimulatedClock`] of a test or the demo.
pub trait Clock: Send + Sync {
    /// Returns the current moment.
    fn stamp(&self) -> Stamp;
    /// Returns the time since boot; never decreases.
    fn since_boot(&self) -> Duration;
    /// Returns the current quality of UTC.
    fn quality(&self) -> ClockQuality;
    /// Returns the machine time that `duration` on this clock takes.
    fn machine_time(&self, duration: Duration) -> Duration {
        duration
    }
    /// Reports that `duration` was waited for; advances a simulated clock.
    fn advance(&self, _duration: Duration) {}
    /// Waits for `duration`, or advances a simulated clock by it.
    fn sleep(&self, duration: Duration) {
        std::thread::sleep(self.machine_time(duration));
        self.advance(duration);
    }
}

/// Clock of the machine.
#[derive(Clone, Debug)]
pub struct SystemClock {
    boot_id: String,
}

impl SystemClock {
    /// Reads the boot id once; `unknown` if the kernel gives none.
    pub fn new() -> Self {
        let id = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        let id = id.trim();
        Self {
            boot_id: if id.is_empty() {
                "unknown".to_owned()
            } else {
                id.to_owned()
            },
        }
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
        read_kernel_clock(rustix::time::ClockId::Boottime)
    }
}

fn read_kernel_clock(clock: rustix::time::ClockId) -> Duration {
    let time = rustix::time::clock_gettime(clock);
    Duration::new(
        u64::try_from(time.tv_sec).unwrap_or(0),
        u32::try_from(time.tv_nsec).unwrap_or(0),
    )
}

/// Returns the machine's time since boot, s, the time base of cameras.
pub fn since_boot_s() -> f64 {
    read_kernel_clock(rustix::time::ClockId::Boottime).as_secs_f64()
}

/// Returns the machine's monotonic time, s, used in driver stamps: it stops while the machine sleeps.
pub fn monotonic_s() -> f64 {
    read_kernel_clock(rustix::time::ClockId::Monotonic).as_secs_f64()
}

/// Converts a monotonic time to time since boot, s.
pub fn since_boot_from_monotonic(at_s: f64) -> f64 {
    at_s + (since_boot_s() - monotonic_s())
}

/// Returns true if systemd-timesyncd or another service left the file that marks a clock set since boot. It is the only
/// sign if the kernel cannot be queried or is not informed (chrony without `rtcsync`).
fn utc_was_set() -> bool {
    std::path::Path::new("/run/systemd/timesync/synchronized").exists()
}

/// Clock that advances only by waiting: at once, or paced by a speed-up factor.
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
    /// Starts at `start`. Waiting takes no machine time with `speed_up = None`, and `1 / factor` of the simulated time
    /// otherwise; a factor that is not positive counts as `None`.
    pub fn starting_at(start: &Stamp, speed_up: Option<f64>) -> Self {
        let since_boot = Duration::try_from_secs_f64(start.since_boot_s).unwrap_or_default();
        Self {
            boot_id: start.boot_id.clone(),
            speed_up: speed_up.filter(|factor| factor.is_finite() && *factor > 0.0),
            state: Mutex::new(SimulatedTime {
                utc: start.utc,
                since_boot,
            }),
        }
    }

    /// Starts 30 s after a boot named `boot_id`, with UTC at `utc`.
    pub fn new(boot_id: &str, utc: jiff::Timestamp, speed_up: Option<f64>) -> Self {
        let start = Stamp {
            utc,
            utc_synchronised: true,
            boot_id: boot_id.to_owned(),
            since_boot_s: 30.0,
        };
        Self::starting_at(&start, speed_up)
    }

    fn with_time<T>(&self, f: impl FnOnce(&mut SimulatedTime) -> T) -> T {
        f(&mut self
            .state
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner))
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
        self.speed_up
            .map_or(Duration::ZERO, |factor| duration.div_f64(factor))
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
