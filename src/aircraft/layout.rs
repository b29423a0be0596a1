//! A layout says where the fields of a line stand, and reads the line as a sample. Pure.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::times::TimeFormat;
use super::{QUANTITIES, Quantity};
use crate::installation::rows;

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

pub(super) fn one() -> f64 {
    1.0
}

pub(super) fn point() -> char {
    '.'
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
    /// The time tag's field, from 1.
    pub time_field: usize,
    /// How it is written.
    #[serde(default, skip_serializing_if = "is_usual")]
    pub time_format: TimeFormat,
    /// The date of seconds of a day.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub date: Option<jiff::civil::Date>,
    /// The decimal sign.
    #[serde(default = "point", skip_serializing_if = "is_point")]
    pub decimal: char,
    /// What is taken; of two with one quantity the later.
    pub column: Vec<Column>,
}

fn is_usual(format: &TimeFormat) -> bool {
    *format == TimeFormat::default()
}

fn is_point(decimal: &char) -> bool {
    *decimal == point()
}

/// What stands in a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cell {
    /// A value in the quantity's unit.
    Value(f64),
    /// Nothing.
    Blank,
    /// A text that is no number.
    Text,
    /// A number that cannot be true, in the quantity's unit.
    OutOfReason(f64),
}

const M_PER_FOOT: f64 = 0.3048;

/// IWG1's own fields (www.eol.ucar.edu/raf/Software/IWG1_Def.html), each with a word of its name there.
pub(super) const IWG1: [(usize, Quantity, f64, &str); 6] = [
    (7, Quantity::PressureAltitudeM, M_PER_FOOT, "alt"),
    (12, Quantity::Mach, 1.0, "mach"),
    (21, Quantity::StaticTemperatureC, 1.0, "temp"),
    (23, Quantity::TotalTemperatureC, 1.0, "temp"),
    (24, Quantity::StaticPressureHpa, 1.0, "press"),
    (26, Quantity::CabinPressureHpa, 1.0, "press"),
];

impl Layout {
    /// Text with a column each.
    pub fn text(separator: char, time_field: usize, column: Vec<Column>) -> Self {
        let (time_format, date, decimal) = (TimeFormat::default(), None, point());
        Self { begins_with: None, separator, time_field, time_format, date, decimal, column }
    }

    /// IWG1 with a platform's own fields.
    pub fn iwg1(own: &[Column]) -> Self {
        let fixed = IWG1.map(|(field, quantity, scale, _)| Column { field, quantity, scale, offset: 0.0 });
        let column = fixed.iter().chain(own).copied().collect();
        Self { begins_with: Some("IWG1".to_owned()), ..Self::text(',', 2, column) }
    }

    /// The fields of a line, without quotes and the blanks about them.
    pub fn fields<'a>(&self, line: &'a str) -> Vec<Cow<'a, str>> {
        let line = line.trim_end_matches(['\r', '\n']);
        let quoted = if line.contains('"') { rows(line, self.separator).ok() } else { None };
        match quoted.and_then(|rows| rows.into_iter().next()) {
            Some(row) => row.cells.into_iter().map(Cow::Owned).collect(),
            None => line.split(self.separator).map(|field| Cow::Borrowed(field.trim())).collect(),
        }
    }

    /// A line as a sample; `None` where it is none of these lines or has no time.
    pub fn read(&self, line: &str) -> Option<Sample> {
        self.sample(&self.fields(line))
    }

    /// The same of its fields.
    pub fn sample(&self, fields: &[impl AsRef<str>]) -> Option<Sample> {
        let begins = self.begins_with.as_deref();
        if begins.is_some_and(|word| fields.first().is_none_or(|first| first.as_ref() != word)) {
            return None;
        }
        let time = self.time_format.seconds(field(fields, self.time_field)?, self.date)?;
        let mut sample = Sample { time_s: time, values: [None; QUANTITIES] };
        for column in &self.column {
            let value = if let Cell::Value(value) = self.cell(fields, column) { Some(value) } else { None };
            sample.values[column.quantity.index()] = value;
        }
        Some(sample)
    }

    /// What stands in a column's cell.
    pub fn cell(&self, fields: &[impl AsRef<str>], column: &Column) -> Cell {
        let Some(text) = field(fields, column.field).filter(|text| !text.is_empty()) else {
            return Cell::Blank;
        };
        let text = match self.decimal {
            // A point beside decimal commas parts thousands, or the column has points: which is not said.
            ',' if text.contains('.') => return Cell::Text,
            ',' => text.replace(',', "."),
            _ => text.to_owned(),
        };
        match text.parse::<f64>() {
            Ok(number) => {
                let value = column.scale * number + column.offset;
                column.quantity.believable(value).map_or(Cell::OutOfReason(value), Cell::Value)
            }
            Err(_) => Cell::Text,
        }
    }
}

/// A field by its number from 1.
fn field(fields: &[impl AsRef<str>], number: usize) -> Option<&str> {
    fields.get(number.checked_sub(1)?).map(AsRef::as_ref)
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
        let layout = Layout::text(';', 1, vec![kelvin]);
        let sample = layout.read("1772344800.25;x;250.15").unwrap();
        assert_eq!(sample.time_s, 1_772_344_800.25);
        assert!((sample.values[Quantity::TotalTemperatureC.index()].unwrap() + 23.0).abs() < 1e-9);
        let zone = layout.read("2026-03-01T07:00:00+01:00;x;1").unwrap();
        assert_eq!(zone.time_s, 1_772_344_800.0);
    }

    #[test]
    fn quotes_blank_first_cells_and_decimal_commas_are_read() {
        let mach = Column { field: 3, quantity: Quantity::Mach, scale: 1.0, offset: 0.0 };
        let of = |layout: &Layout, line: &str| layout.read(line).unwrap().values[Quantity::Mach.index()];
        let tabs = Layout::text('\t', 2, vec![mach]);
        assert_eq!(of(&tabs, "\t1772344800\t0.78\r\n"), Some(0.78));
        let commas = Layout::text(',', 2, vec![mach]);
        assert_eq!(of(&commas, "\"climb, flaps\",\"1772344800\",\"0.78\""), Some(0.78));
        let decimal = Layout { decimal: ',', ..Layout::text(';', 2, vec![mach]) };
        assert_eq!(
            (of(&decimal, "x;1772344800;0,78"), of(&decimal, "x;1772344800;0.78")),
            (Some(0.78), None)
        );
        assert_eq!(of(&Layout::text(';', 2, vec![mach]), "x;1772344800;0,78"), None);
        let kept = serde_json::to_value(&commas).unwrap();
        assert_eq!(kept.as_object().unwrap().len(), 3, "as layouts of older stores: {kept}");
    }

    proptest::proptest! {
        #[test]
        fn any_text_is_survived(text in ".{0,200}") {
            let _ = Layout::iwg1(&[]).read(&text);
            let _ = Layout::iwg1(&[]).read(&format!("IWG1,2026-03-01T06:00:00,{text}"));
        }
    }
}
