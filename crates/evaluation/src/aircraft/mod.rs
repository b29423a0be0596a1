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
pub use interpolate::MAX_NEAREST_S;
pub use join::{
    AircraftState, AircraftTrack, JoinedValue, ReceivedLine, UnusedLines, state_to_json,
};
pub use layout::{Cell, Layout, LineFormat, QuantityColumn, Sample};
pub use mapping::{MappedColumn, Mapping, StatedOnce, TableFormat};
pub use table::{AircraftTable, ColumnTally, TableContents};
pub use tags::impossible_delay_s;
pub use times::{DAY_S, TimeFormat, format_time, guess_format};

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use self::units::Dimension;

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
    /// Angle of attack, degrees.
    AngleOfAttackDeg,
    /// Sideslip angle, degrees, positive with wind from the right.
    SideslipDeg,
    /// Calibrated airspeed, m/s.
    CalibratedAirspeedMS,
    /// True airspeed, m/s.
    TrueAirspeedMS,
    /// Centre of gravity, per cent of the mean aerodynamic chord.
    CentreOfGravityPercent,
    /// Aileron deflection of the measured wing, degrees, positive trailing edge down.
    AileronDeg,
    /// Spoiler deflection of the measured wing, degrees.
    SpoilerDeg,
}

/// Number of quantities.
pub const QUANTITY_COUNT: usize = 17;

/// Properties of a quantity.
struct QuantityTraits {
    quantity: Quantity,
    name: &'static str,
    dimension: Dimension,
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

const fn traits(
    quantity: Quantity,
    name: &'static str,
    dimension: Dimension,
    range: RangeInclusive<f64>,
    sigma: (f64, f64),
    (rate, acceleration, spread): (f64, f64, f64),
) -> QuantityTraits {
    QuantityTraits {
        quantity,
        name,
        dimension,
        range,
        sigma,
        motion: Motion {
            rate,
            acceleration,
            spread,
        },
    }
}

/// Quantities in the order of exports, with name, dimension, range, standard deviation and motion.
///
/// The standard deviations are assumptions: the accuracy of air data computers, cabin pressure controllers, fuel gauges,
/// flight management systems and position sensors in service, rounded up. The motions assume climbs of 3000 ft/min with
/// level-offs of 0.05 g, accelerations of 1 m/s^2 and their effect on temperatures and pressures down to the ground, two
/// large engines, turns and gusts, flaps and control surfaces in motion.
static QUANTITIES: [QuantityTraits; QUANTITY_COUNT] = {
    use Dimension::{
        Acceleration, Angle, Length, Mass, Percent, Pressure, Pure, Speed, Temperature,
    };
    use Quantity::*;
    [
        traits(
            Mach,
            "mach",
            Pure,
            0.0..=3.0,
            (0.005, 0.0),
            (0.003, 0.001, 0.1),
        ),
        traits(
            PressureAltitudeM,
            "pressure_altitude_m",
            Length,
            -1e3..=3e4,
            (20.0, 0.002),
            (15.0, 0.5, 1000.0),
        ),
        traits(
            StaticTemperatureC,
            "static_temperature_c",
            Temperature,
            -110.0..=70.0,
            (1.0, 0.0),
            (0.1, 0.005, 10.0),
        ),
        traits(
            TotalTemperatureC,
            "total_temperature_c",
            Temperature,
            -110.0..=150.0,
            (0.5, 0.0),
            (0.3, 0.02, 10.0),
        ),
        traits(
            StaticPressureHpa,
            "static_pressure_hpa",
            Pressure,
            10.0..=1100.0,
            (1.0, 0.0),
            (1.5, 0.06, 100.0),
        ),
        traits(
            CabinPressureHpa,
            "cabin_pressure_hpa",
            Pressure,
            300.0..=1200.0,
            (5.0, 0.0),
            (0.3, 0.05, 20.0),
        ),
        traits(
            WeightKg,
            "weight_kg",
            Mass,
            100.0..=1e6,
            (0.0, 0.01),
            (3.0, 0.3, 300.0),
        ),
        traits(
            FuelKg,
            "fuel_kg",
            Mass,
            0.0..=5e5,
            (50.0, 0.02),
            (3.0, 0.3, 300.0),
        ),
        traits(
            LoadFactor,
            "load_factor",
            Acceleration,
            -5.0..=10.0,
            (0.02, 0.0),
            (0.1, 0.1, 0.2),
        ),
        traits(
            FlapDeg,
            "flap_deg",
            Angle,
            -20.0..=90.0,
            (0.5, 0.0),
            (2.0, 1.0, 15.0),
        ),
        traits(
            AngleOfAttackDeg,
            "angle_of_attack_deg",
            Angle,
            -30.0..=60.0,
            (0.3, 0.0),
            (1.0, 1.0, 3.0),
        ),
        traits(
            SideslipDeg,
            "sideslip_deg",
            Angle,
            -45.0..=45.0,
            (0.5, 0.0),
            (1.0, 1.0, 2.0),
        ),
        traits(
            CalibratedAirspeedMS,
            "calibrated_airspeed_m_s",
            Speed,
            0.0..=600.0,
            (2.0, 0.0),
            (1.0, 0.3, 30.0),
        ),
        traits(
            TrueAirspeedMS,
            "true_airspeed_m_s",
            Speed,
            0.0..=1000.0,
            (2.0, 0.005),
            (1.0, 0.3, 30.0),
        ),
        traits(
            CentreOfGravityPercent,
            "centre_of_gravity_percent",
            Percent,
            -50.0..=150.0,
            (1.0, 0.0),
            (0.01, 0.01, 2.0),
        ),
        traits(
            AileronDeg,
            "aileron_deg",
            Angle,
            -60.0..=60.0,
            (0.5, 0.0),
            (10.0, 30.0, 5.0),
        ),
        traits(
            SpoilerDeg,
            "spoiler_deg",
            Angle,
            -10.0..=90.0,
            (0.5, 0.0),
            (15.0, 30.0, 20.0),
        ),
    ]
};

impl Quantity {
    /// Quantities in the order of exports.
    pub const ALL: [Self; QUANTITY_COUNT] = {
        let mut all = [Self::Mach; QUANTITY_COUNT];
        let mut k = 0;
        while k < QUANTITY_COUNT {
            all[k] = QUANTITIES[k].quantity;
            assert!(
                all[k] as usize == k,
                "the rows are in the order of the variants"
            );
            k += 1;
        }
        all
    };

    fn traits(self) -> &'static QuantityTraits {
        &QUANTITIES[self as usize]
    }

    /// Returns the name used in files.
    pub fn name(self) -> &'static str {
        self.traits().name
    }

    fn dimension(self) -> Dimension {
        self.traits().dimension
    }

    /// Returns the value if it is in the possible range.
    fn plausible(self, value: f64) -> Option<f64> {
        self.traits().range.contains(&value).then_some(value)
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
