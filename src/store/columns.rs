//! Rows of numbers in a file that grows at its end: one line of JSON, then blocks of columns (docs/store.md).
//!
//! A block's check covers the check of the block before, so that a block which is torn, zeroed, old or out of its
//! place is told from a whole one, and what lies after it is not read.

use std::io::{self, Read, Write};

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};

use super::jsonl;
use crate::clock::Stamp;

/// Of the file.
pub const FORMAT: u32 = 1;
/// What each block begins with.
const MAGIC: &[u8; 8] = b"wingdrow";
/// Magic, rows, length of the content.
const COUNTS: usize = 16;
/// And the check.
const HEADER: usize = COUNTS + 32;
/// Rows of a block at most, so that a damaged count asks for no memory.
const MOST_ROWS: usize = 1 << 20;

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
    /// Once in a table. `list.rest` says that `list` of the source names its values: `markers.lift` has one for each
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

/// What the next block follows: the check of the one before, of the first the digest of the first line.
pub(crate) type Check = [u8; 32];

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
        (rows.len() > MOST_ROWS).then(|| format!("{} rows are too many for a block", rows.len()))
    }
}

/// The digest that the first block follows.
pub(crate) fn first_check(line: &[u8]) -> Check {
    Sha256::digest(line).into()
}

/// Rows as a block, and the check that the next one follows.
pub(crate) fn block(table: &LiveTable, rows: &[Row], before: &Check) -> io::Result<(Vec<u8>, Check)> {
    let bad = |what: String| io::Error::new(io::ErrorKind::InvalidInput, what);
    if let Some(what) = table.fault(rows) {
        return Err(bad(what));
    }
    let (mut lengths, mut parts) = (Vec::new(), Vec::new());
    let mut at = 0;
    for column in &table.columns {
        let mut plain = Vec::with_capacity(rows.len() * column.width * column.kind.bytes());
        let values = rows.iter().flat_map(|row| row.iter().skip(at).take(column.width));
        values.for_each(|value| column.kind.put(*value, &mut plain));
        at += column.width;
        let packed = pack(&plain, column)?;
        let part = if packed.len() < plain.len() { packed } else { plain };
        lengths.extend(
            u32::try_from(part.len()).map_err(|_| bad(format!("{} is too long", column.name)))?.to_le_bytes(),
        );
        parts.extend(part);
    }
    let content = [lengths, parts].concat();
    let count = |n: usize| u32::try_from(n).map_err(|_| bad("a block is too long".to_owned()));
    let mut bytes = MAGIC.to_vec();
    bytes.extend(count(rows.len())?.to_le_bytes());
    bytes.extend(count(content.len())?.to_le_bytes());
    let check = check(before, &bytes, &content);
    bytes.extend(check);
    bytes.extend(content);
    Ok((bytes, check))
}

fn check(before: &Check, counts: &[u8], content: &[u8]) -> Check {
    Sha256::new().chain_update(before).chain_update(counts).chain_update(content).finalize().into()
}

/// A column's values: each exclusive-or the one of the row before, the first bytes of all, the second of all, …; zlib.
fn pack(plain: &[u8], column: &Column) -> io::Result<Vec<u8>> {
    let (size, row) = (column.kind.bytes(), column.kind.bytes() * column.width);
    let mut changed = plain.to_vec();
    changed.iter_mut().skip(row).zip(plain).for_each(|(byte, before)| *byte ^= before);
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    let sorted: Vec<u8> = (0..size).flat_map(|k| changed.iter().skip(k).step_by(size).copied()).collect();
    encoder.write_all(&sorted)?;
    encoder.finish()
}

/// The reverse of [`pack`]; `None` where it does not give `length` bytes.
fn unpack(packed: &[u8], column: &Column, length: usize) -> Option<Vec<u8>> {
    let (size, row) = (column.kind.bytes(), column.kind.bytes() * column.width);
    let mut sorted = Vec::new();
    ZlibDecoder::new(packed).take(length as u64 + 1).read_to_end(&mut sorted).ok()?;
    if sorted.len() != length || length == 0 {
        return None;
    }
    let values = length / size;
    let mut plain: Vec<u8> =
        (0..values).flat_map(|value| sorted.iter().skip(value).step_by(values).copied()).collect();
    for at in row..length {
        let before = plain.get(at - row).copied()?;
        *plain.get_mut(at)? ^= before;
    }
    Some(plain)
}

/// A whole block.
pub struct Block<'a> {
    columns: &'a [Column],
    rows: usize,
    /// Of each column, as it lies in the file.
    parts: Vec<&'a [u8]>,
}

