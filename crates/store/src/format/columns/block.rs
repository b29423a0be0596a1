//! Blocks of live results: encoding, checking, decoding.

use std::io::{self, Read, Write};

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use sha2::{Digest, Sha256};

use super::{FORMAT, LiveColumn, LiveHead, LiveRow, LiveTable, MAX_ROWS};

/// Magic number at the beginning of a block.
const MAGIC: &[u8; 8] = b"wingdrow";
/// Length of magic number, row count and content length, bytes.
const COUNTS_LENGTH: usize = 16;
/// Length of the block header, bytes: counts and digest.
const HEADER_LENGTH: usize = COUNTS_LENGTH + 32;
/// Digest that the next block's digest covers: that of the block before, or of the file's first line.
pub(crate) type BlockDigest = [u8; 32];

/// Computes the digest that the first block covers.
pub(crate) fn first_block_digest(line: &[u8]) -> BlockDigest {
    Sha256::digest(line).into()
}

/// Encodes rows as a block; returns the block and its digest.
pub(crate) fn encode_block(
    table: &LiveTable,
    rows: &[LiveRow],
    before: &BlockDigest,
) -> io::Result<(Vec<u8>, BlockDigest)> {
    let bad = |problem: String| io::Error::new(io::ErrorKind::InvalidInput, problem);
    if let Some(problem) = table.row_error(rows) {
        return Err(bad(problem));
    }
    let (mut lengths, mut parts) = (Vec::new(), Vec::new());
    let mut at = 0;
    for column in &table.columns {
        let mut plain = Vec::with_capacity(rows.len() * column.width * column.kind.byte_size());
        let values = rows
            .iter()
            .flat_map(|row| row.iter().skip(at).take(column.width));
        values.for_each(|value| column.kind.encode(*value, &mut plain));
        at += column.width;
        let packed = compress_column(&plain, column.kind.byte_size())?;
        let part = if packed.len() < plain.len() {
            packed
        } else {
            plain
        };
        lengths.extend(
            u32::try_from(part.len())
                .map_err(|_| bad(format!("column {} is too long", column.name)))?
                .to_le_bytes(),
        );
        parts.extend(part);
    }
    let content = [lengths, parts].concat();
    let count = |n: usize| u32::try_from(n).map_err(|_| bad("a block is too long".to_owned()));
    let mut bytes = MAGIC.to_vec();
    bytes.extend(count(rows.len())?.to_le_bytes());
    bytes.extend(count(content.len())?.to_le_bytes());
    let check = block_digest(before, &bytes, &content);
    bytes.extend(check);
    bytes.extend(content);
    Ok((bytes, check))
}

fn block_digest(before: &BlockDigest, counts: &[u8], content: &[u8]) -> BlockDigest {
    Sha256::new()
        .chain_update(before)
        .chain_update(counts)
        .chain_update(content)
        .finalize()
        .into()
}

/// Compresses a column: the first bytes of all values, then the second bytes of all, …; zlib.
fn compress_column(plain: &[u8], size: usize) -> io::Result<Vec<u8>> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    let sorted: Vec<u8> = (0..size)
        .flat_map(|k| plain.iter().skip(k).step_by(size).copied())
        .collect();
    encoder.write_all(&sorted)?;
    encoder.finish()
}

/// Reverses [`compress_column`]; `None` if the result is not `length` bytes long.
fn decompress_column(packed: &[u8], size: usize, length: usize) -> Option<Vec<u8>> {
    let mut sorted = Vec::new();
    ZlibDecoder::new(packed)
        .take(length as u64 + 1)
        .read_to_end(&mut sorted)
        .ok()?;
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

/// Intact block of rows.
pub struct LiveBlock<'a> {
    columns: &'a [LiveColumn],
    rows: usize,
    /// Encoded columns.
    parts: Vec<&'a [u8]>,
}

