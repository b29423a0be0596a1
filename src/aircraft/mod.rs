//! The aircraft's own data: lines of a feed or a file, joined with frames by their time tags (docs/aircraft-data.md).
//!
//! | file | from | to |
//! |---|---|---|
//! | `mapping` | the file that a user writes about a table | which column is which quantity |
//! | `table`, `iwg1`, `units` | a table's text, its mapping | layout and lines, what the cells hold, what is to be mended |
//! | `times` | a time tag | seconds since 1970; what tags are that are none |
//! | `layout` | a line of text, where its fields stand | sample: time tag and quantities |
//! | `tags` | tags and when their lines came | which tags cannot be true |
//! | `between` | a quantity's values about an instant | its value there, and what may lie between the tags |
//! | `join` | samples, a frame's instant | state with standard deviations |
//! | `air` | state | air on both sides of the window, the wing's temperature |

mod air;
mod interpolate;
mod iwg1;
mod join;
mod layout;
mod mapping;
mod table;
mod tags;
mod times;
mod units;

pub use air::{conditions, contradiction};
pub use join::{Joined, Received, State, Track, Unused, named};
pub use layout::{Cell, Column, Kind, Layout, Sample};
pub use mapping::{Mapping, Named};
pub use table::{Contents, Table, Tally};
pub use tags::impossible;
pub use times::{DAY_S, TimeFormat, likeliest, shown};

use serde::{Deserialize, Serialize};

/// What is taken from the aircraft's data; the name bears the unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Mach number.
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

/// How many there are.
pub const QUANTITIES: usize = 10;

/// What is believed of a quantity.
struct Belief {
    name: &'static str,
    low: f64,
    high: f64,
    /// Standard deviation as an absolute and as a share of the value.
    sigma: (f64, f64),
}

/// How a quantity changes on an aircraft in service, as a standard deviation.
#[derive(Clone, Copy, Debug)]
struct Motion {
    /// Of its rate, per s.
    rate: f64,
    /// Of the rate's own rate, per s^2.
    bend: f64,
    /// Of the quantity about its mean over a minute.
    spread: f64,
}

impl Quantity {
    /// In the order of exports.
    pub const ALL: [Self; QUANTITIES] = [
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

    /// Widths are assumptions: what air data computers, cabin pressure controllers, fuel gauges and flight management
    /// hold in service, rounded up. Values out of the range are what feeds write for none (-9999 and the like).
    fn belief(self) -> Belief {
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
        Belief { name, low, high, sigma }
    }

    /// As in files.
    pub fn name(self) -> &'static str {
        self.belief().name
    }

    /// The value, where it can be true.
    fn believable(self, value: f64) -> Option<f64> {
        let belief = self.belief();
        (belief.low..=belief.high).contains(&value).then_some(value)
    }

    /// Standard deviation of a value as such feeds give it.
    fn sigma(self, value: f64) -> f64 {
        let (absolute, share) = self.belief().sigma;
        absolute.hypot(share * value)
    }

    /// Assumptions: climbs of 3000 ft/min with level-offs of 0.05 g, accelerations of 1 m/s^2 and what they do to temperatures
    /// and pressures up to the ground's, two large engines, turns and gusts, flaps on their way.
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
        Motion { rate, bend, spread }
    }

    /// Place in [`Quantity::ALL`].
    fn index(self) -> usize {
        Self::ALL.iter().position(|q| *q == self).unwrap_or(0)
    }
}