impl Block<'_> {
    /// Rows in it.
    pub fn len(&self) -> usize {
        self.rows
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.rows == 0
    }

    /// One column's values, row after row; the others are not unpacked. `None` where there is no such column, or
    /// another program packed it otherwise.
    pub fn column(&self, index: usize) -> Option<Vec<f64>> {
        let (column, part) = (self.columns.get(index)?, *self.parts.get(index)?);
        let length = self.rows.checked_mul(column.width)?.checked_mul(column.kind.bytes())?;
        let unpacked = if part.len() == length { None } else { Some(unpack(part, column, length)?) };
        let plain = unpacked.as_deref().unwrap_or(part);
        Some(plain.chunks_exact(column.kind.bytes()).map(|bytes| column.kind.get(bytes)).collect())
    }

    /// All rows.
    pub fn rows(&self) -> Option<Vec<Row>> {
        let mut rows = vec![Row::new(); self.rows];
        for (index, column) in self.columns.iter().enumerate() {
            let values = self.column(index)?;
            rows.iter_mut()
                .enumerate()
                .for_each(|(n, row)| row.extend(values.iter().skip(n * column.width).take(column.width)));
        }
        Some(rows)
    }
}

/// A file that was read into memory: its head, and where its blocks are.
pub struct File<'a> {
    /// The first line.
    pub head: Head,
    bytes: &'a [u8],
    at: usize,
    check: Check,
}

impl<'a> File<'a> {
    /// `None` where the first line is none of ours.
    pub fn parse(bytes: &'a [u8]) -> Option<Self> {
        let line = bytes.split_inclusive(|byte| *byte == b'\n').next()?;
        let head: Head = serde_json::from_slice(line.strip_suffix(b"\n")?).ok()?;
        (head.format == FORMAT).then(|| Self { head, bytes, at: line.len(), check: first_check(line) })
    }

    /// Where the whole blocks end that were read so far.
    pub fn good_length(&self) -> usize {
        self.at
    }

    /// Bytes after the whole blocks.
    pub fn torn(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// The next block; `None` at the end, and where the next is not whole.
    pub fn next_block(&mut self) -> Option<Block<'_>> {
        let (block, check) = self.piece()?;
        let (rows, content) = block;
        self.at += HEADER + content.len();
        self.check = check;
        let columns = &self.head.table.columns;
        let (lengths, mut rest) = content.split_at_checked(4 * columns.len())?;
        let mut parts = Vec::with_capacity(columns.len());
        for length in lengths.chunks_exact(4) {
            let (part, after) = rest.split_at_checked(number(length)?)?;
            parts.push(part);
            rest = after;
        }
        Some(Block { columns, rows, parts })
    }

