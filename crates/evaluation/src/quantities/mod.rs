//! Quantities of the results: one row each of [`SECTIONS`], from which the tables of exports, the rows that live mode
//! stores, and their pages (`docs/tables.md`) follow.
//!
//! | file | subject |
//! |---|---|
//! | `named` | constructors, and the quantities that readers of live results name |
//! | `registry` | the quantities |
//! | `row` | the records from which a row of a table is read |
//! | `stored` | the form in which live mode stores results |

mod named;
mod registry;
mod row;
mod stored;

pub use named::{CLOCK_SIGMA, EXPOSURE_SIGMA, NUMBER, REASON, SINCE_BOOT, STATUS, SUMMARY, UTC};
pub use registry::SECTIONS;
pub use row::{ResultInputs, ResultRow};
pub use stored::{LiveSource, StoredForm, stored_quantities};

use jiff::Timestamp;

use crate::aircraft::Quantity;
use wingd_store::columns::ValueKind;

/// Version of names, units and meanings of the columns (docs/tables.md). Within a version columns may be added, never
/// changed or removed.
pub const SCHEMA_VERSION: usize = 3;

/// Table of exported results; the descriptions of the variants are the help of `wingd export`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ResultTable {
    /// Row per shot: time, tip deflection, twist, standard deviations, conditions
    Summary,
    /// Row per marker and image
    #[default]
    Markers,
    /// Row per point of the span curve and image
    Span,
    /// Row per section of the stiffness and image: bending moments
    Moments,
    /// Row per model parameter and image
    Parameters,
    /// Row per shot, including shots without a frame
    Shots,
    /// Row per result of live mode; also as jsonl
    Live,
    /// Row per station of the mean shape of each series; as csv or parquet
    Series,
    /// Joint shape of stations and markers with its covariance; as netcdf
    Shape,
}

/// Thing that a quantity belongs to. A row of a table may have several: then each has a column of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Subject {
    /// The row itself.
    Row,
    /// Marker of the survey.
    Marker,
    /// Point of the curve along the span.
    Station,
    /// Section of known stiffness.
    Section,
    /// Torsion pair.
    Pair,
    /// Coefficient of the curvature.
    CurvatureTerm,
    /// Pair of coefficients of the curvature: an element of the upper triangle of their covariance, row by row.
    CurvatureTermPair,
    /// Quantity of the aircraft data.
    Aircraft,
}

/// Function that reads a value from a row, by its type.
#[derive(Clone, Copy)]
pub enum ValueGetter {
    Number(fn(&ResultRow) -> Option<f64>),
    Count(fn(&ResultRow) -> Option<usize>),
    Flag(fn(&ResultRow) -> Option<bool>),
    Time(fn(&ResultRow) -> Option<Timestamp>),
    Text(fn(&ResultRow) -> Option<String>),
}

/// Occurrence of a quantity in live results.
#[derive(Clone, Copy)]
pub enum LiveForm {
    /// Not in live results.
    Absent,
    /// Read from the file and the row; part of the row's identity, which comes first.
    Identity,
    /// Read from the file and the row.
    Derived,
    /// Stored in each row.
    Stored(StoredForm),
}

/// Quantity of the results.
#[derive(Clone, Copy)]
pub struct ResultQuantity {
    /// Name without the unit.
    pub name: &'static str,
    /// Unit: `m`, `deg`, `px`, `1/m`, …; empty if dimensionless.
    pub unit: &'static str,
    /// Description for the page of the tables; empty for the standard deviation of another quantity.
    pub meaning: &'static str,
    /// Reads the value from a row.
    pub value: ValueGetter,
    /// Occurrence in live results.
    pub live: LiveForm,
    /// True if it occurs in live results only.
    pub only_live: bool,
}

/// Quantities of one subject that occur in the same tables, in their order.
pub struct QuantitySection {
    pub subject: Subject,
    /// Tables of frames.
    pub tables: &'static [ResultTable],
    pub quantities: &'static [ResultQuantity],
}

const fn quantity(
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    value: ValueGetter,
) -> ResultQuantity {
    ResultQuantity {
        name,
        unit,
        meaning,
        value,
        live: LiveForm::Absent,
        only_live: false,
    }
}

impl ResultQuantity {
    const fn in_live(self, live: LiveForm) -> Self {
        Self { live, ..self }
    }

    /// Adds the quantity to live results, where each row stores it.
    const fn stored(self, kind: ValueKind) -> Self {
        self.stored_form_of(kind, Vec::new, None)
    }

    /// Adds the quantity to live results, where each row stores the number of a word.
    const fn stored_words(self, words: fn() -> Vec<String>) -> Self {
        self.stored_form_of(ValueKind::U8, words, None)
    }

    /// Adds the quantity to live results, whose rows store it under another name.
    const fn stored_as(
        self,
        name: &'static str,
        kind: ValueKind,
        words: fn() -> Vec<String>,
    ) -> Self {
        self.stored_form_of(kind, words, Some(name))
    }

