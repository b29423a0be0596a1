//! Decoder of the coefficients of a block. Codes that no encoder writes are errors: libjpeg accepts them, but they are the
//! best sign of codes read out of step (ITU-T T.81, F.2.2 and G.1.2).

use libjpeg_turbo_rs::JpegError;
use libjpeg_turbo_rs::common::huffman_table::HuffmanTable;
use libjpeg_turbo_rs::common::quant_table::ZIGZAG_ORDER;

use super::codes::{CodeReader, extend_sign, out_of_step_error};

/// Coefficients of a block, row by row.
pub type CoefficientBlock = [i16; 64];

/// Coefficients coded in a scan, in coding order, and their lowest bit.
#[derive(Clone, Copy)]
pub struct SpectralBand {
    pub first: u8,
    pub last: u8,
    pub low: u8,
    /// Refinement scan: the higher bits are known.
    pub refines: bool,
}

/// State of the end-of-block runs of a scan: blocks that end together, in one code.
#[derive(Default)]
pub struct BlockRuns {
    /// Remaining blocks of the run.
    pub left: u16,
    /// Blocks of the run, and refinement bits in them.
    length: u16,
    refined: usize,
    /// True if the last run could have been continued within the encoder's limits.
    open: bool,
    /// True if any run has several blocks, and if any follows one that could have been continued.
    joined: bool,
    split: bool,
}

/// Refinement bits and blocks of a run after which libjpeg's encoder begins another: its buffer of 1000 bits must hold
/// those of one more block.
const MAX_REFINED_BITS: usize = 937;
const MAX_RUN: u16 = 0x7fff;

impl BlockRuns {
    fn begin_run(&mut self, length: u16, at_start: bool) {
        self.joined |= length > 1;
        self.split |= at_start && self.open;
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

    /// Returns whether codes were read out of step, as after missing data. An encoder that joins blocks in runs never
    /// splits a run that it could continue; if refinement bits fall into step again, a split run is the only sign.
    pub fn is_out_of_step(&self) -> bool {
        self.joined && self.split
    }
}

/// Decodes the band of a block.
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
            // Sixteen zeros are only coded if another coefficient follows.
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

/// Returns the position after `run` zeros, or the end of the band if there are fewer, and the number of refined
/// coefficients; refines the non-zero ones on the way.
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
