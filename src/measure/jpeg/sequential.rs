//! A sequential JPEG in one scan, as cameras write it. Header, tables and transform come from a library, no colour is made,
//! nothing that is not wanted, and no code of a missing stretch is taken for picture. What is wanted later is found by places
//! that are taken down on the way.

use std::ops::Range;

use libjpeg_turbo_rs::JpegError;
use libjpeg_turbo_rs::common::huffman_table::HuffmanTable;
use libjpeg_turbo_rs::decode::entropy::{McuComponentPlan, resolve_mcu_plan};
use libjpeg_turbo_rs::decode::marker::JpegMetadata;
use libjpeg_turbo_rs::simd;

use super::JpegFault;
use super::codes::{CodeReader, CodeTable, remove_stuffing};
use super::intervals::{BLOCK, END, RestartIntervals, damaged_error};
use super::kind::FirstComponent;
use crate::raster::Raster;
use crate::tiles::{self, Tiles};

/// Bits after the last block that are taken for padding: webcams are known to leave a few bytes before the end marker.
const PADDING_BITS: i64 = 64;
/// Units from one place that is taken down to the next at most: so many are passed over at most to come to one.
const STRIDE: usize = 16;

/// How a component's blocks are coded: how many there are in a unit, and the codes of their coefficients.
struct ComponentCodes {
    blocks: usize,
    means: HuffmanTable,
    others: CodeTable,
}

/// How a picture's blocks lie and are coded.
pub struct SequentialScan {
    width: usize,
    height: usize,
    /// Luma blocks of a unit (the blocks that are coded together), across and down.
    across: usize,
    down: usize,
    /// Units of a row, and rows of them.
    columns: usize,
    rows: usize,
    /// Units between restart markers, 0 without any.
    interval: usize,
    luma: ComponentCodes,
    colour: Vec<ComponentCodes>,
    /// Luma's quantisation, and the inverse transform.
    steps: [u16; BLOCK * BLOCK],
    transform: fn(&[i16; BLOCK * BLOCK], &[u16; BLOCK * BLOCK], &mut [u8; BLOCK * BLOCK]),
}

/// Where a unit begins: its first bit, and luma's mean before it.
struct ResumePoint {
    bit: usize,
    mean: i16,
}

/// A picture that was read, and of which more may be decoded.
pub struct ResumableScan {
    scan: SequentialScan,
    /// The coded bytes, without what is stuffed between them.
    data: Vec<u8>,
    /// Of every [`Scan::stride`]th unit.
    places: Vec<ResumePoint>,
}

impl SequentialScan {
    /// Of a sequential picture in one scan, grey or luma with colour; `None` where it is of another kind.
    pub fn from_header(header: &JpegMetadata, colour: FirstComponent) -> Option<Self> {
        let frame = &header.frame;
        if frame.is_progressive || header.scans.len() > 1 || colour != FirstComponent::Luma {
            return None;
        }
        let (across, down) = match &frame.components[..] {
            // One component: its blocks row by row, whatever its sampling says (ITU-T T.81, A.2.2).
            [_] => (1, 1),
            [first, ..] => (usize::from(first.horizontal_sampling), usize::from(first.vertical_sampling)),
            [] => return None,
        };
        let tables = (&header.dc_huffman_tables, &header.ac_huffman_tables);
        let plan = resolve_mcu_plan(frame, &header.scan, tables.0, tables.1).ok()?;
        if plan.len() != frame.components.len() || plan.first()?.comp_idx != 0 {
            return None;
        }
        let component = |part: &McuComponentPlan| ComponentCodes {
            blocks: part.num_blocks,
            means: part.dc_table.clone(),
            others: CodeTable::new(part.ac_table),
        };
        let mut components = plan.iter().map(component);
        let quantisation = frame.components[0].quant_table_index;
        let (width, height) = (frame.width(), frame.height());
        Some(Self {
            width,
            height,
            across,
            down,
            columns: width.div_ceil(BLOCK * across),
            rows: height.div_ceil(BLOCK * down),
            interval: usize::from(header.restart_interval),
            luma: components.next()?,
            colour: components.collect(),
            steps: header.quant_tables.get(usize::from(quantisation))?.as_ref()?.values,
            transform: simd::detect().idct_islow,
        })
    }

    /// Width and height, px.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Units from one place that is taken down to the next; none crosses a restart marker on the way to another.
    fn stride(&self) -> usize {
        let whole = |stride: &usize| self.interval.is_multiple_of(*stride);
        (1..=STRIDE).rev().find(whole).unwrap_or(1)
    }

