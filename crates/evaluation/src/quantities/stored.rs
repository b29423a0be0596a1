//! Form in which live mode stores results: columns of numbers, and a description of the file that names them.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{QuantitySection, ResultQuantity, ResultRow, SECTIONS, Subject, ValueGetter};
use wingd_store::columns::{FLAG, LiveTable, UTC, ValueKind, WORD};

/// How live mode stores a quantity.
#[derive(Clone, Copy)]
pub struct StoredForm {
    /// Encoding of each value.
    pub kind: ValueKind,
    /// Words that the numbers stand for; empty if they are registered in order of appearance.
    pub words: fn() -> Vec<String>,
    /// Name in the files, if it is another.
    pub name: Option<&'static str>,
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
    all.sort_by_key(|(subject, ..)| *subject);
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
        let name = self.stored_form().and_then(|form| form.name);
        let name = name.unwrap_or(self.name);
        let in_list = |list| format!("{list}.{name}");
        subject.list_name().map_or(name.to_owned(), in_list)
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
