//! A JPEG's grey values are decoded: sequential in one scan, as cameras write it, here. Header, tables and transform come from
//! a library, no colour is made, nothing that is not wanted, and no code of a missing stretch is taken for picture.

use std::ops::Range;

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
use crate::tiles::{self, Tiles};

/// Bits after the last block that are taken for padding: webcams are known to leave a few bytes before the end marker.
const PADDING_BITS: i64 = 64;

/// The picture, or of it at least what `wanted` tells for its width and height, and black elsewhere.
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
        layout.wanted = wanted(layout.width, layout.height);
    }
    let tables = (&header.dc_huffman_tables, &header.ac_huffman_tables);
    let plan = resolve_mcu_plan(&header.frame, &header.scan, tables.0, tables.1).ok()?;
    if plan.len() != header.frame.components.len() || plan.first()?.comp_idx != 0 {
        return None;
    }
    let quantisation = header.frame.components[0].quant_table_index;
    let steps = &header.quant_tables.get(usize::from(quantisation))?.as_ref()?.values;
    let scan = bytes.get(header.entropy_data_offset..)?;
    let mut parts =
        plan.iter().map(|p| Part { blocks: p.num_blocks, means: p.dc_table, others: Table::new(p.ac_table) });
    let luma = parts.next()?;
    let coding = Coding { luma, colour: parts.collect(), steps, transform: simd::detect().idct_islow };
    Some(layout.decode(scan, &coding, usize::from(header.restart_interval)))
}

/// How a component's blocks are coded: how many there are in a unit, and the codes of their coefficients.
struct Part<'a> {
    blocks: usize,
    means: &'a HuffmanTable,
    others: Table<'a>,
}

/// How the blocks are coded: luma's and the other components', luma's quantisation, and the inverse transform.
struct Coding<'a> {
    luma: Part<'a>,
    colour: Vec<Part<'a>>,
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
    /// Blocks that are wanted.
    wanted: Tiles,
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
        let wanted = Tiles::all(width, height);
        Some(Self { width, height, across, down, columns, rows, wanted })
    }

    /// Every interval between restart markers (the whole scan where there are none).
    fn decode(&self, scan: &[u8], coding: &Coding, interval: usize) -> Result<Raster, JpegFault> {
        let mut luma = vec![0; self.width * self.height];
        let mut intervals = Intervals::new(scan, self.columns * self.rows, interval, Some(END));
        let mut data = Vec::new();
        while let Some(units) = intervals.next()? {
            unstuffed(intervals.coded(), &mut data);
            self.interval(&data, units, coding, &mut luma)?;
        }
        Raster::new(self.width, self.height, luma).ok_or_else(|| damaged("it has no pixels"))
    }

    /// The units of one interval.
    fn interval(
        &self,
        data: &[u8],
        units: Range<usize>,
        coding: &Coding,
        luma: &mut [u8],
    ) -> Result<(), JpegFault> {
        let mut codes = Codes::new(data);
        let mut mean = 0_i16;
        let (mut column, mut row) = (units.start % self.columns, units.start / self.columns);
        for _ in units {
            let unit = self.unit([column, row], &mut codes, &mut mean, coding, luma);
            let near = |e: JpegError| JpegFault::Damaged(format!("{e} near row {}", row * self.down * BLOCK));
            unit.and_then(|()| coding.pass_colour(&mut codes)).map_err(near)?;
            column += 1;
            if column == self.columns {
                (column, row) = (0, row + 1);
            }
        }
        if codes.bits_left() > PADDING_BITS {
            return Err(damaged("data are missing or in the wrong place"));
        }
        Ok(())
    }

    /// Luma's blocks of a unit, of which those that are wanted come to their places.
    #[inline(always)]
    fn unit(
        &self,
        [column, row]: [usize; 2],
        codes: &mut Codes,
        mean: &mut i16,
        coding: &Coding,
        luma: &mut [u8],
    ) -> Result<(), JpegError> {
        let part = &coding.luma;
        for row in row * self.down..(row + 1) * self.down {
            let wanted = self.wanted.row(row);
            for column in column * self.across..(column + 1) * self.across {
                *mean = mean.wrapping_add(codes.mean(part.means)?);
                if wanted.get(column).is_some_and(|wanted| *wanted) {
                    let (mut coefficients, mut pixels) = ([0; BLOCK * BLOCK], [0; BLOCK * BLOCK]);
                    coefficients[0] = *mean;
                    codes.coefficients(&part.others, &mut coefficients)?;
                    (coding.transform)(&coefficients, coding.steps, &mut pixels);
                    tiles::put(&pixels, [column, row], luma, self.width);
                } else {
                    codes.pass_over(&part.others)?;
                }
            }
        }
        Ok(())
    }
}

impl Coding<'_> {
    /// The other components' blocks of a unit.
    #[inline(always)]
    fn pass_colour(&self, codes: &mut Codes) -> Result<(), JpegError> {
        for part in &self.colour {
            for _ in 0..part.blocks {
                codes.mean(part.means)?;
                codes.pass_over(&part.others)?;
            }
        }
        if codes.bits_left() < 0 { Err(JpegError::UnexpectedEof) } else { Ok(()) }
    }
}
