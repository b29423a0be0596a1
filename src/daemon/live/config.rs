//! `[live]` of the configuration: live mode between the series, and the raw frames to keep.

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::daemon::aircraft::AircraftConfig;
use wingd_base::fault::KeyFault;

/// Maximum frame rate, above that of any camera, Hz.
const MAX_RATE_HZ: f64 = 100.0;
/// Maximum memory for the frames before an event, MB.
const MAX_RING_MB: u32 = 4000;

/// `[live]` of the configuration: live mode between the series.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LiveConfig {
    /// Frames per second; if absent, live mode is off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<f64>,
    /// True if scheduled series are taken in addition.
    pub series: bool,
    /// Raw frames to keep.
    pub keep: KeepConfig,
    /// Destination `host:port` of one datagram per result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub udp: Option<String>,
    /// Path of the Unix socket that gives one line of JSON per result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub socket: Option<PathBuf>,
    /// Feed of the aircraft's own data.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub aircraft_data: Option<AircraftConfig>,
}

impl Default for LiveConfig {
    fn default() -> Self {
        Self {
            rate_hz: None,
            series: true,
            keep: KeepConfig::default(),
            udp: None,
            socket: None,
            aircraft_data: None,
        }
    }
}

/// `[live.keep]` of the configuration: raw frames to keep.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct KeepConfig {
    /// Keep every n-th frame; 0 keeps none.
    pub every: u32,
    /// Memory for the last frames, which an event saves, MB; 0 turns events off.
    pub ring_mb: u32,
    /// Time before an event from which frames are saved.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub before: Duration,
    /// Time after an event until which frames are saved.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub after: Duration,
    /// Minimum time from one event to the next, except for `wingd trigger`: a camera that is disturbed all the time must
    /// not fill the disk.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub pause: Duration,
    /// Event: the global test of a frame rejects.
    pub rejected: bool,
    /// Event: the camera mount is disturbed.
    pub mount_disturbed: bool,
    /// Event: the tip moves faster than this, m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tip_rate_m_s: Option<f64>,
    /// Event: the tip's deflection differs from its mean over one minute by more than this, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tip_departure_m: Option<f64>,
}

impl Default for KeepConfig {
    fn default() -> Self {
        Self {
            every: 0,
            ring_mb: 48,
            before: Duration::from_secs(5),
            after: Duration::from_secs(5),
            pause: Duration::from_secs(60),
            rejected: false,
            mount_disturbed: true,
            tip_rate_m_s: None,
            tip_departure_m: None,
        }
    }
}

impl LiveConfig {
    /// Returns whether frames are taken between the series.
    pub fn is_enabled(&self) -> bool {
        self.rate_hz.is_some()
    }

    /// Returns every invalid setting, with its key in the whole file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let port = |text: &str| {
            text.rsplit_once(':').is_some_and(|(host, port)| {
                !host.is_empty() && port.parse::<u16>().is_ok_and(|port| port > 0)
            })
        };
        let rate = self
            .rate_hz
            .is_none_or(|hz| (0.1..=MAX_RATE_HZ).contains(&hz));
        let address = self.udp.as_deref().is_none_or(port);
        let give = "give frames per second, for example 10";
        let no_results = "is missing, so there are no results to publish";
        let nothing = "is false and rate_hz is missing, so nothing is recorded";
        let rules = [
            (rate, "rate_hz", "must be 0.1 to 100", give),
            (
                self.is_enabled() || !self.has_output(),
                "rate_hz",
                no_results,
                give,
            ),
            (
                self.series || self.is_enabled(),
                "series",
                nothing,
                "give rate_hz, or remove series",
            ),
            (
                address,
                "udp",
                "is not host:port",
                "write it as \"192.168.1.20:7072\"",
            ),
        ];
        let mut faults = KeyFault::from_rules("live", &rules);
        faults.extend(self.keep.faults());
        faults.extend(self.aircraft_data.iter().flat_map(AircraftConfig::faults));
        faults
    }

    fn has_output(&self) -> bool {
        self.udp.is_some() || self.socket.is_some()
    }
}

impl KeepConfig {
    fn faults(&self) -> Vec<KeyFault> {
        let positive = |value: Option<f64>| value.is_none_or(|v| v.is_finite() && v > 0.0);
        let longest = Duration::from_secs(600);
        let short = self.before <= longest && self.after <= longest;
        let waits = "lower it: the frames of an event stay in memory until they are saved";
        let (above, no_event) = ("must be above 0", "remove it to turn this event off");
        let rules = [
            (
                self.ring_mb <= MAX_RING_MB,
                "ring_mb",
                "is more than 4000",
                waits,
            ),
            (
                short,
                "before",
                "(or after) is longer than 10 min",
                "give for example \"5s\"",
            ),
            (positive(self.tip_rate_m_s), "tip_rate_m_s", above, no_event),
            (
                positive(self.tip_departure_m),
                "tip_departure_m",
                above,
                no_event,
            ),
        ];
        KeyFault::from_rules("live.keep", &rules)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_is_read_and_its_faults_are_named() {
        let text = "rate_hz = 10\nudp = \"127.0.0.1:7072\"\n[keep]\nevery = 600\nbefore = \"3s\"\n";
        let live: LiveConfig = toml::from_str(text).unwrap();
        assert_eq!(live.faults(), []);
        assert!(live.is_enabled() && live.series && live.keep.mount_disturbed);
        let bad = "rate_hz = 0\nudp = \"7072\"\n[keep]\nring_mb = 9999\ntip_rate_m_s = -1\n";
        let bad: LiveConfig = toml::from_str(bad).unwrap();
        let keys: Vec<String> = bad.faults().into_iter().map(|f| f.key).collect();
        let expected = [
            "live.rate_hz",
            "live.udp",
            "live.keep.ring_mb",
            "live.keep.tip_rate_m_s",
        ];
        assert_eq!(keys, expected);
        let idle: LiveConfig = toml::from_str("series = false\nsocket = \"live.sock\"").unwrap();
        assert_eq!(idle.faults().len(), 2);
        assert!(toml::from_str::<LiveConfig>("rate = 10").is_err());
    }
}
