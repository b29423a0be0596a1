//! Rows of numbers in a file that grows at its end: one line of JSON, then blocks of columns (docs/store.md).
//!
//! A block's check covers the check of the block before, so that a block which is torn, zeroed, old or out of its
//! place is distinguished from a whole one, and what lies after it is not read.

mod block;

use serde::{Deserialize, Serialize};
use serde_json::Value;

pub use block::{Block, File};
pub(crate) use block::{block, first_check, whole};

use crate::clock::Stamp;

/// Of the file.
pub const FORMAT: u32 = 1;
/// Rows of a block at most, so that a damaged count asks for no memory.
const MAX_ROWS: usize = 1 << 20;

/// How a value lies in the file, little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// NaN: none.
    F64,
    /// NaN: none.
    F32,
    /// Whole numbers to 2^53; the greatest value: none.
    U64,
    /// The greatest value: none.
    U32,
    /// The greatest value: none.
    U8,
}

/// A column.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Column {
    /// Once in a table. `list.rest` says that `list` of the source names its values: `markers.deflection` has one for each
    /// of `source.markers`.
    pub name: String,
    /// `m`, `deg`, `px`, …; empty where it has none; [`UTC`] for moments.
    pub unit: String,
    /// Of each value.
    pub kind: Kind,
    /// Values per row.
    pub width: usize,
}

/// Unit of moments: microseconds since 1970, UTC, in a column of kind [`Kind::U64`].
pub const UTC: &str = "utc_us";
/// Unit of what is true (1) or false (0).
pub const FLAG: &str = "flag";
/// Unit of a word: the place in the list that `words` of the source has for the column, from 0.
pub const WORD: &str = "word";

/// What rows are of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveTable {
    /// What they come from: digests of the installation, program, names of markers, stations, torsion pairs.
    pub source: Value,
    /// In the order of a row's values.
    pub columns: Vec<Column>,
}

/// All columns' values after one another; NaN where there is none.
pub type Row = Vec<f64>;

/// The first line of a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// Of the file.
    pub format: u32,
    /// The flight that the rows belong to.
    pub flight: String,
    /// When the file was begun.
    pub began: Stamp,
    /// What the rows are of.
    #[serde(flatten)]
    pub table: LiveTable,
}

impl Kind {
    /// Of a value.
    pub fn bytes(self) -> usize {
        match self {
            Self::F64 | Self::U64 => 8,
            Self::F32 | Self::U32 => 4,
            Self::U8 => 1,
        }
    }

    /// The greatest number that is a value.
    fn greatest(self) -> f64 {
        match self {
            Self::F64 | Self::F32 => f64::INFINITY,
            Self::U64 => 2_f64.powi(53),
            Self::U32 => f64::from(u32::MAX - 1),
            Self::U8 => f64::from(u8::MAX - 1),
        }
    }

    fn put(self, value: f64, into: &mut Vec<u8>) {
        let none = value.is_nan();
        match self {
            Self::F64 => into.extend(value.to_le_bytes()),
            Self::F32 => into.extend((value as f32).to_le_bytes()),
            Self::U64 => into.extend(if none { u64::MAX } else { value as u64 }.to_le_bytes()),
            Self::U32 => into.extend(if none { u32::MAX } else { value as u32 }.to_le_bytes()),
            Self::U8 => into.push(if none { u8::MAX } else { value as u8 }),
        }
    }

    fn get(self, bytes: &[u8]) -> f64 {
        let mut word = [0; 8];
        word.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
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
    /// Values of a row.
    pub fn width(&self) -> usize {
        self.columns.iter().fold(0, |all, column| all.saturating_add(column.width))
    }

    /// Place of a column, and of its first value in a row.
    pub fn find(&self, name: &str) -> Option<(usize, usize)> {
        let at = self.columns.iter().position(|column| column.name == name)?;
        Some((at, self.columns.iter().take(at).map(|column| column.width).sum()))
    }

    /// What keeps rows from being written: a sentence.
    fn fault(&self, rows: &[Row]) -> Option<String> {
        let width = self.width();
        if let Some(row) = rows.iter().find(|row| row.len() != width) {
            return Some(format!("a row has {} values, its table {width}", row.len()));
        }
        let mut at = 0;
        for column in &self.columns {
            let values = || rows.iter().flat_map(move |row| row.iter().skip(at).take(column.width));
            let whole =
                |v: &f64| v.is_nan() || (v.fract() == 0.0 && (0.0..=column.kind.greatest()).contains(v));
            let integers = !matches!(column.kind, Kind::F64 | Kind::F32);
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
