//! Form in which live mode stores results: columns of numbers, and a description of the file that names them.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{
    QuantitySection, ResultQuantity, ResultRow, SECTIONS, SINCE_BOOT, Subject, ValueGetter,
};
use wingd_base::clock::Stamp;
use wingd_store::columns::{FLAG, LiveBlock, LiveTable, UTC, ValueKind, WORD};

/// How live mode stores a quantity.
#[derive(Clone, Copy)]
pub struct StoredForm {
    /// Encoding of each value.
    pub kind: ValueKind,
    /// Number of the addition to the format with which the column came; columns of later ones follow.
    pub addition: u8,
    /// Words that the numbers stand for; empty if they are registered in order of appearance.
    pub words: fn() -> Vec<String>,
}

/// Lists the stored quantities in the order of the columns.
pub fn stored_quantities() -> Vec<(Subject, StoredForm, &'static ResultQuantity)> {
    let of_section = |section: &'static QuantitySection| {
        section
            .quantities
            .iter()
            .filter_map(|quantity| Some((section.subject, quantity.stored_form()?, quantity)))
    };
    let mut all: Vec<_> = SECTIONS.iter().flat_map(of_section).collect();
    all.sort_by_key(|(subject, form, _)| (*subject, form.addition));
    all
}

impl Subject {
    /// Returns the list of [`LiveSource`] that names the subjects; `None` for those without names.
    pub fn list_name(self) -> Option<&'static str> {
        match self {
            Self::Marker => Some("markers"),
            Self::Station => Some("stations"),
            Self::Section => Some("sections"),
            Self::Pair => Some("torsion"),
            _ => None,
        }
    }
}

impl ResultQuantity {
    /// Returns the name of its column in a file of live results.
    pub fn stored_name(&self, subject: Subject) -> String {
        subject
            .list_name()
            .map_or(self.name.to_owned(), |list| format!("{list}.{}", self.name))
    }

    /// Returns the unit of its column in a file of live results.
    pub fn stored_unit(&self) -> &'static str {
        match self.value {
            ValueGetter::Number(_) | ValueGetter::Count(_) => self.unit,
            ValueGetter::Flag(_) => FLAG,
            ValueGetter::Time(_) => UTC,
            ValueGetter::Text(_) => WORD,
        }
    }

    /// Encodes the value of a row; NaN if it is missing. `words` are the words of its column.
    pub fn encode(&self, row: &ResultRow, words: &[String]) -> f64 {
        match self.value {
            // A word that is not in the list is beyond its end: the last one stands for it.
            ValueGetter::Text(value) => value(row).map_or(f64::NAN, |word| {
                let place = words.iter().position(|one| *one == word);
                place.unwrap_or(words.len().saturating_sub(1)) as f64
            }),
            ValueGetter::Time(_) => self.number(row).max(0.0),
            _ => self.number(row),
        }
    }
}

/// Times of stored results, row by row.
pub struct StoredTimes {
    utc: Vec<f64>,
    since_boot_s: Option<Vec<f64>>,
}

impl StoredTimes {
    /// Reads the times of a block; `None` if it has none.
    pub fn from_block(block: &LiveBlock) -> Option<Self> {
        Some(Self {
            utc: block.named_values(super::UTC.name)?,
            since_boot_s: block.named_values(SINCE_BOOT.name),
        })
    }

    /// Returns the time of a result of a file begun at `began`; `None` if it is unknown.
    pub fn stamp(&self, began: &Stamp, row: usize) -> Option<Stamp> {
        let utc = Timestamp::from_microsecond(finite_number(&self.utc, row)? as i64).ok()?;
        let by_utc_s = || began.since_boot_s + utc.duration_since(began.utc).as_secs_f64();
        let since_boot_s = finite_value(&self.since_boot_s, row).unwrap_or_else(by_utc_s);
        Some(Stamp {
            utc,
            since_boot_s,
            ..began.clone()
        })
    }
}

/// Returns a value of a column that a file may lack; `None` if it is not finite.
pub fn finite_value(column: &Option<Vec<f64>>, row: usize) -> Option<f64> {
    finite_number(column.as_ref()?, row)
}

fn finite_number(column: &[f64], row: usize) -> Option<f64> {
    column.get(row).copied().filter(|value| value.is_finite())
}

/// Description of a file of live results: the values equal in all rows, and the names in its lists.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LiveSource {
    /// Provenance of all results, as in `results.jsonl`.
    pub provenance: Map<String, Value>,
    pub method: Option<String>,
    /// Words of each column of unit [`WORD`].
    pub words: Map<String, Value>,
    /// Ids of the markers.
    pub markers: Vec<Value>,
    /// Arc lengths of the stations from the bending root, m.
    pub stations: Vec<Value>,
    /// Arc lengths of the sections of known stiffness, m.
    pub sections: Vec<Value>,
    /// Names of the torsion pairs.
    pub torsion: Vec<Value>,
    /// Id of the outermost marker.
    pub tip: Option<String>,
}

impl LiveSource {
    /// Reads the description of a table; parts that it does not have are empty.
    pub fn from_table(table: &LiveTable) -> Self {
        serde_json::from_value(table.source.clone()).unwrap_or_default()
    }
}
