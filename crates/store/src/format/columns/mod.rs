//! Files of live results, append-only: one line of JSON, then blocks of columns (docs/store.md).
//!
//! The digest of a block covers the digest of the block before, so that a torn, zeroed, stale or misplaced block is
//! detected; data after it is not read.

mod block;

use serde::{Deserialize, Serialize};
use serde_json::Value;

pub use block::{LiveBlock, LiveFile};
pub(crate) use block::{encode_block, first_block_digest, intact_prefix};

use wingd_base::clock::Stamp;

/// Format of the file.
pub const FORMAT: u32 = 1;
/// Maximum number of rows in a block; a damaged count cannot cause a large allocation.
const MAX_ROWS: usize = 1 << 20;

/// Encoding of a value in the file, little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ValueKind {
    /// Missing value: NaN.
    F64,
    /// Missing value: NaN.
    F32,
    /// Integers up to 2^53; missing value: the maximum.
    U64,
    /// Missing value: the maximum.
    U32,
    /// Missing value: the maximum.
    U8,
}

/// Column of a live table.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LiveColumn {
    /// Unique name in the table. In `list.rest`, `list` of the source names the values: `markers.deflection` has one for
    /// each of `source.markers`.
    pub name: String,
    /// Unit: `m`, `deg`, `px`, …; empty if dimensionless; [`UTC`] for times.
    pub unit: String,
    /// Encoding of each value.
    pub kind: ValueKind,
    /// Values per row.
    pub width: usize,
}

/// Unit of times: microseconds since 1970, UTC, in a column of kind [`ValueKind::U64`].
pub const UTC: &str = "utc_us";
/// Unit of truth values: true (1), false (0).
pub const FLAG: &str = "flag";
/// Unit of words: an index from 0 into the list that `words` of the source has for the column.
pub const WORD: &str = "word";

/// Schema of live rows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveTable {
    /// Origin of the rows: digests of the installation, program, names of markers, stations, torsion pairs.
    pub source: Value,
    /// Columns in the order of a row's values.
    pub columns: Vec<LiveColumn>,
}

/// Values of all columns of one row; NaN if missing.
pub type LiveRow = Vec<f64>;

/// First line of a file with live results.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveHead {
    /// Format of the file.
    pub format: u32,
    /// Flight of the rows.
    pub flight: String,
    /// Time of the file's beginning.
    pub began: Stamp,
    /// Schema of the rows.
    #[serde(flatten)]
    pub table: LiveTable,
}

impl ValueKind {
    /// Returns the size of an encoded value, bytes.
    pub fn byte_size(self) -> usize {
        match self {
            Self::F64 | Self::U64 => 8,
            Self::F32 | Self::U32 => 4,
            Self::U8 => 1,
        }
    }

    /// Returns the largest representable value.
    fn max_value(self) -> f64 {
        match self {
            Self::F64 | Self::F32 => f64::INFINITY,
            Self::U64 => 2_f64.powi(53),
            Self::U32 => f64::from(u32::MAX - 1),
            Self::U8 => f64::from(u8::MAX - 1),
        }
    }

    fn encode(self, value: f64, into: &mut Vec<u8>) {
        let none = value.is_nan();
        match self {
            Self::F64 => into.extend(value.to_le_bytes()),
            Self::F32 => into.extend((value as f32).to_le_bytes()),
            Self::U64 => into.extend(if none { u64::MAX } else { value as u64 }.to_le_bytes()),
            Self::U32 => into.extend(if none { u32::MAX } else { value as u32 }.to_le_bytes()),
            Self::U8 => into.push(if none { u8::MAX } else { value as u8 }),
        }
    }

    fn decode(self, bytes: &[u8]) -> f64 {
        let mut word = [0; 8];
        word.iter_mut()
            .zip(bytes)
            .for_each(|(to, from)| *to = *from);
        let number = u64::from_le_bytes(word);
        match self {
            Self::F64 => f64::from_bits(number),
            Self::F32 => f32::from_bits(number as u32).into(),
            Self::U64 if number == u64::MAX => f64::NAN,
            Self::U32 if number == u64::from(u32::MAX) => f64::NAN,
            Self::U8 if number == u64::from(u8::MAX) => f64::NAN,
            Self::U64 | Self::U32 | Self::U8 => number as f64,
        }
    }
}

impl LiveTable {
    /// Returns the number of values of a row.
    pub fn row_width(&self) -> usize {
        self.columns
            .iter()
            .fold(0, |all, column| all.saturating_add(column.width))
    }

    /// Returns whether a row can be encoded.
    pub fn accepts(&self, row: &LiveRow) -> bool {
        self.row_error(std::slice::from_ref(row)).is_none()
    }

    /// Returns a sentence if the rows cannot be encoded.
    fn row_error(&self, rows: &[LiveRow]) -> Option<String> {
        let width = self.row_width();
        if let Some(row) = rows.iter().find(|row| row.len() != width) {
            return Some(format!("a row has {} values, its table {width}", row.len()));
        }
        let mut at = 0;
        for column in &self.columns {
            let values = || {
                rows.iter()
                    .flat_map(move |row| row.iter().skip(at).take(column.width))
            };
            let whole = |v: &f64| {
                v.is_nan() || (v.fract() == 0.0 && (0.0..=column.kind.max_value()).contains(v))
            };
            let integers = !matches!(column.kind, ValueKind::F64 | ValueKind::F32);
            if let Some(bad) = values().find(|value| integers && !whole(value)) {
                return Some(format!("column {} cannot hold {bad}", column.name));
            }
            at += column.width;
        }
        (rows.len() > MAX_ROWS).then(|| format!("{} rows are too many for a block", rows.len()))
    }
}

#[cfg(test)]
mod tests;
