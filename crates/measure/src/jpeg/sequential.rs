//! Decoder of a sequential JPEG in one scan, as cameras write it. A library provides header, tables and transform. No
//! colour and no unselected block is decoded, and missing data are not decoded as image. Bit positions recorded on the way
//! allow other blocks to be decoded later.

use std::ops::Range;

use libjpeg_turbo_rs::JpegError;
use libjpeg_turbo_rs::decode::entropy::{McuComponentPlan, resolve_mcu_plan};
use libjpeg_turbo_rs::decode::marker::JpegMetadata;
use libjpeg_turbo_rs::simd;

use super::JpegFault;
use super::codes::{CodeReader, CodeTable, remove_stuffing};
use super::header::FirstComponent;
use super::intervals::{BLOCK, END, RestartIntervals, damaged_error};
use crate::raster::Raster;
use crate::tiles::{self, Tiles};

/// Maximum number of bits after the last block that count as padding: webcams are known to leave a few bytes before the end
/// marker.
const PADDING_BITS: i64 = 64;
/// Maximum number of units between recorded positions, and so of units skipped to reach one.
const STRIDE: usize = 16;

/// Layout and coding of an image's blocks.
pub struct SequentialScan {
    width: usize,
    height: usize,
    /// Luma blocks of a unit (the blocks that are coded together), across and down.
    across: usize,
    down: usize,
    /// Units of a row, and number of rows.
    columns: usize,
    rows: usize,
    /// Units between restart markers, 0 for none.
    interval: usize,
    luma: CodeTable,
    /// Number of blocks in a unit, and their codes.
    colour: Vec<(usize, CodeTable)>,
    /// Quantisation steps of luma, and the inverse transform.
    steps: [u16; BLOCK * BLOCK],
    transform: fn(&[i16; BLOCK * BLOCK], &[u16; BLOCK * BLOCK], &mut [u8; BLOCK * BLOCK]),
}

/// Start of a unit: its first bit, and the mean of luma before it.
struct ResumePoint {
    bit: usize,
    mean: i16,
}

/// Image data that were read, of which more blocks may be decoded.
pub struct ResumableScan {
    scan: SequentialScan,
    /// Coded bytes, without stuffed ones.
    data: Vec<u8>,
    /// Position of every [`SequentialScan::stride`]th unit.
    resume_points: Vec<ResumePoint>,
}