    /// Rows and content of the block that is next, and its check.
    fn piece(&self) -> Option<((usize, &'a [u8]), Check)> {
        let bytes = self.bytes.get(self.at..)?;
        let (header, rest) = bytes.split_at_checked(HEADER)?;
        let (counts, said) = header.split_at_checked(COUNTS)?;
        let rows = number(counts.get(8..12)?)?;
        let content = rest.get(..number(counts.get(12..)?)?)?;
        let check = check(&self.check, counts, content);
        let whole = counts.starts_with(MAGIC) && rows <= MOST_ROWS && check == said;
        whole.then_some(((rows, content), check))
    }
}

fn number(bytes: &[u8]) -> Option<usize> {
    usize::try_from(u32::from_le_bytes(bytes.try_into().ok()?)).ok()
}

/// The first line as it is written.
pub(crate) fn first_line(head: &Head) -> io::Result<Vec<u8>> {
    jsonl::line(head)
}

/// How many bytes are whole, and the flight that they belong to; `None` where not even the first line is.
pub(crate) fn whole(bytes: &[u8]) -> Option<(usize, String)> {
    let mut file = File::parse(bytes)?;
    while file.next_block().is_some() {}
    Some((file.good_length(), file.head.flight))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use serde_json::json;

    use super::*;

    fn table() -> LiveTable {
        let column = |name: &str, unit: &str, kind, width| Column {
            name: name.into(),
            unit: unit.into(),
            kind,
            width,
        };
        let columns = vec![
            column("utc", UTC, Kind::U64, 1),
            column("markers.lift", "m", Kind::F32, 3),
            column("latency", "ms", Kind::F64, 1),
            column("number", "", Kind::U32, 1),
            column("markers.used", "", Kind::U8, 3),
        ];
        LiveTable { source: json!({"markers": ["M1", "M2", "M3"]}), columns }
    }

    /// With every kind's least, greatest and missing values.
    fn rows(count: usize) -> Vec<Row> {
        let row = |n: usize| {
            let x = n as f64;
            let none = |value: f64| if n % 7 == 3 { f64::NAN } else { value };
            let lift = |k: f64| f64::from((0.5 + 1e-3 * (x * k).sin()) as f32);
            let moment = 1.7e15 + 1e5 * x;
            let wide = if n == 1 { 2_f64.powi(53) } else { none(moment) };
            let number = if n == 2 { f64::from(u32::MAX - 1) } else { none(x) };
            vec![
                wide,
                lift(1.0),
                none(lift(2.0)),
                lift(3.0),
                none(-1e300 * x),
                number,
                0.0,
                none(254.0),
                x % 2.0,
            ]
        };
        (0..count).map(row).collect()
    }

    fn head() -> Head {
        let utc = "2026-03-01T08:00:00Z".parse().unwrap();
        let began = Stamp { utc, utc_synchronised: true, boot_id: "b".to_owned(), since_boot_s: 1.5 };
        Head { format: FORMAT, flight: "f0001".to_owned(), began, table: table() }
    }

    /// A file of these blocks, and where each ends.
    fn file(blocks: &[Vec<Row>]) -> (Vec<u8>, Vec<usize>) {
        let mut bytes = first_line(&head()).unwrap();
        let (mut check, mut ends) = (first_check(&bytes), vec![bytes.len()]);
        for rows in blocks {
            let (more, next) = block(&table(), rows, &check).unwrap();
            bytes.extend(more);
            check = next;
            ends.push(bytes.len());
        }
        (bytes, ends)
    }

    fn same(a: &[Row], b: &[Row]) -> bool {
        let bits = |rows: &[Row]| rows.iter().flatten().map(|v| v.to_bits()).collect::<Vec<_>>();
        bits(a) == bits(b)
    }

    #[test]
    fn every_value_of_every_kind_comes_back_and_none_stays_none() {
        let blocks = [rows(50), rows(1), rows(2000)];
        let (bytes, ends) = file(&blocks);
        let mut read = File::parse(&bytes).unwrap();
        assert_eq!(read.head, head());
        for rows in &blocks {
            let block = read.next_block().unwrap();
            assert_eq!(block.len(), rows.len());
            assert!(same(&block.rows().unwrap(), rows));
            let numbers: Vec<f64> = rows.iter().map(|row| row[5]).collect();
            assert!(same(&[block.column(3).unwrap()], &[numbers]), "one column by itself");
        }
        assert!(read.next_block().is_none() && read.torn() == 0);
        assert_eq!(whole(&bytes), Some((*ends.last().unwrap(), "f0001".to_owned())));
    }

    #[test]
    fn what_does_not_fit_is_refused_with_its_column() {
        let refused = |at: usize, value: f64| {
            let mut row = rows(1).remove(0);
            row[at] = value;
            block(&table(), &[row], &[0; 32]).unwrap_err().to_string()
        };
        assert_eq!(refused(5, -1.0), "column number cannot hold -1");
        assert_eq!(refused(5, f64::from(u32::MAX)), "column number cannot hold 4294967295");
        assert_eq!(refused(8, 0.5), "column markers.used cannot hold 0.5");
        assert_eq!(refused(0, 2_f64.powi(54)), "column utc cannot hold 18014398509481984");
        let short = block(&table(), &[vec![1.0]], &[0; 32]).unwrap_err().to_string();
        assert_eq!(short, "a row has 1 values, its table 9");
    }

    #[test]
    fn a_torn_changed_zeroed_or_misplaced_block_ends_the_whole_ones() {
        let (bytes, ends) = file(&[rows(20), rows(21), rows(22)]);
        for cut in ends[1]..bytes.len() {
            let good = ends.iter().rev().find(|end| **end <= cut).unwrap();
            assert_eq!(whole(&bytes[..cut]).unwrap().0, *good, "cut at {cut}");
            let mut zeroed = bytes.clone();
            zeroed[cut..].fill(0);
            let good = ends.iter().rev().find(|end| zeroed[..**end] == bytes[..**end]).unwrap();
            assert_eq!(whole(&zeroed).unwrap().0, *good, "zeros from {cut}");
        }
        for changed in ends[1]..ends[2] {
            let mut other = bytes.clone();
            other[changed] ^= 0x10;
            assert_eq!(whole(&other).unwrap().0, ends[1], "changed at {changed}");
        }
        let without = [&bytes[..ends[1]], &bytes[ends[2]..]].concat();
        assert_eq!(whole(&without).unwrap().0, ends[1], "the one before is missing");
        let twice = [&bytes[..ends[2]], &bytes[ends[1]..ends[2]]].concat();
        assert_eq!(whole(&twice).unwrap().0, ends[2]);
        for line in ["", "{}\n", "\n", "{\"format\":2}"] {
            assert!(File::parse(line.as_bytes()).is_none(), "{line:?}");
        }
    }
}
