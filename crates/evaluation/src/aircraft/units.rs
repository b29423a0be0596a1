//! Units in the names of quantities in conditions, such as `weight_t`.

use super::Quantity;

/// Physical dimension of a unit.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Dimension {
    Length,
    Temperature,
    Pressure,
    Mass,
    Acceleration,
    Angle,
    Speed,
    /// Number without a unit.
    Pure,
    Percent,
}

/// Units with value = scale * number + offset in the unit of our quantities (m, degrees Celsius, hPa, kg, degrees, m/s):
/// the international foot and pound, and the conventional inch of mercury.
const UNITS: [(&str, Dimension, f64, f64); 17] = [
    ("km", Dimension::Length, 1000.0, 0.0),
    ("ft", Dimension::Length, 0.3048, 0.0),
    ("kft", Dimension::Length, 304.8, 0.0),
    ("fl", Dimension::Length, 30.48, 0.0),
    ("k", Dimension::Temperature, 1.0, -273.15),
    ("f", Dimension::Temperature, 5.0 / 9.0, -160.0 / 9.0),
    ("pa", Dimension::Pressure, 0.01, 0.0),
    ("kpa", Dimension::Pressure, 10.0, 0.0),
    ("psi", Dimension::Pressure, 68.947_573, 0.0),
    ("inhg", Dimension::Pressure, 33.863_89, 0.0),
    ("t", Dimension::Mass, 1000.0, 0.0),
    ("lb", Dimension::Mass, 0.453_592_37, 0.0),
    ("klb", Dimension::Mass, 453.592_37, 0.0),
    ("rad", Dimension::Angle, 57.295_78, 0.0),
    ("mrad", Dimension::Angle, 0.057_295_78, 0.0),
    ("kt", Dimension::Speed, 1852.0 / 3600.0, 0.0),
    ("mph", Dimension::Speed, 0.44704, 0.0),
];

/// Returns scale and offset of a unit of a quantity.
pub(super) fn find_unit(quantity: Quantity, name: &str) -> Option<(f64, f64)> {
    let of = |(unit, dimension, ..): &&(&str, Dimension, f64, f64)| {
        *unit == name && *dimension == quantity.dimension()
    };
    UNITS
        .iter()
        .find(of)
        .map(|(_, _, scale, offset)| (*scale, *offset))
}
