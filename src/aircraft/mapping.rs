//! File of `--mapping`: assignment of a table's columns to quantities.

use jiff::civil::Date;
use serde::{Deserialize, Deserializer};

use super::layout::LineFormat;
use super::times::TimeFormat;
use super::{Quantity, layout};
use crate::installation::KeyFault;

/// Assignment of columns to quantities, and the format of the table.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// Format: `text`: a table with a header; `iwg1`: lines of IWG1, with or without a header.
    #[serde(default = "default_format")]
    pub format: LineFormat,
    /// Name of the column with the time tag; none for IWG1.
    pub time: Option<String>,
    /// Format of the time.
    #[serde(default)]
    pub time_format: TimeFormat,
    /// Date of seconds of a day, UTC.
    #[serde(default, deserialize_with = "deserialize_date")]
    pub date: Option<Date>,
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
    /// Factor: value = scale * cell + offset.
    #[serde(default = "layout::default_scale")]
    pub scale: f64,
    /// Offset: value = scale * cell + offset.
    #[serde(default)]
    pub offset: f64,
}

fn default_format() -> LineFormat {
    LineFormat::Text
}

/// Deserializes a TOML date, with or without quotes.
fn deserialize_date<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Date>, D::Error> {
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
    let error = |_| serde::de::Error::custom(format!("\"{text}\" is not a date; write it as 2026-06-01"));
    text.parse().map(Some).map_err(error)
}

impl Mapping {
    /// Checks the mapping and returns its errors.
    pub fn faults(&self) -> Vec<KeyFault> {
        let mut faults = vec![];
        let mut fault = |key: &str, problem: String, remedy: &str| faults.push(KeyFault::new(key, problem, remedy));
        let iwg1 = self.format == LineFormat::Iwg1;
        if !iwg1 && self.time.is_none() {
            fault("time", "is missing".into(), "name the column with the time, or write format = \"iwg1\"");
        }
        if !iwg1 && self.column.is_empty() {
            fault("column", "is missing".into(), "give [[column]] with name and quantity");
        }
        if self.time_format == TimeFormat::SecondsOfDay && self.date.is_none() {
            fault("date", "is missing".into(), "add the date of the seconds of day: date = \"2026-06-01\"");
        }
        if !['.', ','].contains(&self.decimal) {
            fault("decimal", format!("is \"{}\"", self.decimal), "write \".\" or \",\"");
        }
        if iwg1 && (self.time.is_some() || self.separator.is_some() || self.decimal != '.') {
            let problem = "is IWG1, which defines time, separator and decimal sign".into();
            fault("format", problem, "delete time, separator and decimal");
        }
        for (k, column) in self.column.iter().enumerate() {
            let name = column.quantity.name();
            if column.scale == 0.0 || !column.scale.is_finite() || !column.offset.is_finite() {
                fault("column.scale", format!("is 0 or not a number for {name}"), "give finite numbers");
            }
            if self.column[..k].iter().any(|other| other.quantity == column.quantity) {
                fault("column.quantity", format!("is {name} twice"), "keep the valid column");
            }
            match (iwg1, &column.name, column.field) {
                (false, Some(_), None) => {}
                (false, ..) => fault("column.name", format!("is missing for {name}"), "name the table's column"),
                (true, None, Some(field)) if field > 2 => {}
                (true, ..) => {
                    let remedy = "give the number of the field; a platform's own fields begin at field = 34";
                    fault("column.field", format!("is missing for {name}"), remedy);
                }
            }
        }
        faults
    }
}
