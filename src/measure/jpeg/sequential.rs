//! A JPEG's grey values are decoded: sequential in one scan, as cameras write it, here. Header, tables and transform come from
//! a library, no colour is made, nothing that is not wanted, and no code of a missing stretch is taken for picture.

use std::ops::Range;
use std::slice::ChunksExactMut;

use libjpeg_turbo_rs::JpegError;
use libjpeg_turbo_rs::common::huffman_table::HuffmanTable;
use libjpeg_turbo_rs::decode::entropy::resolve_mcu_plan;
use libjpeg_turbo_rs::decode::marker::JpegMetadata;
use libjpeg_turbo_rs::simd;

use super::codes::{Codes, Table, unstuffed};
use super::intervals::{BLOCK, END, Intervals, damaged};
use super::kind::{self, Colour};
use super::{JpegFault, Wanted, scans};
use crate::raster::Raster;

/// Bits after the last block that are taken for padding: webcams are known to leave a few bytes before the end marker.
const PADDING_BITS: i64 = 64;

/// The picture, or of its pixel rows at least those columns that `wanted` tells for its width and height, and black
/// elsewhere.
pub fn luma(bytes: &[u8], wanted: Option<&Wanted>) -> Result<Raster, JpegFault> {
    let (header, colour) = kind::header(bytes)?;
    one_scan(bytes, &header, colour, wanted).unwrap_or_else(|| scans::luma(bytes, &header, colour))
}

/// The same of a sequential picture in one scan, grey or luma with colour; `None` where it is of another kind.
pub fn one_scan(
    bytes: &[u8],
    header: &JpegMetadata,
    colour: Colour,
    wanted: Option<&Wanted>,
) -> Option<Result<Raster, JpegFault>> {
    let mut layout = Layout::new(header, colour)?;
    if let Some(wanted) = wanted {
        layout.keep(&wanted(layout.width, layout.height));
    }
    let tables = (&header.dc_huffman_tables, &header.ac_huffman_tables);
    let plan = resolve_mcu_plan(&header.frame, &header.scan, tables.0, tables.1).ok()?;
    if plan.len() != header.frame.components.len() || plan.first()?.comp_idx != 0 {
        return None;
    }
    let quantisation = header.frame.components[0].quant_table_index;
    let steps = &header.quant_tables.get(usize::from(quantisation))?.as_ref()?.values;
    let scan = bytes.get(header.entropy_data_offset..)?;
    let parts =
        plan.iter().map(|p| Part { blocks: p.num_blocks, means: p.dc_table, others: Table::new(p.ac_table) });
    let coding = Coding { parts: parts.collect(), steps, transform: simd::detect().idct_islow };
    Some(layout.decode(scan, &coding, usize::from(header.restart_interval)))
}

/// How a component's blocks are coded: how many there are in a unit, and the codes of their coefficients.
struct Part<'a> {
    blocks: usize,
    means: &'a HuffmanTable,
    others: Table<'a>,
}

/// How the blocks are coded: each component's, luma's quantisation, and the inverse transform.
struct Coding<'a> {
    parts: Vec<Part<'a>>,
    steps: &'a [u16; BLOCK * BLOCK],
    transform: fn(&[i16; BLOCK * BLOCK], &[u16; BLOCK * BLOCK], &mut [u8; BLOCK * BLOCK]),
}

/// How the blocks lie in the picture.
struct Layout {
    width: usize,
    height: usize,
    /// Luma blocks of a unit (the blocks that are coded together), across and down.
    across: usize,
    down: usize,
    /// Units of a row, and rows of them.
    columns: usize,
    rows: usize,
    /// Of each row of blocks those that are wanted.
    wanted: Vec<Range<usize>>,
}

impl Layout {
    fn new(header: &JpegMetadata, colour: Colour) -> Option<Self> {
        let frame = &header.frame;
        if frame.is_progressive || header.scans.len() > 1 || colour != Colour::Luma {
            return None;
        }
        let (across, down) = match &frame.components[..] {
            // One component: its blocks row by row, whatever its sampling says (ITU-T T.81, A.2.2).
            [_] => (1, 1),
            [first, ..] => (usize::from(first.horizontal_sampling), usize::from(first.vertical_sampling)),
            [] => return None,
        };
        let (width, height) = (frame.width(), frame.height());
        let (columns, rows) = (width.div_ceil(BLOCK * across), height.div_ceil(BLOCK * down));
        let wanted = vec![0..columns * across; rows * down];
        Some(Self { width, height, across, down, columns, rows, wanted })
    }

