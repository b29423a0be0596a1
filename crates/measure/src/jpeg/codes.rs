//! Reader of the Huffman codes of a scan (ITU-T T.81, F.2.2). In a sequential scan only selected blocks are decoded; of the
//! others it finds the end and luma's mean, from which the next block's mean is coded.

use libjpeg_turbo_rs::JpegError;
use libjpeg_turbo_rs::common::huffman_table::HuffmanTable;
use libjpeg_turbo_rs::common::quant_table::ZIGZAG_ORDER;

/// Number of coefficients of a block.
const ALL: usize = 64;
/// Number of coded bits that are looked up together.
const LOOKAHEAD_BITS: u32 = 12;
/// Maximum number of bits of a code and its number together.
const MAX_CODE_BITS: u32 = 32;
/// Symbol for 16 zeros. Any other symbol without a coefficient ends the block.
const ZEROS: u8 = 0xf0;

/// Appends coded bytes without the stuffed bytes between them.
pub fn remove_stuffing(coded: &[u8], into: &mut Vec<u8>) {
    let mut rest = coded;
    while let Some(at) = memchr::memchr(0xff, rest) {
        let (own, more) = rest.split_at(at + 1);
        into.extend_from_slice(own);
        rest = more.get(1..).unwrap_or_default();
    }
    into.extend_from_slice(rest);
}

/// Huffman tables of a component, with lookup tables for groups of codes at the start of a block and in it.
pub struct CodeTable {
    pub means: HuffmanTable,
    codes: HuffmanTable,
    starts: Vec<CodeGroup>,
    groups: Vec<CodeGroup>,
}

/// Complete codes at the beginning of some bits: number of bits with their numbers, number of coefficients they code, true
/// if the block ends with them, and the difference of means if they start a block. Zero bits if the first code is
/// incomplete or its difference is large.
#[derive(Clone, Copy, Default)]
struct CodeGroup {
    bits: u8,
    coefficients: u8,
    ends: bool,
    mean: i8,
}

impl CodeTable {
    /// Builds the lookup tables for a scan.
    pub fn new(means: &HuffmanTable, codes: &HuffmanTable) -> Self {
        let groups = |means| {
            (0..1 << LOOKAHEAD_BITS)
                .map(|bits| CodeGroup::from_bits(means, codes, bits))
                .collect()
        };
        Self {
            means: means.clone(),
            codes: codes.clone(),
            starts: groups(Some(means)),
            groups: groups(None),
        }
    }
}

impl CodeGroup {
    fn from_bits(means: Option<&HuffmanTable>, codes: &HuffmanTable, bits: u32) -> Self {
        let mut out = Self::default();
        let known = LOOKAHEAD_BITS as u8;
        let ahead = |read: u8| (bits << (16 - LOOKAHEAD_BITS) << read) as u16;
        if let Some(means) = means {
            // A difference of seven bits fits in eight.
            let Ok((size @ 0..=7, length)) = means.lookup(ahead(0)) else {
                return out;
            };
            if length + size > known {
                return out;
            }
            let number = u32::from(ahead(length)) >> (16 - size);
            (out.bits, out.mean) = (length + size, extend_sign(number as u16, size) as i8);
        }
        while !out.ends && out.bits < known {
            let Ok((symbol, length)) = codes.lookup(ahead(out.bits)) else {
                break;
            };
            let (zeros, size) = (symbol >> 4, symbol & 15);
            let bits = out.bits + length + size;
            if bits > known {
                break;
            }
            (out.bits, out.ends) = (bits, size == 0 && symbol != ZEROS);
            out.coefficients += if out.ends { 0 } else { zeros + 1 };
        }
        out
    }
}

/// Bit reader over coded data, followed by ones. No code consists of ones only (ITU-T T.81, C), so data that end early give
/// an error and no grey blocks.
pub struct CodeReader<'a> {
    data: &'a [u8],
    /// Number of bytes taken, also beyond the end.
    at: usize,
    /// Bits taken and not yet read, the first in the highest place, and their number; the bits after them are taken again.
    ahead: u64,
    left: u32,
}

impl<'a> CodeReader<'a> {
    /// Reads from the start of an interval's data, without stuffed bytes.
    pub fn new(data: &'a [u8]) -> Self {
        Self {
            data,
            at: 0,
            ahead: 0,
            left: 0,
        }
    }

    /// Reads from a bit position.
    pub fn from_bit(data: &'a [u8], bit: usize) -> Self {
        let mut out = Self {
            at: bit / 8,
            ..Self::new(data)
        };
        out.fill();
        out.skip_bits((bit % 8) as u32);
        out
    }

    /// Returns the position of the next bit.
    pub fn bit_position(&self) -> usize {
        8 * self.at - self.left as usize
    }

    /// Returns the number of unread bits; negative beyond the end.
    pub fn bits_left(&self) -> i64 {
        8 * (self.data.len() as i64 - self.at as i64) + i64::from(self.left)
    }

    /// Makes at least [`MAX_CODE_BITS`] bits available.
    #[inline(always)]
    fn fill(&mut self) {
        if self.left < MAX_CODE_BITS {
            let next = match self.data.get(self.at..).and_then(|rest| rest.first_chunk()) {
                Some(eight) => u64::from_be_bytes(*eight),
                None => self.last_eight_bytes(),
            };
            self.ahead |= next >> self.left;
            let bytes = (63 - self.left) / 8;
            self.at += bytes as usize;
            self.left += 8 * bytes;
        }
    }

