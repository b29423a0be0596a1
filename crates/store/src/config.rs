//! Configuration of the store: the `[store]` table of wingd.toml.

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use wingd_base::fault::KeyFault;

/// The `[store]` table of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoreConfig {
    /// Directory of the store.
    pub path: PathBuf,
    /// Space that is kept free, MB; with less than this no series begins.
    #[serde(default = "default_reserve_mb")]
    pub reserve_mb: u64,
    /// Longest pause within a flight; a longer one begins a new flight.
    #[serde(
        default = "default_new_flight_after",
        with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required"
    )]
    pub new_flight_after: Duration,
    /// Rule for a new flight after a reboot.
    #[serde(default)]
    pub new_flight_at_boot: BootPolicy,
    /// File with the key that signs the flights. If the file does not exist, a key is generated.
    #[serde(default)]
    pub signing_key: Option<PathBuf>,
}

/// Rule that decides whether a reboot begins a new flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BootPolicy {
    /// Decides by the clock (`docs/store.md`).
    #[default]
    ByClock,
    /// Begins a flight at every boot: for a machine without a battery clock that is switched on for each flight.
    Always,
    /// Begins a flight only after a pause within one boot or by command.
    Never,
}

fn default_reserve_mb() -> u64 {
    1000
}

fn default_new_flight_after() -> Duration {
    Duration::from_secs(3 * 3600)
}

impl StoreConfig {
    /// Returns the default configuration for a store at `path`.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            reserve_mb: default_reserve_mb(),
            new_flight_after: default_new_flight_after(),
            new_flight_at_boot: BootPolicy::default(),
            signing_key: None,
        }
    }

    /// Returns every error, with its key in the whole configuration file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let mut faults = Vec::new();
        if self.path.as_os_str().is_empty() {
            let remedy = "name a directory, for example /var/lib/wingd";
            faults.push(KeyFault::new("store.path", "is empty", remedy));
        }
        if self.new_flight_after.is_zero() {
            let remedy = "for example \"3h\"";
            faults.push(KeyFault::new(
                "store.new_flight_after",
                "must be longer than 0",
                remedy,
            ));
        }
        faults
    }
}
