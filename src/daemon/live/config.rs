//! `[live]` of the configuration says what happens between the series, and which raw frames are kept.

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::daemon::aircraft::AircraftConfig;
use crate::installation::KeyFault;

/// No camera gives more frames a second.
const MAX_RATE_HZ: f64 = 100.0;
/// At most so much memory for frames before an event, MB.
const MAX_RING_MB: u32 = 4000;

/// What happens beside the series.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LiveConfig {
    /// Frames a second; without it there is no live mode.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<f64>,
    /// Series by the timetable, too.
    pub series: bool,
    /// Raw frames that are kept.
    pub keep: KeepConfig,
    /// `host:port` that a datagram goes to with each result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub udp: Option<String>,
    /// Where a line of JSON comes with each result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub socket: Option<PathBuf>,
    /// Above it the rate is lowered, then the frames pause.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_temperature_c: Option<f64>,
    /// Listen to the aircraft's own data.
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
            max_temperature_c: None,
            aircraft_data: None,
        }
    }
}

/// `[live.keep]`: which raw frames are kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct KeepConfig {
    /// Every n-th frame; 0 keeps none.
    pub every: u32,
    /// Memory for the last frames, which an event saves, MB; 0 keeps none.
    pub ring_mb: u32,
    /// Saved from before an event.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub before: Duration,
    /// And from after it.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub after: Duration,
    /// From one event's end to the next that is not asked for: a camera that is disturbed all the time must not fill the disk.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub pause: Duration,
    /// An event: the global test of a frame rejects.
    pub rejected: bool,
    /// An event: the camera mount is disturbed.
    pub mount_disturbed: bool,
    /// An event: the tip moves faster, m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tip_rate_m_s: Option<f64>,
    /// An event: the tip's deflection is farther from its mean of a minute, m.
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
    /// Whether frames are taken between the series.
    pub fn on(&self) -> bool {
        self.rate_hz.is_some()
    }

    /// Every fault, at its key of the whole file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let port = |text: &str| {
            text.rsplit_once(':').is_some_and(|(host, port)| {
                !host.is_empty() && port.parse::<u16>().is_ok_and(|port| port > 0)
            })
        };
        let rate = self.rate_hz.is_none_or(|hz| (0.1..=MAX_RATE_HZ).contains(&hz));
        let address = self.udp.as_deref().is_none_or(port);
        let temperature = self.max_temperature_c.is_none_or(|c| (30.0..=120.0).contains(&c));
        let give = "give frames a second, for example 10";
        let no_results = "is missing, so that there are no results to give out";
        let nothing = "is false without rate_hz, so that nothing is recorded";
        let sheet = "the processor's data sheet names what it bears";
        let rules = [
            (rate, "rate_hz", "must be 0.1 to 100", give),
            (self.on() || !self.has_output(), "rate_hz", no_results, give),
            (self.series || self.on(), "series", nothing, "give rate_hz, or leave series out"),
            (address, "udp", "is no host and port", "write it as \"192.168.1.20:7072\""),
            (temperature, "max_temperature_c", "must be 30 to 120", sheet),
        ];
        let mut faults = KeyFault::broken("live", &rules);
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
        let waits = "what an event saves lies in memory until then";
        let (above, no_event) = ("must be above 0", "leave it out for no such event");
        let rules = [
            (self.ring_mb <= MAX_RING_MB, "ring_mb", "is more than 4000", waits),
            (short, "before", "before and after an event at most 10 min", "give for example \"5s\""),
            (positive(self.tip_rate_m_s), "tip_rate_m_s", above, no_event),
            (positive(self.tip_departure_m), "tip_departure_m", above, no_event),
        ];
        KeyFault::broken("live.keep", &rules)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_section_is_read_and_its_faults_are_named() {
        let text = "rate_hz = 10\nudp = \"127.0.0.1:7072\"\n[keep]\nevery = 600\nbefore = \"3s\"\n";
        let live: LiveConfig = toml::from_str(text).unwrap();
        assert_eq!(live.faults(), []);
        assert!(live.on() && live.series && live.keep.mount_disturbed);
        let bad =
            "rate_hz = 0\nudp = \"7072\"\nmax_temperature_c = 1\n[keep]\nring_mb = 9999\ntip_rate_m_s = -1\n";
        let bad: LiveConfig = toml::from_str(bad).unwrap();
        let keys: Vec<String> = bad.faults().into_iter().map(|f| f.key).collect();
        let expected = [
            "live.rate_hz",
            "live.udp",
            "live.max_temperature_c",
            "live.keep.ring_mb",
            "live.keep.tip_rate_m_s",
        ];
        assert_eq!(keys, expected);
        let idle: LiveConfig = toml::from_str("series = false\nsocket = \"live.sock\"").unwrap();
        assert_eq!(idle.faults().len(), 2);
        assert!(toml::from_str::<LiveConfig>("rate = 10").is_err());
    }
}
