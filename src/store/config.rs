//! `[store]` of the configuration.

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::installation::KeyFault;

/// `[store]` of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoreConfig {
    /// The directory.
    pub path: PathBuf,
    /// Space that is kept free; below it no series begins.
    #[serde(default = "default_reserve_mb")]
    pub reserve_mb: u64,
    /// A pause longer than this begins a new flight.
    #[serde(
        default = "default_new_flight_after",
        with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required"
    )]
    pub new_flight_after: Duration,
    /// What another boot means for the flight.
    #[serde(default)]
    pub new_flight_at_boot: AtBoot,
    /// Signs the flights with the key in this file, which is made where there is none.
    #[serde(default)]
    pub signing_key: Option<PathBuf>,
}

/// What another boot means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AtBoot {
    /// The clock decides (`docs/store.md`).
    #[default]
    ByClock,
    /// Every boot is a new flight: for a machine without a battery clock that is switched on for each flight.
    Always,
    /// Only pauses within one boot and commands begin a flight.
    Never,
}

fn default_reserve_mb() -> u64 {
    1000
}

fn default_new_flight_after() -> Duration {
    Duration::from_secs(3 * 3600)
}

impl StoreConfig {
    /// The defaults, at `path`.
    pub fn at(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            reserve_mb: default_reserve_mb(),
            new_flight_after: default_new_flight_after(),
            new_flight_at_boot: AtBoot::default(),
            signing_key: None,
        }
    }

    /// Every fault, at its key of the whole file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let mut faults = Vec::new();
        if self.path.as_os_str().is_empty() {
            let mend = "name a directory, for example /var/lib/wingd";
            faults.push(KeyFault::new("store.path", "is empty", mend));
        }
        if self.new_flight_after.is_zero() {
            let mend = "for example \"3h\"";
            faults.push(KeyFault::new("store.new_flight_after", "must be longer than 0", mend));
        }
        faults
    }
}
