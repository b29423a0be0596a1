//! Aircraft data: lines of a feed or a file, joined with frames by their time tags (docs/aircraft-data.md).
//!
//! | file | from | to |
//! |---|---|---|
//! | `table` | table | layout and lines, contents of the cells, errors |
//! | `times` | time tag | seconds since 1970 |
//! | `layout` | line of text, positions of its fields | sample: time tag and quantities |
//! | `tags` | tags and receipt times of their lines | impossible tags |
//! | `interpolate` | values of a quantity around a time | value at that time, possible change between the tags |
//! | `join` | samples, time of a frame | state with standard deviations |
//! | `air` | state | air on both sides of the window, temperature of the wing |

mod air;
mod interpolate;
mod join;
mod layout;
mod table;
mod tags;
mod times;

pub use air::flight_conditions;
pub use interpolate::MAX_NEAREST_S;
pub use join::{AircraftState, AircraftTrack, JoinedValue, UnusedLines};
pub use layout::{Layout, LineFormat, QuantityColumn, Sample};
pub use table::{AircraftTable, ColumnTally, TableContents};
pub use tags::impossible_delay_s;
pub use times::format_time;

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

/// Declares the quantities in the order of exports. A row has the description of a variant, the name in files with the unit as
/// its suffix, the possible range, the standard deviation (a constant and a fraction of the value), and the motion.
macro_rules! quantities {
    ($($(#[$meaning:meta])* $quantity:ident = $name:literal, $range:expr, $sigma:expr, $motion:expr;)*) => {
        /// Quantity of the aircraft data.
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
        )]
        pub enum Quantity {
            $($(#[$meaning])* #[serde(rename = $name)] $quantity,)*
        }

        /// Number of quantities.
        pub const QUANTITY_COUNT: usize = NAMES.len();

        /// Names in files.
        const NAMES: &[&str] = &[$($name),*];

        static TRAITS: [QuantityTraits; QUANTITY_COUNT] = [$(QuantityTraits {
            range: $range,
            sigma: $sigma,
            motion: $motion,
        }),*];

        impl Quantity {
            /// Quantities in the order of exports.
            pub const ALL: [Self; QUANTITY_COUNT] = [$(Self::$quantity),*];
        }
    };
}

/// Properties of a quantity.
struct QuantityTraits {
    /// Possible range. Feeds write values outside it for missing ones (-9999 and the like).
    range: RangeInclusive<f64>,
    /// Standard deviation: a constant and a fraction of the value.
    sigma: (f64, f64),
    motion: Motion,
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

const fn motion(rate: f64, acceleration: f64, spread: f64) -> Motion {
    Motion {
        rate,
        acceleration,
        spread,
    }
}

// The standard deviations are assumptions: the accuracy of air data computers, cabin pressure controllers, fuel gauges,
// flight management systems and position sensors in service, rounded up. The motions assume climbs of 3000 ft/min with
// level-offs of 0.05 g, accelerations of 1 m/s^2 and their effect on temperatures and pressures down to the ground, two
// large engines, turns and gusts, flaps and control surfaces in motion.
quantities! {
    Mach = "mach", 0.0..=3.0, (0.005, 0.0), motion(0.003, 0.001, 0.1);
    /// Pressure altitude, m.
    PressureAltitudeM = "pressure_altitude_m", -1e3..=3e4, (20.0, 0.002), motion(15.0, 0.5, 1000.0);
    /// Static temperature, degrees Celsius.
    StaticTemperatureC = "static_temperature_c", -110.0..=70.0, (1.0, 0.0), motion(0.1, 0.005, 10.0);
    /// Total temperature, degrees Celsius.
    TotalTemperatureC = "total_temperature_c", -110.0..=150.0, (0.5, 0.0), motion(0.3, 0.02, 10.0);
    /// Static pressure, hPa.
    StaticPressureHpa = "static_pressure_hpa", 10.0..=1100.0, (1.0, 0.0), motion(1.5, 0.06, 100.0);
    /// Pressure in the cabin, hPa.
    CabinPressureHpa = "cabin_pressure_hpa", 300.0..=1200.0, (5.0, 0.0), motion(0.3, 0.05, 20.0);
    /// Gross weight, kg.
    WeightKg = "weight_kg", 100.0..=1e6, (0.0, 0.01), motion(3.0, 0.3, 300.0);
    /// Fuel on board, kg.
    FuelKg = "fuel_kg", 0.0..=5e5, (50.0, 0.02), motion(3.0, 0.3, 300.0);
    /// Load factor normal to the aircraft, g.
    LoadFactor = "load_factor", -5.0..=10.0, (0.02, 0.0), motion(0.1, 0.1, 0.2);
    /// Flap setting, degrees.
    FlapDeg = "flap_deg", -20.0..=90.0, (0.5, 0.0), motion(2.0, 1.0, 15.0);
    /// Angle of attack, degrees.
    AngleOfAttackDeg = "angle_of_attack_deg", -30.0..=60.0, (0.3, 0.0), motion(1.0, 1.0, 3.0);
    /// Sideslip angle, degrees, positive with wind from the right.
    SideslipDeg = "sideslip_deg", -45.0..=45.0, (0.5, 0.0), motion(1.0, 1.0, 2.0);
    /// Calibrated airspeed, m/s.
    CalibratedAirspeedMS = "calibrated_airspeed_m_s", 0.0..=600.0, (2.0, 0.0), motion(1.0, 0.3, 30.0);
    /// True airspeed, m/s.
    TrueAirspeedMS = "true_airspeed_m_s", 0.0..=1000.0, (2.0, 0.005), motion(1.0, 0.3, 30.0);
    /// Centre of gravity, per cent of the mean aerodynamic chord.
    CentreOfGravityPercent = "centre_of_gravity_percent", -50.0..=150.0, (1.0, 0.0), motion(0.01, 0.01, 2.0);
    /// Aileron deflection of the measured wing, degrees, positive trailing edge down.
    AileronDeg = "aileron_deg", -60.0..=60.0, (0.5, 0.0), motion(10.0, 30.0, 5.0);
    /// Spoiler deflection of the measured wing, degrees.
    SpoilerDeg = "spoiler_deg", -10.0..=90.0, (0.5, 0.0), motion(15.0, 30.0, 20.0);
}

impl Quantity {
    fn traits(self) -> &'static QuantityTraits {
        &TRAITS[self as usize]
    }

    /// Returns the name used in files.
    pub fn name(self) -> &'static str {
        NAMES[self as usize]
    }

    /// Returns the value if it is in the possible range.
    fn plausible(self, value: Option<f64>) -> Option<f64> {
        value.filter(|value| self.traits().range.contains(value))
    }

    /// Returns the standard deviation of a value in such feeds.
    fn sigma(self, value: f64) -> f64 {
        let (absolute, share) = self.traits().sigma;
        absolute.hypot(share * value)
    }

    /// Returns the standard deviations of the quantity's rate, its change of rate, and its value.
    fn motion(self) -> Motion {
        self.traits().motion
    }

    /// Returns the index in [`Quantity::ALL`].
    fn index(self) -> usize {
        self as usize
    }
}
