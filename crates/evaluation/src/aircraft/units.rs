//! Units in headers and rows of units, compared with a mapping's scale.

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
    /// Dimension of none of our quantities.
    Other,
}

/// Units by their names in lower case without blanks, points and underscores, with value = scale * number + offset in the
/// unit of our quantities (m, degrees Celsius, hPa, kg, g, degrees, m/s): the international foot and pound, and the conventional
/// inch of mercury.
const UNITS: [(&str, Dimension, f64, f64); 37] = [
    ("m meter meters metre metres", Dimension::Length, 1.0, 0.0),
    ("km", Dimension::Length, 1000.0, 0.0),
    ("ft foot feet", Dimension::Length, 0.3048, 0.0),
    ("kft", Dimension::Length, 304.8, 0.0),
    ("fl hft", Dimension::Length, 30.48, 0.0),
    ("c degc celsius", Dimension::Temperature, 1.0, 0.0),
    ("k degk kelvin", Dimension::Temperature, 1.0, -273.15),
    (
        "f degf fahrenheit",
        Dimension::Temperature,
        5.0 / 9.0,
        -160.0 / 9.0,
    ),
    ("r degr rankine", Dimension::Temperature, 5.0 / 9.0, -273.15),
    (
        "hpa mbar mb millibar millibars",
        Dimension::Pressure,
        1.0,
        0.0,
    ),
    ("pa pascal", Dimension::Pressure, 0.01, 0.0),
    ("kpa", Dimension::Pressure, 10.0, 0.0),
    ("bar bars", Dimension::Pressure, 1000.0, 0.0),
    (
        "psi psia lb/in2 lbf/in2",
        Dimension::Pressure,
        68.947_573,
        0.0,
    ),
    ("psf lb/ft2 lbf/ft2", Dimension::Pressure, 0.478_802_59, 0.0),
    (
        "inhg incheshg inchhg inchesofmercury",
        Dimension::Pressure,
        33.863_89,
        0.0,
    ),
    ("mmhg torr", Dimension::Pressure, 1.333_223_7, 0.0),
    ("kg kgs kilograms", Dimension::Mass, 1.0, 0.0),
    ("t tonne tonnes", Dimension::Mass, 1000.0, 0.0),
    (
        "lb lbs lbm pound pounds",
        Dimension::Mass,
        0.453_592_37,
        0.0,
    ),
    ("klb klbs", Dimension::Mass, 453.592_37, 0.0),
    ("g gs", Dimension::Acceleration, 1.0, 0.0),
    (
        "m/s2 m/s^2 m/s²",
        Dimension::Acceleration,
        1.0 / 9.806_65,
        0.0,
    ),
    (
        "ft/s2 ft/s^2",
        Dimension::Acceleration,
        0.3048 / 9.806_65,
        0.0,
    ),
    ("deg degree degrees", Dimension::Angle, 1.0, 0.0),
    ("rad radian radians", Dimension::Angle, 57.295_78, 0.0),
    ("mrad", Dimension::Angle, 0.057_295_78, 0.0),
    ("mach m", Dimension::Pure, 1.0, 0.0),
    ("% percent", Dimension::Pure, 0.01, 0.0),
    ("% percent %mac %rc mac", Dimension::Percent, 1.0, 0.0),
    (
        "gal gallon gallons usgal l liter liters litre litres",
        Dimension::Other,
        1.0,
        0.0,
    ),
    ("m/s ms-1", Dimension::Speed, 1.0, 0.0),
    ("kt kts knot knots", Dimension::Speed, 1852.0 / 3600.0, 0.0),
    ("km/h kph", Dimension::Speed, 1.0 / 3.6, 0.0),
    ("mph", Dimension::Speed, 0.44704, 0.0),
    ("ft/s fps", Dimension::Speed, 0.3048, 0.0),
    ("s sec", Dimension::Other, 1.0, 0.0),
];

/// Words behind a unit that give its reference, not another unit.
const REFERENCES: [&str; 12] = [
    "baro",
    "msl",
    "amsl",
    "agl",
    "std",
    "abs",
    "absolute",
    "gps",
    "pressure",
    "indicated",
    "true",
    "normal",
];

/// Largest relative difference between scales of the same unit.
const SCALE_TOLERANCE: f64 = 0.01;
/// Largest difference between offsets of the same unit, degrees.
const OFFSET_TOLERANCE: f64 = 1.0;

/// Meaning of a text as a unit of a quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum UnitMeaning {
    /// Unit of the quantity: scale and offset.
    Known(f64, f64),
    /// Unit of another quantity.
    WrongDimension,
    /// No text, or a sign for none.
    Absent,
    /// Text that is not a known unit.
    Unknown,
}

impl UnitMeaning {
    /// Returns scale and offset of a known unit.
    pub fn conversion(self) -> Option<(f64, f64)> {
        if let Self::Known(scale, offset) = self {
            Some((scale, offset))
        } else {
            None
        }
    }
}