impl SequentialScan {
    /// Prepares a sequential image in one scan, grey or luma with colour; `None` if it is of another kind.
    pub fn from_header(header: &JpegMetadata, colour: FirstComponent) -> Option<Self> {
        let frame = &header.frame;
        if frame.is_progressive || header.scans.len() > 1 || colour != FirstComponent::Luma {
            return None;
        }
        let (across, down) = match &frame.components[..] {
            // One component: its blocks row by row, regardless of its sampling (ITU-T T.81, A.2.2).
            [_] => (1, 1),
            [first, ..] => (
                usize::from(first.horizontal_sampling),
                usize::from(first.vertical_sampling),
            ),
            [] => return None,
        };
        let tables = (&header.dc_huffman_tables, &header.ac_huffman_tables);
        let plan = resolve_mcu_plan(frame, &header.scan, tables.0, tables.1).ok()?;
        if plan.len() != frame.components.len() || plan.first()?.comp_idx != 0 {
            return None;
        }
        // Components in a row with the same codes are skipped as one.
        let is_same = |a: &McuComponentPlan, b: &McuComponentPlan| {
            std::ptr::eq(a.dc_table, b.dc_table) && std::ptr::eq(a.ac_table, b.ac_table)
        };
        let table = |part: &McuComponentPlan| CodeTable::new(part.dc_table, part.ac_table);
        let colour = plan[1..].chunk_by(is_same).map(|parts| {
            let blocks = parts.iter().map(|part| part.num_blocks).sum();
            (blocks, table(&parts[0]))
        });
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
            luma: table(&plan[0]),
            colour: colour.collect(),
            steps: header
                .quant_tables
                .get(usize::from(quantisation))?
                .as_ref()?
                .values,
            transform: simd::detect().idct_islow,
        })
    }

    /// Returns width and height, px.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Returns the number of units between recorded positions; no stride crosses a restart marker.
    fn stride(&self) -> usize {
        let whole = |stride: &usize| self.interval.is_multiple_of(*stride);
        (1..=STRIDE).rev().find(whole).unwrap_or(1)
    }

    /// Decodes the wanted grey values from the scan's coded bytes and the bytes after them, interval by interval (or the
    /// whole scan if it has no restart markers).
    pub fn decode(
        self,
        coded: &[u8],
        wanted: &Tiles,
    ) -> Result<(Raster, ResumableScan), JpegFault> {
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
        let raster = Raster::new(self.width, self.height, luma);
        let raster = raster.ok_or_else(|| damaged_error("the image has no pixels"))?;
        Ok((
            raster,
            ResumableScan {
                scan: self,
                data,
                resume_points: places,
            },
        ))
    }

    /// Decodes the units of one interval.
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
                places.push(ResumePoint {
                    bit: codes.bit_position(),
                    mean,
                });
                until_place = stride;
            }
            until_place -= 1;
            let near = |e: JpegError| {
                JpegFault::Damaged(format!("{e} near row {}", row * self.down * BLOCK))
            };
            self.decode_unit([column, row], codes, &mut mean, wanted, luma)
                .map_err(near)?;
            column += 1;
            if column == self.columns {
                (column, row) = (0, row + 1);
            }
        }
        if codes.bits_left() > PADDING_BITS {
            return Err(damaged_error("data are missing or misplaced"));
        }
        Ok(())
    }

    /// Decodes the blocks of a unit and writes the wanted ones of luma to their positions.
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
                if wanted.get(column).is_some_and(|wanted| *wanted) {
                    let (mut coefficients, mut pixels) = ([0; BLOCK * BLOCK], [0; BLOCK * BLOCK]);
                    *mean = mean.wrapping_add(codes.read_mean_change(&self.luma.means)?);
                    coefficients[0] = *mean;
                    codes.read_coefficients(&self.luma, &mut coefficients)?;
                    (self.transform)(&coefficients, &self.steps, &mut pixels);
                    tiles::copy_tile(&pixels, [column, row], luma, self.width);
                } else {
                    *mean = mean.wrapping_add(codes.skip_block(&self.luma)?);
                }
            }
        }
        for (blocks, table) in &self.colour {
            for _ in 0..*blocks {
                codes.skip_block(table)?;
            }
        }
        if codes.bits_left() < 0 {
            Err(JpegError::UnexpectedEof)
        } else {
            Ok(())
        }
    }

    /// Returns the units in a row that hold wanted blocks.
    fn selected_units(&self, row: usize, wanted: &Tiles) -> Vec<usize> {
        let mut units = Vec::new();
        for row in row * self.down..(row + 1) * self.down {
            let blocks = wanted
                .row(row)
                .iter()
                .enumerate()
                .filter(|(_, wanted)| **wanted);
            units.extend(blocks.map(|(block, _)| block / self.across));
        }
        units.sort_unstable();
        units.dedup();
        units
    }
}

impl ResumableScan {
    /// Decodes the wanted blocks. The codes were checked when they were read.
    pub fn decode(&self, wanted: &Tiles, luma: &mut [u8]) {
        let (scan, stride) = (&self.scan, self.scan.stride());
        for row in 0..scan.rows {
            let mut next = usize::MAX;
            let (mut codes, mut mean) = (CodeReader::new(&self.data), 0);
            for column in scan.selected_units(row, wanted) {
                let unit = row * scan.columns + column;
                let from = unit / stride;
                // The previous unit may end at a restart marker, after which the bits restart.
                if next > unit || next <= from * stride {
                    let Some(place) = self.resume_points.get(from) else {
                        return;
                    };
                    (codes, mean, next) = (
                        CodeReader::from_bit(&self.data, place.bit),
                        place.mean,
                        from * stride,
                    );
                }
                for unit in next..=unit {
                    let at = [unit % scan.columns, unit / scan.columns];
                    if scan
                        .decode_unit(at, &mut codes, &mut mean, wanted, luma)
                        .is_err()
                    {
                        return;
                    }
                }
                next = unit + 1;
            }
        }
    }
}
