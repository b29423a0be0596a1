//! The file of `--mapping`: which column of a table is which quantity.

use jiff::civil::Date;
use serde::{Deserialize, Deserializer};

use super::layout::Kind;
use super::times::TimeFormat;
use super::{Quantity, layout};
use crate::installation::KeyFault;

/// Which column is which quantity, and how the table is written.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// `text`: a table with a header. `iwg1`: lines of IWG1, with or without one.
    #[serde(default = "text")]
    pub format: Kind,
    /// Name of the column with the time tag; of IWG1 none.
    pub time: Option<String>,
    /// How the time is written.
    #[serde(default)]
    pub time_format: TimeFormat,
    /// The date of seconds of a day, UTC.
    #[serde(default, deserialize_with = "date")]
    pub date: Option<Date>,
    /// Between the columns; found where it is not given.
    pub separator: Option<char>,
    /// The decimal sign.
    #[serde(default = "layout::point")]
    pub decimal: char,
    /// What is taken.
    #[serde(default)]
    pub column: Vec<Named>,
}

/// A column that is taken.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Named {
    /// Its name in the header.
    pub name: Option<String>,
    /// Of IWG1, which has no names for a platform's own: its place, from 1.
    pub field: Option<usize>,
    /// What it is.
    pub quantity: Quantity,
    /// Value = scale * cell + offset.
    #[serde(default = "layout::one")]
    pub scale: f64,
    /// As above.
    #[serde(default)]
    pub offset: f64,
}

fn text() -> Kind {
    Kind::Text
}

/// A TOML date, with or without quotes.
fn date<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Date>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Written {
        Toml(toml::value::Datetime),
        Text(String),
    }
    let text = match Written::deserialize(deserializer)? {
        Written::Toml(date) => date.to_string(),
        Written::Text(text) => text,
    };
    let error = |_| serde::de::Error::custom(format!("\"{text}\" is no date; write it as 2026-06-01"));
    text.parse().map(Some).map_err(error)
}

impl Mapping {
    /// What is wrong with it by itself.
    pub fn faults(&self) -> Vec<KeyFault> {
        let mut faults = vec![];
        let mut fault =
            |key: &str, problem: String, mend: &str| faults.push(KeyFault::new(key, problem, mend));
        let iwg1 = self.format == Kind::Iwg1;
        if !iwg1 && self.time.is_none() {
            fault("time", "is missing".into(), "name the column with the time, or write format = \"iwg1\"");
        }
        if !iwg1 && self.column.is_empty() {
            fault("column", "is missing".into(), "give [[column]] with name and quantity");
        }
        if self.time_format == TimeFormat::SecondsOfDay && self.date.is_none() {
            fault("date", "is missing".into(), "seconds of a day need one: date = \"2026-06-01\"");
        }
        if !['.', ','].contains(&self.decimal) {
            fault("decimal", format!("is \"{}\"", self.decimal), "write \".\" or \",\"");
        }
        if iwg1 && (self.time.is_some() || self.separator.is_some() || self.decimal != '.') {
            let problem = "is IWG1, which has time, separator and decimal sign of its own".into();
            fault("format", problem, "leave time, separator and decimal out");
        }
        for (k, column) in self.column.iter().enumerate() {
            let name = column.quantity.name();
            if column.scale == 0.0 || !column.scale.is_finite() || !column.offset.is_finite() {
                fault("column.scale", format!("is 0 or no number for {name}"), "give finite numbers");
            }
            if self.column[..k].iter().any(|other| other.quantity == column.quantity) {
                fault("column.quantity", format!("is {name} twice"), "keep the column that holds");
            }
            match (iwg1, &column.name, column.field) {
                (false, Some(_), None) => {}
                (false, ..) => {
                    fault("column.name", format!("is missing for {name}"), "name the table's column")
                }
                (true, None, Some(field)) if field > 2 => {}
                (true, ..) => {
                    let mend = "give the field of IWG1's line; a platform's own begin at field = 34";
                    fault("column.field", format!("is missing for {name}"), mend);
                }
            }
        }
        faults
    }
}