/// Returns whether two pairs of scale and offset are of one unit.
pub(super) fn same_conversion(a: (f64, f64), b: (f64, f64)) -> bool {
    (a.0 / b.0 - 1.0).abs() < SCALE_TOLERANCE && (a.1 - b.1).abs() < OFFSET_TOLERANCE
}

/// Finds a unit in any usual spelling: `deg F`, `°F`, `Fahrenheit`, `ft.`, `ft Baro`, `inches Hg`.
pub(super) fn find_unit(quantity: Quantity, text: &str) -> UnitMeaning {
    let text = text
        .to_lowercase()
        .replace(['°', 'º'], "deg ")
        .replace("degrees ", "deg ");
    let words = text.split(|c: char| c.is_whitespace() || "._[]()".contains(c));
    let mut words: Vec<&str> = words.filter(|w| !w.is_empty()).collect();
    while words.len() > 1 && words.last().is_some_and(|last| REFERENCES.contains(last)) {
        words.pop();
    }
    let name = words.concat();
    if ["", "-", "1", "n/a", "none"].contains(&name.as_str()) {
        return UnitMeaning::Absent;
    }
    let wanted = quantity.dimension();
    let mut known = UNITS
        .iter()
        .filter(|(names, ..)| names.split(' ').any(|n| n == name))
        .peekable();
    let any = known.peek().is_some();
    match known.find(|(_, dimension, ..)| *dimension == wanted) {
        Some((_, _, scale, offset)) => UnitMeaning::Known(*scale, *offset),
        None if any => UnitMeaning::WrongDimension,
        None => UnitMeaning::Unknown,
    }
}

/// Returns the unit in a column's name: `ALT [ft]`, `ALT (ft)`.
pub(super) fn unit_in_brackets(name: &str) -> Option<&str> {
    let pairs = [('[', ']'), ('(', ')')];
    pairs.into_iter().find_map(|(open, close)| {
        let (_, rest) = name.split_once(open)?;
        rest.split_once(close).map(|(unit, _)| unit)
    })
}

/// Returns the unit at the end of a column's name, if it is one of the quantity: `ALT_FT`, `OAT degF`, `Alt / ft`. A single
/// letter is no unit.
pub(super) fn unit_suffix(quantity: Quantity, name: &str) -> Option<&str> {
    let (before, last) = name.rsplit_once(['_', ' ', '/', '.', ','])?;
    let known =
        last.len() > 1 && !before.is_empty() && find_unit(quantity, last).conversion().is_some();
    // The name of a quantity without a unit is not one.
    (known && quantity != Quantity::Mach).then_some(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_found_in_any_spelling() {
        let of = |unit: &str| find_unit(Quantity::PressureAltitudeM, unit);
        for text in ["ft", "FT", "foot", "feet", "ft.", "ft Baro", "ft msl"] {
            assert_eq!(of(text), UnitMeaning::Known(0.3048, 0.0), "{text}");
        }
        assert_eq!(of("kft"), UnitMeaning::Known(304.8, 0.0));
        assert_eq!(
            (of("kg"), of("in Hg")),
            (UnitMeaning::WrongDimension, UnitMeaning::WrongDimension)
        );
        assert_eq!(
            (of("furlong"), of("-"), of("")),
            (
                UnitMeaning::Unknown,
                UnitMeaning::Absent,
                UnitMeaning::Absent
            )
        );
        for text in ["deg F", "degF", "° F", "°F", "Fahrenheit", "degrees F", "F"] {
            let (scale, offset) = find_unit(Quantity::StaticTemperatureC, text)
                .conversion()
                .unwrap_or_default();
            assert!(
                (scale * 19.4 + offset + 7.0).abs() < 1e-9,
                "{text}: {scale} {offset}"
            );
        }
        assert_eq!(
            find_unit(Quantity::StaticTemperatureC, "deg K"),
            UnitMeaning::Known(1.0, -273.15)
        );
        for text in ["in Hg", "inHg", "inches Hg"] {
            assert_eq!(
                find_unit(Quantity::StaticPressureHpa, text),
                UnitMeaning::Known(33.863_89, 0.0),
                "{text}"
            );
        }
        assert_eq!(find_unit(Quantity::Mach, "M"), UnitMeaning::Known(1.0, 0.0));
        assert!(
            same_conversion((0.3048, 0.0), (0.305, 0.0))
                && !same_conversion((1.0, 0.0), (1.0, -273.15))
        );
    }

    #[test]
    fn units_are_found_in_names() {
        let altitude = Quantity::PressureAltitudeM;
        assert_eq!(unit_in_brackets("ALT [ft]"), Some("ft"));
        assert_eq!(
            (unit_in_brackets("SAT (degC) x"), unit_in_brackets("MACH")),
            (Some("degC"), None)
        );
        assert_eq!(
            (
                unit_suffix(altitude, "ALT_FT"),
                unit_suffix(altitude, "Alt_m")
            ),
            (Some("FT"), None)
        );
        assert_eq!(
            (
                unit_suffix(altitude, "AltB"),
                unit_suffix(Quantity::Mach, "MACH_1")
            ),
            (None, None)
        );
    }
}