impl LiveBlock<'_> {
    /// Returns the number of rows.
    pub fn len(&self) -> usize {
        self.rows
    }

    /// Returns whether the block has no rows.
    pub fn is_empty(&self) -> bool {
        self.rows == 0
    }

    /// Decodes one column, row after row, without decoding the others. `None` if there is no such column or its encoding is
    /// unknown.
    pub fn column_values(&self, index: usize) -> Option<Vec<f64>> {
        let (column, part) = (self.columns.get(index)?, *self.parts.get(index)?);
        let length = self
            .rows
            .checked_mul(column.width)?
            .checked_mul(column.kind.byte_size())?;
        let unpacked = if part.len() == length {
            None
        } else {
            Some(decompress_column(part, column.kind.byte_size(), length)?)
        };
        let plain = unpacked.as_deref().unwrap_or(part);
        Some(
            plain
                .chunks_exact(column.kind.byte_size())
                .map(|bytes| column.kind.decode(bytes))
                .collect(),
        )
    }

    /// Decodes the column of a name; `None` if there is no such column or its encoding is unknown.
    pub fn named_values(&self, name: &str) -> Option<Vec<f64>> {
        self.column_values(self.columns.iter().position(|column| column.name == name)?)
    }

    /// Decodes all rows; `None` if a column cannot be decoded.
    pub fn rows(&self) -> Option<Vec<LiveRow>> {
        let mut rows = vec![LiveRow::new(); self.rows];
        for (index, column) in self.columns.iter().enumerate() {
            let values = self.column_values(index)?;
            rows.iter_mut().enumerate().for_each(|(n, row)| {
                row.extend(values.iter().skip(n * column.width).take(column.width))
            });
        }
        Some(rows)
    }
}

/// File of live results in memory, with a position among its blocks.
pub struct LiveFile<'a> {
    /// First line of the file.
    pub head: LiveHead,
    bytes: &'a [u8],
    offset: usize,
    digest: BlockDigest,
}

impl<'a> LiveFile<'a> {
    /// Parses the first line; `None` if it is not one of this format.
    pub fn parse(bytes: &'a [u8]) -> Option<Self> {
        let line = bytes.split_inclusive(|byte| *byte == b'\n').next()?;
        let head: LiveHead = serde_json::from_slice(line.strip_suffix(b"\n")?).ok()?;
        (head.format == FORMAT).then(|| Self {
            head,
            bytes,
            offset: line.len(),
            digest: first_block_digest(line),
        })
    }

    /// Returns the length of the file including a torn end, bytes.
    pub fn length(&self) -> usize {
        self.bytes.len()
    }

    /// Returns the end of the intact blocks read so far, bytes.
    pub fn good_length(&self) -> usize {
        self.offset
    }

    /// Returns the number of bytes after the intact blocks.
    pub fn torn_length(&self) -> usize {
        self.bytes.len() - self.offset
    }

    /// Returns the next block; `None` at the end, or if the next block is not intact.
    pub fn next_block(&mut self) -> Option<LiveBlock<'_>> {
        let (block, check) = self.peek_block()?;
        let (rows, content) = block;
        self.offset += HEADER_LENGTH + content.len();
        self.digest = check;
        let columns = &self.head.table.columns;
        let (lengths, mut rest) = content.split_at_checked(4 * columns.len())?;
        let mut parts = Vec::with_capacity(columns.len());
        for length in lengths.chunks_exact(4) {
            let (part, after) = rest.split_at_checked(read_u32(length)?)?;
            parts.push(part);
            rest = after;
        }
        Some(LiveBlock {
            columns,
            rows,
            parts,
        })
    }

    /// Returns row count, content and digest of the next block without advancing.
    fn peek_block(&self) -> Option<((usize, &'a [u8]), BlockDigest)> {
        let bytes = self.bytes.get(self.offset..)?;
        let (header, rest) = bytes.split_at_checked(HEADER_LENGTH)?;
        let (counts, stored_digest) = header.split_at_checked(COUNTS_LENGTH)?;
        let rows = read_u32(counts.get(8..12)?)?;
        let content = rest.get(..read_u32(counts.get(12..)?)?)?;
        let check = block_digest(&self.digest, counts, content);
        let intact = counts.starts_with(MAGIC) && rows <= MAX_ROWS && check == stored_digest;
        intact.then_some(((rows, content), check))
    }
}

fn read_u32(bytes: &[u8]) -> Option<usize> {
    usize::try_from(u32::from_le_bytes(bytes.try_into().ok()?)).ok()
}

/// Returns the length of the intact blocks, bytes, and their flight; `None` if the first line is not complete.
pub(crate) fn intact_prefix(bytes: &[u8]) -> Option<(usize, String)> {
    let mut file = LiveFile::parse(bytes)?;
    while file.next_block().is_some() {}
    Some((file.good_length(), file.head.flight))
}
