//! Blocks: packed, checked, read.

use std::io::{self, Read, Write};

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use sha2::{Digest, Sha256};

use super::{Column, FORMAT, Head, LiveTable, MAX_ROWS, Row};

/// What each block begins with.
const MAGIC: &[u8; 8] = b"wingdrow";
/// Magic, rows, length of the content.
const COUNTS: usize = 16;
/// And the check.
const HEADER: usize = COUNTS + 32;
/// What the next block follows: the check of the one before, of the first the digest of the first line.
pub(crate) type Check = [u8; 32];

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
        let packed = pack(&plain, column.kind.bytes())?;
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

/// A column's values: the first bytes of all, then the second of all, …; zlib.
fn pack(plain: &[u8], size: usize) -> io::Result<Vec<u8>> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    let sorted: Vec<u8> = (0..size).flat_map(|k| plain.iter().skip(k).step_by(size).copied()).collect();
    encoder.write_all(&sorted)?;
    encoder.finish()
}

/// The reverse of [`pack`]; `None` where it does not give `length` bytes.
fn unpack(packed: &[u8], size: usize, length: usize) -> Option<Vec<u8>> {
    let mut sorted = Vec::new();
    ZlibDecoder::new(packed).take(length as u64 + 1).read_to_end(&mut sorted).ok()?;
    if sorted.len() != length || length == 0 {
        return None;
    }
    let mut plain = vec![0; length];
    for (k, bytes) in sorted.chunks_exact(length / size).enumerate() {
        for (value, byte) in plain.chunks_exact_mut(size).zip(bytes) {
            value.iter_mut().skip(k).take(1).for_each(|to| *to = *byte);
        }
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
        let unpacked =
            if part.len() == length { None } else { Some(unpack(part, column.kind.bytes(), length)?) };
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

    /// Bytes of all of it.
    pub fn length(&self) -> usize {
        self.bytes.len()
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
        let whole = counts.starts_with(MAGIC) && rows <= MAX_ROWS && check == said;
        whole.then_some(((rows, content), check))
    }
}

fn number(bytes: &[u8]) -> Option<usize> {
    usize::try_from(u32::from_le_bytes(bytes.try_into().ok()?)).ok()
}

/// How many bytes are whole, and the flight that they belong to; `None` where not even the first line is.
pub(crate) fn whole(bytes: &[u8]) -> Option<(usize, String)> {
    let mut file = File::parse(bytes)?;
    while file.next_block().is_some() {}
    Some((file.good_length(), file.head.flight))
}
