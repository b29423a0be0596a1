//! File of `--mapping`: assignment of a table's columns to quantities.

use jiff::civil::Date;
use jiff::tz::Offset;
use serde::{Deserialize, Deserializer};

use super::times::TimeFormat;
use super::units::find_unit;
use super::{Quantity, layout};
use wingd_base::clock::written_time::parse_offset;
use wingd_base::fault::KeyFault;

/// Format of a table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TableFormat {
    /// Table with a header.
    #[default]
    Text,
    /// Lines of IWG1, with or without a header.
    Iwg1,
    /// ICARTT: its head defines date, time, units, scale factors and missing values.
    Icartt,
}

/// Property of all lines, or the column that has it.
#[derive(Clone, Debug, PartialEq)]
pub enum StatedOnce<T> {
    /// Value for all lines.
    Value(T),
    /// Name of the column.
    Column(String),
}

/// Assignment of columns to quantities, and the format of the table.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    #[serde(default)]
    pub format: TableFormat,
    /// Name of the column with the time tag; none for IWG1.
    pub time: Option<String>,
    /// Format of the time.
    #[serde(default)]
    pub time_format: TimeFormat,
    /// Date of seconds of a day, or its column.
    #[serde(default, deserialize_with = "deserialize_date")]
    pub date: Option<StatedOnce<Date>>,
    /// Year of days of a year.
    pub year: Option<i16>,
    /// Zone of times without one, or its column.
    #[serde(default, deserialize_with = "deserialize_zone")]
    pub zone: Option<StatedOnce<Offset>>,
    /// Character between the columns; detected if it is not given.
    pub separator: Option<char>,
    /// Decimal sign.
    #[serde(default = "layout::default_decimal")]
    pub decimal: char,
    /// Columns that hold quantities.
    #[serde(default)]
    pub column: Vec<MappedColumn>,
}

/// Column that holds a quantity.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MappedColumn {
    /// Name in the header.
    pub name: Option<String>,
    /// Number of the field, from 1; only for IWG1, which has no names for a platform's own fields.
    pub field: Option<usize>,
    pub quantity: Quantity,
    /// Unit of the cells, instead of scale and offset.
    pub unit: Option<String>,
    /// Factor: value = scale * cell + offset; 1 by default.
    pub scale: Option<f64>,
    /// Offset: value = scale * cell + offset; 0 by default.
    pub offset: Option<f64>,
}

impl MappedColumn {
    /// Returns scale and offset as stated, or those of the unit.
    pub fn conversion(&self) -> (f64, f64) {
        let of_unit = self
            .unit
            .as_deref()
            .and_then(|unit| find_unit(self.quantity, unit).conversion());
        of_unit.unwrap_or((self.scale.unwrap_or(1.0), self.offset.unwrap_or(0.0)))
    }
}

/// Deserializes a TOML date, with or without quotes, or the name of a column.
fn deserialize_date<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<StatedOnce<Date>>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum WrittenDate {
        Toml(toml::value::Datetime),
        Text(String),
    }
    let text = match WrittenDate::deserialize(deserializer)? {
        WrittenDate::Toml(date) => date.to_string(),
        WrittenDate::Text(text) => text,
    };
    Ok(Some(
        text.parse()
            .map_or(StatedOnce::Column(text), StatedOnce::Value),
    ))
}

/// Deserializes an offset from UTC, or the name of a column.
fn deserialize_zone<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<StatedOnce<Offset>>, D::Error> {
    let text = String::deserialize(deserializer)?;
    Ok(Some(
        parse_offset(&text).map_or(StatedOnce::Column(text), StatedOnce::Value),
    ))
}

impl Mapping {
    /// Checks the mapping and returns its errors.
    pub fn faults(&self) -> Vec<KeyFault> {
        let mut faults = vec![];
        let mut fault = |key: &str, problem: String, remedy: &str| {
            faults.push(KeyFault::new(key, problem, remedy))
        };
        let (iwg1, text) = (
            self.format == TableFormat::Iwg1,
            self.format == TableFormat::Text,
        );
        if text && self.time.is_none() {
            let remedy = "name the column with the time, or write format = \"iwg1\" or \"icartt\"";
            fault("time", "is missing".into(), remedy);
        }
        if !iwg1 && self.column.is_empty() {
            fault(
                "column",
                "is missing".into(),
                "give [[column]] with name and quantity",
            );
        }
        if self.time_format == TimeFormat::SecondsOfDay && text && self.date.is_none() {
            let remedy = "add the date of the seconds of day, date = \"2026-06-01\", or the name of its column";
            fault("date", "is missing".into(), remedy);
        }
        if self.year.is_some() && self.time_format != TimeFormat::Irig {
            fault(
                "year",
                "is for days of the year".into(),
                "write time_format = \"irig\", or delete year",
            );
        }
        if !['.', ','].contains(&self.decimal) {
            fault(
                "decimal",
                format!("is \"{}\"", self.decimal),
                "write \".\" or \",\"",
            );
        }
        let columns = matches!(self.date, Some(StatedOnce::Column(_)))
            || self.time.is_some()
            || self.zone.is_some();
        if iwg1 && (columns || self.separator.is_some() || self.decimal != '.') {
            let problem = "is IWG1, which defines time, zone, separator and decimal sign".into();
            fault(
                "format",
                problem,
                "delete time, zone, separator and decimal",
            );
        }
        for (k, column) in self.column.iter().enumerate() {
            let name = column.quantity.name();
            let (scale, offset) = column.conversion();
            if scale == 0.0 || !scale.is_finite() || !offset.is_finite() {
                fault(
                    "column.scale",
                    format!("is 0 or not a number for {name}"),
                    "give finite numbers",
                );
            }
            if let Some(unit) = &column.unit {
                if column.scale.is_some() || column.offset.is_some() {
                    fault(
                        "column.unit",
                        format!("is given with scale or offset for {name}"),
                        "keep one of them",
                    );
                } else if find_unit(column.quantity, unit).conversion().is_none() {
                    let problem = format!("is {unit}, which is not a known unit of {name}");
                    fault("column.unit", problem, "give scale and offset instead");
                }
            }
            if self.column[..k]
                .iter()
                .any(|other| other.quantity == column.quantity)
            {
                fault(
                    "column.quantity",
                    format!("is {name} twice"),
                    "keep the valid column",
                );
            }
            match (iwg1, &column.name, column.field) {
                (false, Some(_), None) => {}
                (false, ..) => fault(
                    "column.name",
                    format!("is missing for {name}"),
                    "name the table's column",
                ),
                (true, None, Some(field)) if field > 2 => {}
                (true, ..) => {
                    let remedy =
                        "give the number of the field; a platform's own fields begin at field = 34";
                    fault("column.field", format!("is missing for {name}"), remedy);
                }
            }
        }
        faults
    }
}
