//! Units as headers and rows of units name them, held against a mapping's scale.

use super::Quantity;

/// What units are of.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Dimension {
    Length,
    Temperature,
    Pressure,
    Mass,
    Acceleration,
    Angle,
    None,
}

/// Names in small letters, value = scale * number + offset in the unit of our quantities (m, degrees Celsius, hPa, kg, g,
/// degrees): the international foot and pound, and the conventional inch of mercury.
const UNITS: [(&str, Dimension, f64, f64); 33] = [
    ("m", Dimension::Length, 1.0, 0.0),
    ("km", Dimension::Length, 1000.0, 0.0),
    ("ft", Dimension::Length, 0.3048, 0.0),
    ("feet", Dimension::Length, 0.3048, 0.0),
    ("fl", Dimension::Length, 30.48, 0.0),
    ("c", Dimension::Temperature, 1.0, 0.0),
    ("degc", Dimension::Temperature, 1.0, 0.0),
    ("deg c", Dimension::Temperature, 1.0, 0.0),
    ("°c", Dimension::Temperature, 1.0, 0.0),
    ("k", Dimension::Temperature, 1.0, -273.15),
    ("kelvin", Dimension::Temperature, 1.0, -273.15),
    ("f", Dimension::Temperature, 5.0 / 9.0, -160.0 / 9.0),
    ("degf", Dimension::Temperature, 5.0 / 9.0, -160.0 / 9.0),
    ("°f", Dimension::Temperature, 5.0 / 9.0, -160.0 / 9.0),
    ("hpa", Dimension::Pressure, 1.0, 0.0),
    ("mbar", Dimension::Pressure, 1.0, 0.0),
    ("mb", Dimension::Pressure, 1.0, 0.0),
    ("pa", Dimension::Pressure, 0.01, 0.0),
    ("kpa", Dimension::Pressure, 10.0, 0.0),
    ("psi", Dimension::Pressure, 68.947_573, 0.0),
    ("psia", Dimension::Pressure, 68.947_573, 0.0),
    ("inhg", Dimension::Pressure, 33.863_89, 0.0),
    ("kg", Dimension::Mass, 1.0, 0.0),
    ("t", Dimension::Mass, 1000.0, 0.0),
    ("lb", Dimension::Mass, 0.453_592_37, 0.0),
    ("lbs", Dimension::Mass, 0.453_592_37, 0.0),
    ("klb", Dimension::Mass, 453.592_37, 0.0),
    ("g", Dimension::Acceleration, 1.0, 0.0),
    ("m/s2", Dimension::Acceleration, 1.0 / 9.806_65, 0.0),
    ("deg", Dimension::Angle, 1.0, 0.0),
    ("°", Dimension::Angle, 1.0, 0.0),
    ("rad", Dimension::Angle, 57.295_78, 0.0),
    ("mach", Dimension::None, 1.0, 0.0),
];

/// Scales that differ by more are of different units.
const SAME: f64 = 0.01;
/// Offsets that differ by more, degrees.
const SAME_OFFSET: f64 = 1.0;

fn dimension(quantity: Quantity) -> Dimension {
    match quantity {
        Quantity::Mach => Dimension::None,
        Quantity::PressureAltitudeM => Dimension::Length,
        Quantity::StaticTemperatureC | Quantity::TotalTemperatureC => Dimension::Temperature,
        Quantity::StaticPressureHpa | Quantity::CabinPressureHpa => Dimension::Pressure,
        Quantity::WeightKg | Quantity::FuelKg => Dimension::Mass,
        Quantity::LoadFactor => Dimension::Acceleration,
        Quantity::FlapDeg => Dimension::Angle,
    }
}

/// How a unit's name and a scale go together.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Agreement {
    /// They do, or the name says nothing.
    Same,
    /// Nobody knows the name.
    Unknown,
    /// The unit asks for this scale and offset.
    Other(f64, f64),
    /// The unit is none of the quantity.
    NoneOfIt,
}

/// Whether the scale and offset of a quantity are those of the unit that a table names.
pub(super) fn agreement(quantity: Quantity, unit: &str, scale: f64, offset: f64) -> Agreement {
    let unit = unit.trim().to_lowercase();
    if ["", "-", "1", "[-]", "n/a"].contains(&unit.as_str()) {
        return Agreement::Same;
    }
    let wanted = dimension(quantity);
    let known: Vec<_> = UNITS.iter().filter(|(name, ..)| *name == unit).collect();
    match known.iter().find(|(_, dimension, ..)| *dimension == wanted) {
        None if known.is_empty() => Agreement::Unknown,
        None => Agreement::NoneOfIt,
        Some((_, _, s, o)) if (scale / s - 1.0).abs() < SAME && (offset - o).abs() < SAME_OFFSET => {
            Agreement::Same
        }
        Some((_, _, s, o)) => Agreement::Other(*s, *o),
    }
}

/// The unit in a column's name: `ALT [ft]`, `ALT (ft)`.
pub(super) fn in_name(name: &str) -> Option<&str> {
    let pairs = [('[', ']'), ('(', ')')];
    pairs.into_iter().find_map(|(open, close)| {
        let (_, rest) = name.split_once(open)?;
        rest.split_once(close).map(|(unit, _)| unit)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_that_is_not_the_mappings_is_noticed() {
        let of = |unit: &str, scale: f64| agreement(Quantity::PressureAltitudeM, unit, scale, 0.0);
        assert_eq!(of("ft", 0.3048), Agreement::Same);
        assert_eq!(of("FT", 1.0), Agreement::Other(0.3048, 0.0));
        assert_eq!(of("kg", 1.0), Agreement::NoneOfIt);
        assert_eq!((of("furlong", 1.0), of("-", 1.0)), (Agreement::Unknown, Agreement::Same));
        let kelvin = agreement(Quantity::StaticTemperatureC, "K", 1.0, 0.0);
        assert_eq!(kelvin, Agreement::Other(1.0, -273.15));
        assert_eq!(
            (in_name("ALT [ft]"), in_name("SAT (degC) x"), in_name("MACH")),
            (Some("ft"), Some("degC"), None)
        );
    }
}
