//! The coefficients of a block, and an error where no encoder writes such codes: libjpeg lets that pass, but nothing tells
//! better that codes are read out of step (ITU-T T.81, F.2.2 and G.1.2).

use libjpeg_turbo_rs::JpegError;
use libjpeg_turbo_rs::common::huffman_table::HuffmanTable;
use libjpeg_turbo_rs::common::quant_table::ZIGZAG_ORDER;

use super::codes::{CodeReader, out_of_step_error, extend_sign};

/// Coefficients in the order of their rows.
pub type CoefficientBlock = [i16; 64];

/// Which coefficients a scan tells, in the order of coding, and from which bit on.
#[derive(Clone, Copy)]
pub struct SpectralBand {
    pub first: u8,
    pub last: u8,
    pub low: u8,
    /// Whether the bits above are known.
    pub refines: bool,
}

/// Blocks of a scan that end together, in one code.
#[derive(Default)]
pub struct BlockRuns {
    /// Blocks of this one to come.
    pub left: u16,
    /// Blocks of this one, and bits in them that refine.
    length: u16,
    refined: usize,
    /// Whether the last one could have gone on: it was not cut by its encoder's limits.
    open: bool,
    /// Whether any has several blocks, and any follows on one that could have gone on.
    joined: bool,
    parted: bool,
}

/// Bits that refine, of a run, and blocks of one, from which on libjpeg's encoder begins another: its buffer of 1000 is
/// to hold those of one more block.
const MAX_REFINED_BITS: usize = 937;
const MAX_RUN: u16 = 0x7fff;

impl BlockRuns {
    fn begin_run(&mut self, length: u16, at_start: bool) {
        self.joined |= length > 1;
        self.parted |= at_start && self.open;
        (self.left, self.length, self.refined) = (length, length, 0);
    }

    fn end_block(&mut self, refined: usize) {
        self.refined += refined;
        self.left = self.left.saturating_sub(1);
        self.open = self.left == 0 && self.refined <= MAX_REFINED_BITS && self.length < MAX_RUN;
    }

    /// Begins a new interval or scan.
    pub fn restart(&mut self) {
        (self.left, self.open) = (0, false);
    }

    /// Of all scans: an encoder that joins blocks in runs never parts what it could join. Its codes are read out of step,
    /// as after a stretch that was lost; no other sign remains where refined bits fall into step again.
    pub fn is_out_of_step(&self) -> bool {
        self.joined && self.parted
    }
}

/// Takes up the band's part of a block.
pub fn decode_band(
    codes: &mut CodeReader,
    table: &HuffmanTable,
    band: SpectralBand,
    runs: &mut BlockRuns,
    block: &mut CoefficientBlock,
) -> Result<(), JpegError> {
    let (start, end) = (usize::from(band.first), usize::from(band.last) + 1);
    let (mut k, mut zeros) = (start, false);
    while k < end && runs.left == 0 {
        let symbol = codes.read_symbol(table)?;
        let (run, size) = (symbol >> 4, symbol & 15);
        let value = match size {
            0 if run == 15 => None,
            // Sixteen zeros are only told of where more follows.
            0 if zeros => return Err(out_of_step_error()),
            0 => {
                runs.begin_run((1 << run) + codes.read_bits(run), k == start);
                break;
            }
            _ if band.refines && size != 1 => return Err(out_of_step_error()),
            _ => Some(extend_sign(codes.read_bits(size), size) << band.low),
        };
        k = skip_zeros(codes, band, k..end, run, block).0;
        let place = ZIGZAG_ORDER[..end].get(k).ok_or_else(out_of_step_error)?;
        zeros = value.is_none();
        if let Some(value) = value {
            block[*place] = value;
        }
        k += 1;
    }
    if runs.left > 0 {
        let (_, refined) = skip_zeros(codes, band, k..end, u8::MAX, block);
        runs.end_block(refined);
    } else {
        runs.open = false;
    }
    Ok(())
}

/// The place after `run` zeros, the band's end where there are fewer; what is not zero on the way is refined, and counted.
fn skip_zeros(
    codes: &mut CodeReader,
    band: SpectralBand,
    range: std::ops::Range<usize>,
    run: u8,
    block: &mut CoefficientBlock,
) -> (usize, usize) {
    if !band.refines {
        return (range.start + usize::from(run), 0);
    }
    let (mut left, mut refined) = (run, 0);
    for k in range.clone() {
        let value = &mut block[ZIGZAG_ORDER[k]];
        if *value != 0 {
            refined += 1;
            if codes.read_bits(1) != 0 {
                *value = value.wrapping_add(value.signum() << band.low);
            }
        } else if left == 0 {
            return (k, refined);
        } else {
            left -= 1;
        }
    }
    (range.end, refined)
}
