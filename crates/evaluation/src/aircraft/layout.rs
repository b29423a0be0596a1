//! Layout of a feed's lines: positions of the fields, and conversion of a line into a sample. Pure.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::times::parse_time;
use super::{QUANTITY_COUNT, Quantity};
use crate::installation::parse_rows;

/// Format of a feed's lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LineFormat {
    /// IWG1: 33 fields in a fixed order, followed by those of the platform.
    #[default]
    Iwg1,
    /// Text with separators and the fields given as `column`.
    Text,
}

/// Field that holds a quantity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantityColumn {
    /// Number of the field, from 1.
    pub field: usize,
    pub quantity: Quantity,
    /// Factor: value = scale * field + offset.
    #[serde(default = "default_scale")]
    pub scale: f64,
    /// Offset: value = scale * field + offset.
    #[serde(default)]
    pub offset: f64,
}

fn default_scale() -> f64 {
    1.0
}

/// Positions of the fields of a line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub struct Layout {
    /// Required first field; other lines are not read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begins_with: Option<String>,
    /// Character between the fields.
    pub separator: char,
    /// Number of the time tag's field, from 1.
    pub time_field: usize,
    /// Fields that hold quantities; of two with the same quantity the later counts.
    pub column: Vec<QuantityColumn>,
}

const M_PER_FOOT: f64 = 0.3048;

/// First field of a line of IWG1.
pub(super) const IWG1_KEYWORD: &str = "IWG1";
/// Fields of IWG1 that are read (www.eol.ucar.edu/raf/Software/IWG1_Def.html), with the factors of their units.
const IWG1: [(usize, Quantity, f64); 9] = [
    (7, Quantity::PressureAltitudeM, M_PER_FOOT),
    (10, Quantity::TrueAirspeedMS, 1.0),
    (12, Quantity::Mach, 1.0),
    (19, Quantity::SideslipDeg, 1.0),
    (20, Quantity::AngleOfAttackDeg, 1.0),
    (21, Quantity::StaticTemperatureC, 1.0),
    (23, Quantity::TotalTemperatureC, 1.0),
    (24, Quantity::StaticPressureHpa, 1.0),
    (26, Quantity::CabinPressureHpa, 1.0),
];

impl Layout {
    /// Creates a layout of separated fields.
    pub fn separated(separator: char, time_field: usize, column: Vec<QuantityColumn>) -> Self {
        Self {
            separator,
            time_field,
            column,
            ..Self::default()
        }
    }

    /// Creates the layout of IWG1 with a platform's own fields.
    pub fn iwg1(own: &[QuantityColumn]) -> Self {
        let fixed = IWG1.map(|(field, quantity, scale)| QuantityColumn {
            field,
            quantity,
            scale,
            offset: 0.0,
        });
        let column = fixed.iter().chain(own).copied().collect();
        Self {
            begins_with: Some(IWG1_KEYWORD.to_owned()),
            ..Self::separated(',', 2, column)
        }
    }

    /// Splits a line into its fields, without quotes and surrounding blanks.
    pub fn fields<'a>(&self, line: &'a str) -> Vec<Cow<'a, str>> {
        let line = line.trim_end_matches(['\r', '\n']);
        let quoted = if line.contains('"') {
            parse_rows(line, self.separator).ok()
        } else {
            None
        };
        match quoted.and_then(|rows| rows.into_iter().next()) {
            Some(row) => row.cells.into_iter().map(Cow::Owned).collect(),
            None => line
                .split(self.separator)
                .map(|field| Cow::Borrowed(field.trim()))
                .collect(),
        }
    }

    /// Converts a line into a sample; `None` if it does not fit the layout or has no time.
    pub fn read(&self, line: &str) -> Option<Sample> {
        self.sample(&self.fields(line))
    }

    /// Converts the fields of a line into a sample; `None` if they do not fit the layout or have no time.
    pub fn sample(&self, fields: &[impl AsRef<str>]) -> Option<Sample> {
        let begins = self.begins_with.as_deref();
        if begins.is_some_and(|word| fields.first().is_none_or(|first| first.as_ref() != word)) {
            return None;
        }
        let time_s = parse_time(field_text(fields, self.time_field)?)?;
        let mut sample = Sample {
            time_s,
            values: [None; QUANTITY_COUNT],
        };
        for column in &self.column {
            sample.values[column.quantity.index()] = column.read(fields).and_then(Result::ok);
        }
        Some(sample)
    }
}

impl QuantityColumn {
    /// Reads its cell: a value in the quantity's unit, or the text that is none; `None` if it is empty.
    pub(super) fn read<'a>(&self, fields: &'a [impl AsRef<str>]) -> Option<Result<f64, &'a str>> {
        let text = field_text(fields, self.field).filter(|text| !text.is_empty())?;
        let value = text.parse::<f64>().ok();
        let value = value.map(|number| self.scale * number + self.offset);
        Some(self.quantity.plausible(value).ok_or(text))
    }
}

