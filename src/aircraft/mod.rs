//! Aircraft data: lines of a feed or a file, joined with frames by their time tags (docs/aircraft-data.md).
//!
//! | file | from | to |
//! |---|---|---|
//! | `mapping` | mapping file written by the user | quantity of each column |
//! | `table`, `iwg1`, `icartt`, `units`, `statements` | text of a table, its mapping | layout and lines, contents of the cells, errors |
//! | `times` | time tag | seconds since 1970; likely format of an unreadable tag |
//! | `layout` | line of text, positions of its fields | sample: time tag and quantities |
//! | `tags` | tags and receipt times of their lines | impossible tags |
//! | `interpolate` | values of a quantity around a time | value at that time, possible change between the tags |
//! | `join` | samples, time of a frame | state with standard deviations |
//! | `air` | state | air on both sides of the window, temperature of the wing |

mod air;
#[cfg(feature = "desk")]
mod condition;
mod icartt;
mod interpolate;
mod iwg1;
mod join;
mod layout;
mod mapping;
mod statements;
mod table;
mod tags;
mod times;
mod units;

pub use air::{flight_conditions, pressure_contradiction};
#[cfg(feature = "desk")]
pub use condition::FlightCondition;
pub use interpolate::MAX_NEAREST_S;
pub use join::{AircraftState, AircraftTrack, JoinedValue, ReceivedLine, UnusedLines, state_to_json};
pub use layout::{Cell, Layout, LineFormat, QuantityColumn, Sample};
pub use mapping::{MappedColumn, Mapping, StatedOnce, TableFormat};
pub use table::{AircraftTable, ColumnTally, TableContents};
pub use tags::impossible_delay_s;
pub use times::{DAY_S, TimeFormat, format_time, guess_format};

use serde::{Deserialize, Serialize};

/// Quantity of the aircraft data; its name has the unit as its suffix.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    Mach,
    /// Pressure altitude, m.
    PressureAltitudeM,
    /// Static temperature, degrees Celsius.
    StaticTemperatureC,
    /// Total temperature, degrees Celsius.
    TotalTemperatureC,
    /// Static pressure, hPa.
    StaticPressureHpa,
    /// Pressure in the cabin, hPa.
    CabinPressureHpa,
    /// Gross weight, kg.
    WeightKg,
    /// Fuel on board, kg.
    FuelKg,
    /// Load factor normal to the aircraft, g.
    LoadFactor,
    /// Flap setting, degrees.
    FlapDeg,
}

/// Number of quantities.
pub const QUANTITY_COUNT: usize = 10;

/// Name, range and standard deviation of a quantity.
struct QuantityTraits {
    name: &'static str,
    low: f64,
    high: f64,
    /// Standard deviation: a constant and a fraction of the value.
    sigma: (f64, f64),
}

/// Typical change of a quantity on an aircraft in service, as standard deviations.
#[derive(Clone, Copy, Debug)]
struct Motion {
    /// Standard deviation of the rate, per s.
    rate: f64,
    /// Standard deviation of the change of the rate, per s^2.
    acceleration: f64,
    /// Standard deviation of the quantity from its mean over a minute.
    spread: f64,
}

impl Quantity {
    /// Quantities in the order of exports.
    pub const ALL: [Self; QUANTITY_COUNT] = [
        Self::Mach,
        Self::PressureAltitudeM,
        Self::StaticTemperatureC,
        Self::TotalTemperatureC,
        Self::StaticPressureHpa,
        Self::CabinPressureHpa,
        Self::WeightKg,
        Self::FuelKg,
        Self::LoadFactor,
        Self::FlapDeg,
    ];

    /// Returns name, range and standard deviation.
    ///
    /// The standard deviations are assumptions: the accuracy of air data computers, cabin pressure controllers, fuel gauges
    /// and flight management systems in service, rounded up. Feeds write values outside the range for missing ones (-9999
    /// and the like).
    fn traits(self) -> QuantityTraits {
        let (name, low, high, sigma) = match self {
            Self::Mach => ("mach", 0.0, 3.0, (0.005, 0.0)),
            Self::PressureAltitudeM => ("pressure_altitude_m", -1000.0, 30_000.0, (20.0, 0.002)),
            Self::StaticTemperatureC => ("static_temperature_c", -110.0, 70.0, (1.0, 0.0)),
            Self::TotalTemperatureC => ("total_temperature_c", -110.0, 150.0, (0.5, 0.0)),
            Self::StaticPressureHpa => ("static_pressure_hpa", 10.0, 1100.0, (1.0, 0.0)),
            Self::CabinPressureHpa => ("cabin_pressure_hpa", 300.0, 1200.0, (5.0, 0.0)),
            Self::WeightKg => ("weight_kg", 100.0, 1e6, (0.0, 0.01)),
            Self::FuelKg => ("fuel_kg", 0.0, 5e5, (50.0, 0.02)),
            Self::LoadFactor => ("load_factor", -5.0, 10.0, (0.02, 0.0)),
            Self::FlapDeg => ("flap_deg", -20.0, 90.0, (0.5, 0.0)),
        };
        QuantityTraits { name, low, high, sigma }
    }

    /// Returns the name used in files.
    pub fn name(self) -> &'static str {
        self.traits().name
    }

    /// Returns the value if it is in the possible range.
    fn plausible(self, value: f64) -> Option<f64> {
        let belief = self.traits();
        (belief.low..=belief.high).contains(&value).then_some(value)
    }

    /// Returns the standard deviation of a value in such feeds.
    fn sigma(self, value: f64) -> f64 {
        let (absolute, share) = self.traits().sigma;
        absolute.hypot(share * value)
    }

    /// Returns the standard deviations of the quantity's rate, its change of rate, and its value.
    ///
    /// Assumptions: climbs of 3000 ft/min with level-offs of 0.05 g, accelerations of 1 m/s^2 and their effect on
    /// temperatures and pressures down to the ground, two large engines, turns and gusts, flaps in motion.
    fn motion(self) -> Motion {
        let (rate, bend, spread) = match self {
            Self::Mach => (0.003, 0.001, 0.1),
            Self::PressureAltitudeM => (15.0, 0.5, 1000.0),
            Self::StaticTemperatureC => (0.1, 0.005, 10.0),
            Self::TotalTemperatureC => (0.3, 0.02, 10.0),
            Self::StaticPressureHpa => (1.5, 0.06, 100.0),
            Self::CabinPressureHpa => (0.3, 0.05, 20.0),
            Self::WeightKg | Self::FuelKg => (3.0, 0.3, 300.0),
            Self::LoadFactor => (0.1, 0.1, 0.2),
            Self::FlapDeg => (2.0, 1.0, 15.0),
        };
        Motion { rate, acceleration: bend, spread }
    }

    /// Returns the index in [`Quantity::ALL`].
    fn index(self) -> usize {
        Self::ALL.iter().position(|q| *q == self).unwrap_or(0)
    }
}