    /// The wanted grey values, from the scan's coded bytes and what follows them: every interval between restart markers (the
    /// whole scan where there are none).
    pub fn decode(self, coded: &[u8], wanted: &Tiles) -> Result<(Raster, ResumableScan), JpegFault> {
        let mut luma = vec![0; self.width * self.height];
        let units = self.columns * self.rows;
        let mut data = Vec::with_capacity(coded.len());
        let mut places = Vec::with_capacity(units.div_ceil(self.stride()));
        let mut intervals = RestartIntervals::new(coded, units, self.interval, Some(END));
        while let Some(units) = intervals.next_interval()? {
            let start = data.len();
            remove_stuffing(intervals.coded(), &mut data);
            let mut codes = CodeReader::from_bit(&data, 8 * start);
            self.decode_interval(units, &mut codes, &mut places, wanted, &mut luma)?;
        }
        let raster = Raster::new(self.width, self.height, luma).ok_or_else(|| damaged_error("it has no pixels"))?;
        Ok((raster, ResumableScan { scan: self, data, places }))
    }

    /// The units of one interval.
    fn decode_interval(
        &self,
        units: Range<usize>,
        codes: &mut CodeReader,
        places: &mut Vec<ResumePoint>,
        wanted: &Tiles,
        luma: &mut [u8],
    ) -> Result<(), JpegFault> {
        let (mut mean, stride) = (0_i16, self.stride());
        let (mut column, mut row) = (units.start % self.columns, units.start / self.columns);
        let mut until_place = 0;
        for _ in units {
            if until_place == 0 {
                places.push(ResumePoint { bit: codes.bit_position(), mean });
                until_place = stride;
            }
            until_place -= 1;
            let near = |e: JpegError| JpegFault::Damaged(format!("{e} near row {}", row * self.down * BLOCK));
            self.decode_unit([column, row], codes, &mut mean, wanted, luma).map_err(near)?;
            column += 1;
            if column == self.columns {
                (column, row) = (0, row + 1);
            }
        }
        if codes.bits_left() > PADDING_BITS {
            return Err(damaged_error("data are missing or in the wrong place"));
        }
        Ok(())
    }

    /// The blocks of a unit, of which luma's that are wanted come to their places.
    #[inline(always)]
    fn decode_unit(
        &self,
        [column, row]: [usize; 2],
        codes: &mut CodeReader,
        mean: &mut i16,
        wanted: &Tiles,
        luma: &mut [u8],
    ) -> Result<(), JpegError> {
        for row in row * self.down..(row + 1) * self.down {
            let wanted = wanted.row(row);
            for column in column * self.across..(column + 1) * self.across {
                *mean = mean.wrapping_add(codes.read_mean_change(&self.luma.means)?);
                if wanted.get(column).is_some_and(|wanted| *wanted) {
                    let (mut coefficients, mut pixels) = ([0; BLOCK * BLOCK], [0; BLOCK * BLOCK]);
                    coefficients[0] = *mean;
                    codes.read_coefficients(&self.luma.others, &mut coefficients)?;
                    (self.transform)(&coefficients, &self.steps, &mut pixels);
                    tiles::put(&pixels, [column, row], luma, self.width);
                } else {
                    codes.skip_coefficients(&self.luma.others)?;
                }
            }
        }
        for part in &self.colour {
            for _ in 0..part.blocks {
                codes.read_mean_change(&part.means)?;
                codes.skip_coefficients(&part.others)?;
            }
        }
        if codes.bits_left() < 0 { Err(JpegError::UnexpectedEof) } else { Ok(()) }
    }

    /// Of a row of units those that hold wanted blocks.
    fn selected_units(&self, row: usize, wanted: &Tiles) -> Vec<usize> {
        let mut units = Vec::new();
        for row in row * self.down..(row + 1) * self.down {
            let blocks = wanted.row(row).iter().enumerate().filter(|(_, wanted)| **wanted);
            units.extend(blocks.map(|(block, _)| block / self.across));
        }
        units.sort_unstable();
        units.dedup();
        units
    }
}

impl ResumableScan {
    /// Decodes what is wanted. That the codes are sound was seen when they were read.
    pub fn decode(&self, wanted: &Tiles, luma: &mut [u8]) {
        let (scan, stride) = (&self.scan, self.scan.stride());
        for row in 0..scan.rows {
            let mut next = usize::MAX;
            let (mut codes, mut mean) = (CodeReader::new(&self.data), 0);
            for column in scan.selected_units(row, wanted) {
                let unit = row * scan.columns + column;
                let from = unit / stride;
                // What came last may end at a restart marker, behind which the bits begin anew.
                if next > unit || next <= from * stride {
                    let Some(place) = self.places.get(from) else { return };
                    (codes, mean, next) = (CodeReader::from_bit(&self.data, place.bit), place.mean, from * stride);
                }
                for unit in next..=unit {
                    let at = [unit % scan.columns, unit / scan.columns];
                    if scan.decode_unit(at, &mut codes, &mut mean, wanted, luma).is_err() {
                        return;
                    }
                }
                next = unit + 1;
            }
        }
    }
}