/// Returns a field by its number, from 1.
fn field_text(fields: &[impl AsRef<str>], number: usize) -> Option<&str> {
    fields.get(number.checked_sub(1)?).map(AsRef::as_ref)
}

/// Values of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time tag, UTC, seconds since 1970.
    pub time_s: f64,
    /// Values in the order of [`Quantity::ALL`]; `None` for one that the line does not have.
    pub values: [Option<f64>; QUANTITY_COUNT],
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = "IWG1,2026-03-01T06:00:00.5,52.1,11.2,11300,11345,36089,,230.1,228.9,265,0.78,0.1,90,90,0,2.5,0.3,0,2.6,-56.5,-70,-28.2,226.3,110.1,790.5,20,270,0,60,30,100,10,64100,18200";

    #[test]
    fn an_iwg1_line_gives_its_fields_in_our_units() {
        let own = [QuantityColumn {
            field: 34,
            quantity: Quantity::WeightKg,
            scale: 1.0,
            offset: 0.0,
        }];
        let sample = Layout::iwg1(&own).read(LINE).unwrap();
        let of = |q: Quantity| sample.values[q.index()];
        assert_eq!(sample.time_s, 1_772_344_800.5);
        assert!((of(Quantity::PressureAltitudeM).unwrap() - 10_999.9).abs() < 0.1);
        assert_eq!(of(Quantity::Mach), Some(0.78));
        assert_eq!(of(Quantity::StaticTemperatureC), Some(-56.5));
        assert_eq!(of(Quantity::StaticPressureHpa), Some(226.3));
        assert_eq!(of(Quantity::CabinPressureHpa), Some(790.5));
        assert_eq!(
            (of(Quantity::WeightKg), of(Quantity::FuelKg)),
            (Some(64_100.0), None)
        );
    }

    #[test]
    fn invalid_values_are_none_and_invalid_lines_are_skipped() {
        let layout = Layout::iwg1(&[]);
        let empty = layout
            .read("IWG1,20260301T060000,,,,,-9999,,,,,NaN,,,,,,,,,,,,,,\r\n")
            .unwrap();
        assert_eq!(
            (empty.time_s, empty.values),
            (1_772_344_800.0, [None; QUANTITY_COUNT])
        );
        for bad in [
            "",
            "IWG1",
            "IWG1,yesterday,1,2",
            "IWG2,2026-03-01T06:00:00,1",
            "\u{fffd},,,",
        ] {
            assert_eq!(layout.read(bad), None, "{bad}");
        }
    }

    #[test]
    fn text_is_read_by_its_columns() {
        let kelvin = QuantityColumn {
            field: 3,
            quantity: Quantity::TotalTemperatureC,
            scale: 1.0,
            offset: -273.15,
        };
        let layout = Layout::separated(';', 1, vec![kelvin]);
        let sample = layout.read("1772344800.25;x;250.15").unwrap();
        assert_eq!(sample.time_s, 1_772_344_800.25);
        assert!((sample.values[Quantity::TotalTemperatureC.index()].unwrap() + 23.0).abs() < 1e-9);
        let zone = layout.read("2026-03-01T07:00:00+01:00;x;1").unwrap();
        assert_eq!(zone.time_s, 1_772_344_800.0);
    }

    #[test]
    fn quotes_and_blank_first_cells_are_read() {
        let mach = QuantityColumn {
            field: 3,
            quantity: Quantity::Mach,
            scale: 1.0,
            offset: 0.0,
        };
        let of =
            |layout: &Layout, line: &str| layout.read(line).unwrap().values[Quantity::Mach.index()];
        let tabs = Layout::separated('\t', 2, vec![mach]);
        assert_eq!(of(&tabs, "\t1772344800\t0.78\r\n"), Some(0.78));
        let commas = Layout::separated(',', 2, vec![mach]);
        assert_eq!(
            of(&commas, "\"climb, flaps\",\"1772344800\",\"0.78\""),
            Some(0.78)
        );
        let kept = serde_json::to_value(&commas).unwrap();
        assert_eq!(
            kept.as_object().unwrap().len(),
            3,
            "as layouts of older stores: {kept}"
        );
    }

    proptest::proptest! {
        #[test]
        fn any_text_is_accepted_without_a_panic(text in ".{0,200}") {
            let _ = Layout::iwg1(&[]).read(&text);
            let _ = Layout::iwg1(&[]).read(&format!("IWG1,2026-03-01T06:00:00,{text}"));
        }
    }
}
