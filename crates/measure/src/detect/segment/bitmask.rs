//! Bit masks of the pixels of a row that pass a test.

use crate::dispatch::wide;

/// Number of pixels of a row in one word, one bit each, the first in the lowest bit.
pub const WORD_BITS: usize = u64::BITS as usize;

/// Pixels on one side of a level.
#[derive(Clone, Copy)]
pub enum LevelSide {
    /// Pixels below the level.
    Darker(u8),
    /// Pixels above the level.
    Lighter(u8),
}

wide! {
    /// Marks the pixels of a row on one side of a level, word by word.
    pub fn mark_side(row: &[u8], side: LevelSide, out: &mut [u64]) = mark_side_generic
}

#[inline(always)]
fn mark_side_generic(row: &[u8], side: LevelSide, out: &mut [u64]) {
    match side {
        LevelSide::Darker(level) => mark_rows([row], out, |[v]| v < level),
        LevelSide::Lighter(level) => mark_rows([row], out, |[v]| v > level),
    }
}

wide! {
    /// Marks the pixels of a row below their limits, word by word.
    pub fn mark_below(row: &[u8], limits: &[u8], out: &mut [u64]) = mark_below_generic
}

#[inline(always)]
fn mark_below_generic(row: &[u8], limits: &[u8], out: &mut [u64]) {
    mark_rows([row, limits], out, |[v, limit]| v < limit);
}

/// Marks the positions of several rows at which a test holds, word by word.
#[inline(always)]
fn mark_rows<const ROWS: usize>(
    rows: [&[u8]; ROWS],
    out: &mut [u64],
    holds: impl Fn([u8; ROWS]) -> bool,
) {
    let parts = rows.map(|row| row.as_chunks::<WORD_BITS>());
    let count = parts
        .iter()
        .fold(out.len(), |count, (words, _)| count.min(words.len()));
    for (k, out) in out[..count].iter_mut().enumerate() {
        *out = mark_word(parts.map(|(words, _)| &words[k]), &holds);
    }
    if let Some(out) = out.get_mut(count) {
        let rest = rows.map(|row| pad_row(row.get(count * WORD_BITS..).unwrap_or(&[])));
        *out = mark_word(rest.each_ref(), &holds);
    }
}

/// Returns the remaining pixels of a row, padded with zeros.
pub fn pad_row(rest: &[u8]) -> [u8; WORD_BITS] {
    let mut out = [0; WORD_BITS];
    out.iter_mut().zip(rest).for_each(|(out, &v)| *out = v);
    out
}

/// Returns one bit for each of 64 positions in several rows: set if the test holds for their values.
#[inline(always)]
pub fn mark_word<const ROWS: usize>(
    rows: [&[u8; WORD_BITS]; ROWS],
    holds: impl Fn([u8; ROWS]) -> bool,
) -> u64 {
    // One byte for each first: wide registers compare many bytes in one step.
    let mut bytes = [0u8; WORD_BITS];
    for (i, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from(holds(rows.map(|row| row[i])));
    }
    if bytes.iter().fold(0, |all, v| all | v) == 0 {
        return 0;
    }
    let mut marks = 0;
    for (k, word) in bytes.as_chunks::<8>().0.iter().enumerate() {
        // The product collects the lowest bits of eight bytes in the highest byte.
        marks |= (u64::from_le_bytes(*word).wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * k);
    }
    marks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bit_is_set_where_the_test_is_true() {
        let value = |k: usize| (k * 7919 % 251) as u8;
        for width in [1, 7, 63, 64, 65, 128, 200] {
            let row: Vec<u8> = (0..width).map(value).collect();
            // Limits end with a whole word.
            let limits: Vec<u8> = (0..width.next_multiple_of(WORD_BITS))
                .map(|k| value(3 * k + 11))
                .collect();
            let mut words: [_; 3] = std::array::from_fn(|_| vec![0; width.div_ceil(WORD_BITS)]);
            mark_side(&row, LevelSide::Darker(100), &mut words[0]);
            mark_side(&row, LevelSide::Lighter(100), &mut words[1]);
            mark_below(&row, &limits, &mut words[2]);
            for (k, &v) in row.iter().enumerate() {
                let got = words
                    .each_ref()
                    .map(|words| words[k / WORD_BITS] >> (k % WORD_BITS) & 1 == 1);
                assert_eq!(
                    got,
                    [v < 100, v > 100, v < limits[k]],
                    "place {k} of {width}"
                );
            }
        }
    }
}