    /// Leaves out the blocks that hold none of some columns of each pixel row.
    fn keep(&mut self, columns: &[Range<usize>]) {
        let mut rows = columns.chunks(BLOCK);
        for blocks in &mut self.wanted {
            let some = rows.next().unwrap_or_default().iter().filter(|c| c.start < c.end);
            let (from, to) = some.fold((usize::MAX, 0), |(f, t), c| (f.min(c.start), t.max(c.end)));
            let last = to.div_ceil(BLOCK).min(blocks.end);
            *blocks = (from / BLOCK).min(last)..last;
        }
    }

    /// Every interval between restart markers (the whole scan where there are none).
    fn decode(&self, scan: &[u8], coding: &Coding, interval: usize) -> Result<Raster, JpegFault> {
        let mut luma = vec![0; self.width * self.height];
        let mut rows = luma.chunks_exact_mut(self.width);
        let mut line = vec![[0; BLOCK * BLOCK]; self.columns * self.across * self.down];
        let mut intervals = Intervals::new(scan, self.columns * self.rows, interval, Some(END));
        let mut data = Vec::new();
        while let Some(units) = intervals.next()? {
            unstuffed(intervals.coded(), &mut data);
            self.interval(&data, units, coding, &mut line, &mut rows)
                .map_err(|e| JpegFault::Damaged(format!("{e} near row {}", self.height - rows.len())))?;
        }
        Raster::new(self.width, self.height, luma).ok_or_else(|| damaged("it has no pixels"))
    }

    /// The units of one interval into `line`, the blocks of one row of units, and every full line into `rows`.
    fn interval(
        &self,
        data: &[u8],
        units: Range<usize>,
        coding: &Coding,
        line: &mut [[u8; BLOCK * BLOCK]],
        rows: &mut ChunksExactMut<u8>,
    ) -> Result<(), JpegError> {
        let wide = self.columns * self.across;
        let mut codes = Codes::new(data);
        let Some((luma, colour)) = coding.parts.split_first() else { return Ok(()) };
        let mut mean = 0_i16;
        let (mut column, mut row) = (units.start % self.columns, units.start / self.columns);
        for _ in units {
            for down in 0..self.down {
                let wanted = &self.wanted[row * self.down + down];
                let first = column * self.across;
                for (k, block) in line[down * wide + first..][..self.across].iter_mut().enumerate() {
                    mean = mean.wrapping_add(codes.mean(luma.means)?);
                    if wanted.contains(&(first + k)) {
                        let mut coefficients = [0; BLOCK * BLOCK];
                        coefficients[0] = mean;
                        codes.coefficients(&luma.others, &mut coefficients)?;
                        (coding.transform)(&coefficients, coding.steps, block);
                    } else {
                        codes.pass_over(&luma.others)?;
                    }
                }
            }
            for part in colour {
                for _ in 0..part.blocks {
                    codes.mean(part.means)?;
                    codes.pass_over(&part.others)?;
                }
            }
            if codes.bits_left() < 0 {
                return Err(JpegError::UnexpectedEof);
            }
            column += 1;
            if column == self.columns {
                let wanted = &self.wanted[row * self.down..];
                line.chunks_exact(wide).zip(wanted).for_each(|(blocks, wanted)| write(blocks, wanted, rows));
                (column, row) = (0, row + 1);
            }
        }
        if codes.bits_left() > PADDING_BITS {
            return Err(JpegError::CorruptData("data are missing or in the wrong place".into()));
        }
        Ok(())
    }
}

/// The wanted part of the pixel rows of one row of blocks, as far as they lie in the picture.
fn write(blocks: &[[u8; BLOCK * BLOCK]], wanted: &Range<usize>, rows: &mut ChunksExactMut<u8>) {
    for (y, row) in rows.take(BLOCK).enumerate() {
        let line = |block: &[u8; BLOCK * BLOCK]| block.as_chunks::<BLOCK>().0[y];
        let (whole, part) = row.as_chunks_mut();
        for (pixels, block) in whole.iter_mut().zip(blocks).take(wanted.end).skip(wanted.start) {
            *pixels = line(block);
        }
        if let Some(block) = blocks.get(whole.len()).filter(|_| wanted.contains(&whole.len())) {
            part.copy_from_slice(&line(block)[..part.len()]);
        }
    }
}
