//! A layout says where the fields of a line stand, and reads the line as a sample. Pure.

use serde::{Deserialize, Serialize};

use super::{QUANTITIES, Quantity};

/// How a feed's lines are made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// IWG1: 33 fields in a fixed order, a platform's own after them.
    #[default]
    Iwg1,
    /// Text with separators, as `column` says.
    Text,
}

/// A field that is taken.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Column {
    /// From 1.
    pub field: usize,
    /// What it is.
    pub quantity: Quantity,
    /// Value = scale * field + offset.
    #[serde(default = "one")]
    pub scale: f64,
    /// As above.
    #[serde(default)]
    pub offset: f64,
}

fn one() -> f64 {
    1.0
}

/// Where the fields of a line stand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layout {
    /// Lines that do not have this as their first field are not read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begins_with: Option<String>,
    /// Between the fields.
    pub separator: char,
    /// The time tag's field, from 1: ISO 8601 (UTC where it has no zone), or seconds since 1970.
    pub time_field: usize,
    /// What is taken; of two with one quantity the later.
    pub column: Vec<Column>,
}

const M_PER_FOOT: f64 = 0.3048;

/// IWG1's own fields (www.eol.ucar.edu/raf/Software/IWG1_Def.html).
const IWG1: [(usize, Quantity, f64); 6] = [
    (7, Quantity::PressureAltitudeM, M_PER_FOOT),
    (12, Quantity::Mach, 1.0),
    (21, Quantity::StaticTemperatureC, 1.0),
    (23, Quantity::TotalTemperatureC, 1.0),
    (24, Quantity::StaticPressureHpa, 1.0),
    (26, Quantity::CabinPressureHpa, 1.0),
];

impl Layout {
    /// IWG1 with a platform's own fields.
    pub fn iwg1(own: &[Column]) -> Self {
        let fixed = IWG1.map(|(field, quantity, scale)| Column { field, quantity, scale, offset: 0.0 });
        let column = fixed.iter().chain(own).copied().collect();
        Self { begins_with: Some("IWG1".to_owned()), separator: ',', time_field: 2, column }
    }

    /// A line as a sample; `None` where it is none of these lines or has no time.
    pub fn read(&self, line: &str) -> Option<Sample> {
        let fields: Vec<&str> = line.trim().split(self.separator).map(str::trim).collect();
        if self.begins_with.as_deref().is_some_and(|word| fields.first() != Some(&word)) {
            return None;
        }
        let field = |number: usize| fields.get(number.checked_sub(1)?).copied();
        let mut sample = Sample { time_s: time(field(self.time_field)?)?, values: [None; QUANTITIES] };
        for column in &self.column {
            let number = field(column.field).and_then(|text| text.parse::<f64>().ok());
            let value = number.map(|n| column.scale * n + column.offset);
            sample.values[column.quantity.index()] = value.and_then(|v| column.quantity.believable(v));
        }
        Some(sample)
    }
}

/// Seconds since 1970 of a time tag.
fn time(text: &str) -> Option<f64> {
    let utc = |civil: jiff::civil::DateTime| civil.to_zoned(jiff::tz::TimeZone::UTC).map(|z| z.timestamp());
    if let Ok(number) = text.parse::<f64>() {
        return Some(number).filter(|s| s.is_finite() && *s > 0.0);
    }
    let stamp = text.parse::<jiff::Timestamp>().ok();
    stamp.or_else(|| utc(text.parse::<jiff::civil::DateTime>().ok()?).ok()).map(seconds)
}

/// Seconds since 1970.
pub(super) fn seconds(stamp: jiff::Timestamp) -> f64 {
    stamp.as_microsecond() as f64 * 1e-6
}

/// What a line says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Its time tag, UTC, seconds since 1970.
    pub time_s: f64,
    /// By [`Quantity::ALL`]; `None` where the line does not say.
    pub values: [Option<f64>; QUANTITIES],
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const LINE: &str = "IWG1,2026-03-01T06:00:00.5,52.1,11.2,11300,11345,36089,,230.1,228.9,265,0.78,0.1,90,90,0,2.5,0.3,0,2.6,-56.5,-70,-28.2,226.3,110.1,790.5,20,270,0,60,30,100,10,64100,18200";

    #[test]
    fn an_iwg1_line_gives_its_fields_in_our_units() {
        let own = [Column { field: 34, quantity: Quantity::WeightKg, scale: 1.0, offset: 0.0 }];
        let sample = Layout::iwg1(&own).read(LINE).unwrap();
        let of = |q: Quantity| sample.values[q.index()];
        assert_eq!(sample.time_s, 1_772_344_800.5);
        assert!((of(Quantity::PressureAltitudeM).unwrap() - 10_999.9).abs() < 0.1);
        assert_eq!(of(Quantity::Mach), Some(0.78));
        assert_eq!(of(Quantity::StaticTemperatureC), Some(-56.5));
        assert_eq!(of(Quantity::StaticPressureHpa), Some(226.3));
        assert_eq!(of(Quantity::CabinPressureHpa), Some(790.5));
        assert_eq!((of(Quantity::WeightKg), of(Quantity::FuelKg)), (Some(64_100.0), None));
    }

    #[test]
    fn what_is_no_value_is_none_and_what_is_no_line_is_left() {
        let layout = Layout::iwg1(&[]);
        let empty = layout.read("IWG1,20260301T060000,,,,,-9999,,,,,NaN,,,,,,,,,,,,,,\r\n").unwrap();
        assert_eq!((empty.time_s, empty.values), (1_772_344_800.0, [None; QUANTITIES]));
        for bad in ["", "IWG1", "IWG1,yesterday,1,2", "IWG2,2026-03-01T06:00:00,1", "\u{fffd},,,"] {
            assert_eq!(layout.read(bad), None, "{bad}");
        }
    }

    #[test]
    fn text_is_read_as_its_columns_say() {
        let kelvin = Column { field: 3, quantity: Quantity::TotalTemperatureC, scale: 1.0, offset: -273.15 };
        let layout = Layout { begins_with: None, separator: ';', time_field: 1, column: vec![kelvin] };
        let sample = layout.read("1772344800.25;x;250.15").unwrap();
        assert_eq!(sample.time_s, 1_772_344_800.25);
        assert!((sample.values[Quantity::TotalTemperatureC.index()].unwrap() + 23.0).abs() < 1e-9);
        let zone = layout.read("2026-03-01T07:00:00+01:00;x;1").unwrap();
        assert_eq!(zone.time_s, 1_772_344_800.0);
    }

    proptest::proptest! {
        #[test]
        fn any_text_is_survived(text in ".{0,200}") {
            let _ = Layout::iwg1(&[]).read(&text);
            let _ = Layout::iwg1(&[]).read(&format!("IWG1,2026-03-01T06:00:00,{text}"));
        }
    }
}
