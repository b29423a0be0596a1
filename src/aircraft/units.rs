//! Units in headers and rows of units, compared with a mapping's scale.

use super::Quantity;

/// Physical dimension of a unit.
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

/// Unit names in lower case, with value = scale * number + offset in the unit of our quantities (m, degrees Celsius, hPa,
/// kg, g, degrees): the international foot and pound, and the conventional inch of mercury.
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

/// Largest relative difference between scales of the same unit.
const SCALE_TOLERANCE: f64 = 0.01;
/// Largest difference between offsets of the same unit, degrees.
const OFFSET_TOLERANCE: f64 = 1.0;

fn quantity_dimension(quantity: Quantity) -> Dimension {
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

/// Result of comparing a unit with a scale.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum UnitAgreement {
    /// The scale is that of the unit, or there is no unit.
    Same,
    /// The unit is unknown.
    Unknown,
    /// The unit requires this scale and offset.
    Different(f64, f64),
    /// The unit is not one of the quantity.
    WrongDimension,
}

/// Compares scale and offset of a quantity with the unit that a table names.
pub(super) fn compare_unit(quantity: Quantity, unit: &str, scale: f64, offset: f64) -> UnitAgreement {
    let unit = unit.trim().to_lowercase();
    if ["", "-", "1", "[-]", "n/a"].contains(&unit.as_str()) {
        return UnitAgreement::Same;
    }
    let wanted = quantity_dimension(quantity);
    let known: Vec<_> = UNITS.iter().filter(|(name, ..)| *name == unit).collect();
    match known.iter().find(|(_, dimension, ..)| *dimension == wanted) {
        None if known.is_empty() => UnitAgreement::Unknown,
        None => UnitAgreement::WrongDimension,
        Some((_, _, s, o)) if (scale / s - 1.0).abs() < SCALE_TOLERANCE && (offset - o).abs() < OFFSET_TOLERANCE => {
            UnitAgreement::Same
        }
        Some((_, _, s, o)) => UnitAgreement::Different(*s, *o),
    }
}

/// Returns the unit in a column's name: `ALT [ft]`, `ALT (ft)`.
pub(super) fn unit_in_name(name: &str) -> Option<&str> {
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
    fn a_unit_that_differs_from_the_mapping_is_noticed() {
        let of = |unit: &str, scale: f64| compare_unit(Quantity::PressureAltitudeM, unit, scale, 0.0);
        assert_eq!(of("ft", 0.3048), UnitAgreement::Same);
        assert_eq!(of("FT", 1.0), UnitAgreement::Different(0.3048, 0.0));
        assert_eq!(of("kg", 1.0), UnitAgreement::WrongDimension);
        assert_eq!((of("furlong", 1.0), of("-", 1.0)), (UnitAgreement::Unknown, UnitAgreement::Same));
        let kelvin = compare_unit(Quantity::StaticTemperatureC, "K", 1.0, 0.0);
        assert_eq!(kelvin, UnitAgreement::Different(1.0, -273.15));
        assert_eq!(
            (unit_in_name("ALT [ft]"), unit_in_name("SAT (degC) x"), unit_in_name("MACH")),
            (Some("ft"), Some("degC"), None)
        );
    }
}