    const fn stored_form_of(
        self,
        kind: ValueKind,
        words: fn() -> Vec<String>,
        name: Option<&'static str>,
    ) -> Self {
        self.in_live(LiveForm::Stored(StoredForm { kind, words, name }))
    }

    /// Omits the quantity in tables of frames.
    const fn only_live(self) -> Self {
        Self {
            only_live: true,
            ..self
        }
    }

    /// Returns the name of its column: with the unit.
    pub fn column_name(&self) -> String {
        format!("{}{}", self.name, unit_suffix(self.unit))
    }

    /// Returns the value of a row as a number: a flag as 1 or 0, a time in microseconds since 1970. NaN if it is missing or a
    /// text.
    pub fn number(&self, row: &ResultRow) -> f64 {
        let number = match self.value {
            ValueGetter::Number(value) => value(row),
            ValueGetter::Count(value) => value(row).map(|count| count as f64),
            ValueGetter::Flag(value) => value(row).map(|flag| f64::from(u8::from(flag))),
            ValueGetter::Time(value) => value(row).map(|time| time.as_microsecond() as f64),
            ValueGetter::Text(_) => None,
        };
        number.unwrap_or(f64::NAN)
    }

    /// Returns how live mode stores it; `None` if it does not.
    pub fn stored_form(&self) -> Option<StoredForm> {
        match self.live {
            LiveForm::Stored(form) => Some(form),
            _ => None,
        }
    }
}

/// Returns the suffix of a column's name for a unit.
pub fn unit_suffix(unit: &str) -> String {
    let plain = |text: &str| text.replace(|c: char| !c.is_ascii_alphanumeric(), "_");
    match unit.strip_prefix("1/") {
        _ if unit.is_empty() => String::new(),
        Some(below) => format!("_per_{}", plain(below)),
        None => format!("_{}", plain(unit)),
    }
}

/// Column of a table, other than those that live mode stores.
pub struct TableColumn {
    /// Name, with the unit.
    pub name: String,
    pub quantity: &'static ResultQuantity,
    pair: Option<String>,
    aircraft: Option<Quantity>,
}

impl TableColumn {
    /// Lists the columns of a table of frames; `pairs` are the names of the torsion pairs.
    pub fn of_frames(table: ResultTable, pairs: &[String]) -> Vec<Self> {
        let is_summary = table == ResultTable::Summary;
        let is_of_table = |section: &&QuantitySection| match is_summary {
            true => matches!(
                section.subject,
                Subject::Row | Subject::Pair | Subject::Aircraft
            ),
            false => section.tables.contains(&table),
        };
        let chosen = |quantity: &ResultQuantity| {
            !quantity.only_live && (!is_summary || SUMMARY.contains(&quantity.name))
        };
        SECTIONS
            .iter()
            .filter(is_of_table)
            .flat_map(|section| section.columns(pairs, chosen))
            .collect()
    }

    /// Lists the columns of live results that are not stored, those of the rows' identity or the others.
    pub fn of_live(identity: bool) -> Vec<Self> {
        let chosen = |quantity: &ResultQuantity| match quantity.live {
            LiveForm::Identity => identity,
            LiveForm::Derived => !identity,
            LiveForm::Absent | LiveForm::Stored(_) => false,
        };
        SECTIONS
            .iter()
            .flat_map(|section| section.columns(&[], chosen))
            .collect()
    }

    /// Returns a row with the pair or the aircraft quantity of the column.
    pub fn narrow<'a>(&'a self, row: &ResultRow<'a>) -> ResultRow<'a> {
        ResultRow {
            pair_name: self.pair.as_deref(),
            quantity: self.aircraft,
            ..*row
        }
    }
}

impl QuantitySection {
    fn columns(
        &'static self,
        pairs: &[String],
        chosen: impl Fn(&ResultQuantity) -> bool,
    ) -> Vec<TableColumn> {
        let labels: Vec<(String, Option<&String>, Option<Quantity>)> = match self.subject {
            Subject::Pair => pairs
                .iter()
                .map(|name| (format!("torsion_{name}_"), Some(name), None))
                .collect(),
            Subject::Aircraft => Quantity::ALL
                .map(|one| (String::new(), None, Some(one)))
                .into(),
            _ => vec![Default::default()],
        };
        let quantities = || self.quantities.iter().filter(|quantity| chosen(quantity));
        let column = |(prefix, pair, aircraft): &(String, Option<&String>, Option<Quantity>),
                      quantity| TableColumn {
            name: format!(
                "{prefix}{}{}",
                ResultQuantity::column_name(quantity),
                aircraft.map_or("", Quantity::name)
            ),
            quantity,
            pair: pair.cloned(),
            aircraft: *aircraft,
        };
        labels
            .iter()
            .flat_map(|label| {
                quantities()
                    .map(|one| column(label, one))
                    .collect::<Vec<_>>()
            })
            .collect()
    }
}