    #[cold]
    #[inline(never)]
    fn last_eight_bytes(&self) -> u64 {
        let rest = self.data.get(self.at..).unwrap_or_default();
        let mut eight = [u8::MAX; 8];
        eight
            .iter_mut()
            .zip(rest)
            .for_each(|(to, from)| *to = *from);
        u64::from_be_bytes(eight)
    }

    #[inline(always)]
    fn skip_bits(&mut self, bits: u32) {
        self.ahead <<= bits;
        self.left -= bits;
    }

    /// Reads the next symbol.
    #[inline(always)]
    pub fn read_symbol(&mut self, table: &HuffmanTable) -> Result<u8, JpegError> {
        self.fill();
        let (symbol, length) = table.lookup((self.ahead >> 48) as u16)?;
        self.skip_bits(u32::from(length));
        Ok(symbol)
    }

    /// Reads the next `size` bits, at most 16.
    #[inline(always)]
    pub fn read_bits(&mut self, size: u8) -> u16 {
        self.fill();
        self.take_bits(size)
    }

    /// Reads `size` bits that are already available.
    #[inline(always)]
    fn take_bits(&mut self, size: u8) -> u16 {
        let bits = (self.ahead >> 48 >> (16 - u32::from(size))) as u16;
        self.skip_bits(u32::from(size));
        bits
    }

    /// Reads the signed number of `size` bits that follows its symbol.
    #[inline(always)]
    fn take_number(&mut self, size: u8) -> i16 {
        extend_sign(self.take_bits(size), size)
    }

    /// Reads the difference of the block's mean from that of the previous block.
    #[inline(always)]
    pub fn read_mean_change(&mut self, table: &HuffmanTable) -> Result<i16, JpegError> {
        match self.read_symbol(table)? {
            size @ 0..=15 => Ok(self.take_number(size)),
            _ => Err(out_of_step_error()),
        }
    }

    /// Reads the block's other coefficients.
    #[inline(always)]
    pub fn read_coefficients(
        &mut self,
        table: &CodeTable,
        block: &mut [i16; ALL],
    ) -> Result<(), JpegError> {
        let mut k = 1;
        while k < ALL {
            self.fill();
            let ahead = (self.ahead >> 48) as u16;
            let (whole, mut symbol, mut length) = table.codes.lookup_combined(ahead);
            // Code and number in one lookup: total bits, zeros, the number.
            let (zeros, number) = if whole != 0 {
                self.skip_bits((whole & 15) as u32);
                (usize::from((whole >> 4) as u16 & 15), whole >> 8)
            } else {
                if length == 0 {
                    (symbol, length) = table.codes.lookup(ahead)?;
                }
                self.skip_bits(u32::from(length));
                match symbol & 15 {
                    0 if symbol == ZEROS => {
                        k += 16;
                        continue;
                    }
                    0 => return Ok(()),
                    size => (usize::from(symbol >> 4), self.take_number(size)),
                }
            };
            k += zeros;
            *ZIGZAG_ORDER
                .get(k)
                .and_then(|&place| block.get_mut(place))
                .ok_or_else(out_of_step_error)? = number;
            k += 1;
        }
        if k == ALL {
            Ok(())
        } else {
            Err(out_of_step_error())
        }
    }

    /// Returns the group of the next bits.
    #[inline(always)]
    fn look_up(&mut self, groups: &[CodeGroup]) -> CodeGroup {
        self.fill();
        groups[(self.ahead >> (64 - LOOKAHEAD_BITS)) as usize]
    }

    /// Skips a block. Returns the difference of its mean from that of the previous block.
    #[inline(always)]
    pub fn skip_block(&mut self, table: &CodeTable) -> Result<i16, JpegError> {
        let mut group = self.look_up(&table.starts);
        let mut change = i16::from(group.mean);
        if group.bits == 0 {
            change = self.read_mean_change(&table.means)?;
            group = self.look_up(&table.groups);
        }
        let mut k = 1;
        loop {
            let then = k + usize::from(group.coefficients);
            // Complete codes of this block only.
            if group.bits > 0 && then + usize::from(group.ends) <= ALL {
                self.skip_bits(u32::from(group.bits));
                k = if group.ends { ALL } else { then };
            } else {
                let symbol = self.read_symbol(&table.codes)?;
                self.skip_bits(u32::from(symbol & 15));
                k = if symbol & 15 == 0 && symbol != ZEROS {
                    ALL
                } else {
                    k + usize::from(symbol >> 4) + 1
                };
            }
            if k >= ALL {
                break;
            }
            group = self.look_up(&table.groups);
        }
        if k == ALL {
            Ok(change)
        } else {
            Err(out_of_step_error())
        }
    }
}

/// Converts `size` bits to a signed number (ITU-T T.81, F.2.2.1).
pub fn extend_sign(bits: u16, size: u8) -> i16 {
    let (bits, size) = (i32::from(bits), i32::from(size));
    (if bits < 1 << size >> 1 {
        bits - (1 << size) + 1
    } else {
        bits
    }) as i16
}

/// Builds the error for codes read out of step.
pub fn out_of_step_error() -> JpegError {
    JpegError::CorruptData("codes are out of step".into())
}
