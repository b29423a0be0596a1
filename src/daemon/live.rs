//! `[live]` of the configuration.

use serde::{Deserialize, Serialize};

use super::aircraft::AircraftConfig;

/// What happens beside the series.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LiveConfig {
    /// Listen to the aircraft's own data.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub aircraft_data: Option<AircraftConfig>,
}

impl LiveConfig {
    /// Every fault, as `key: what; how to mend it`.
    pub fn faults(&self) -> Vec<String> {
        self.aircraft_data.as_ref().map(AircraftConfig::faults).unwrap_or_default()
    }
}
