//! A JPEG's grey values are decoded: sequential in one scan, as cameras write it, here. Header, tables and transform come from
//! a library, no colour is made, and no code of a missing stretch is taken for picture.
//!
//! All of the file is read at once, so that damage anywhere is noticed; but of a picture of which only parts are wanted the
//! codes are passed over, and each part is decoded when it is asked for.

use std::ops::Range;

use libjpeg_turbo_rs::JpegError;
use libjpeg_turbo_rs::common::huffman_table::HuffmanTable;
use libjpeg_turbo_rs::decode::entropy::resolve_mcu_plan;
use libjpeg_turbo_rs::decode::marker::JpegMetadata;
use libjpeg_turbo_rs::simd;

use super::JpegFault;
use super::codes::{Codes, Table, unstuff};
use super::intervals::{BLOCK, END, Intervals, damaged};
use super::kind::Colour;

/// Bits after the last block that are taken for padding: webcams are known to leave a few bytes before the end marker.
const PADDING_BITS: i64 = 64;

/// A block's coefficients, and its pixels.
type Coefficients = [i16; BLOCK * BLOCK];
type Pixels = [u8; BLOCK * BLOCK];

/// How a component's blocks are coded: how many there are in a unit, and the codes of their coefficients.
struct Component {
    blocks: usize,
    means: HuffmanTable,
    others: Table,
}

/// A picture in one scan: how its blocks lie and are coded.
pub struct Scan {
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
    luma: Component,
    colour: Vec<Component>,
    /// Luma's quantisation, and the inverse transform.
    steps: [u16; BLOCK * BLOCK],
    transform: fn(&Coefficients, &[u16; BLOCK * BLOCK], &mut Pixels),
}

/// Where a unit begins: its first bit, and luma's mean before it.
#[derive(Clone, Copy)]
struct Place {
    bit: usize,
    mean: i16,
}

/// A picture that was read through and not decoded.
pub struct Passed {
    scan: Scan,
    /// The coded bytes, without what is stuffed between them.
    data: Vec<u8>,
    places: Vec<Place>,
    /// Of each luma block whether it was decoded.
    is_done: Vec<bool>,
}

impl Scan {
    /// Of a sequential picture in one scan, grey or luma with colour; `None` where it is of another kind.
    pub fn of(header: &JpegMetadata, colour: Colour) -> Option<Self> {
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
        let tables = (&header.dc_huffman_tables, &header.ac_huffman_tables);
        let plan = resolve_mcu_plan(frame, &header.scan, tables.0, tables.1).ok()?;
        if plan.len() != frame.components.len() || plan.first()?.comp_idx != 0 {
            return None;
        }
        let component = |part: &libjpeg_turbo_rs::decode::entropy::McuComponentPlan| Component {
            blocks: part.num_blocks,
            means: part.dc_table.clone(),
            others: Table::new(part.ac_table),
        };
        let mut components = plan.iter().map(component);
        let quantisation = frame.components[0].quant_table_index;
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

    /// All grey values, from the scan's coded bytes and what follows them.
    pub fn decode(&self, coded: &[u8]) -> Result<Vec<u8>, JpegFault> {
        let mut luma = vec![0; self.width * self.height];
        self.read(coded, |unit, codes, mean| self.unit(unit, codes, mean, |_| true, &mut luma))?;
        Ok(luma)
    }

    /// The same of which nothing is decoded yet.
    pub fn pass_over(self, coded: &[u8]) -> Result<Passed, JpegFault> {
        let mut places = Vec::with_capacity(self.columns * self.rows);
        let data = self.read(coded, |_, codes, mean| {
            places.push(Place { bit: codes.bit(), mean: *mean });
            for _ in 0..self.across * self.down {
                *mean = mean.wrapping_add(codes.mean(&self.luma.means)?);
                codes.pass_over(&self.luma.others)?;
            }
            Ok(())
        })?;
        let is_done = vec![false; self.columns * self.across * self.rows * self.down];
        Ok(Passed { scan: self, data, places, is_done })
    }

    /// Reads every interval between restart markers (the whole scan where there are none), `luma` each unit's luma with its
    /// number and the mean before it; what was read comes back, without what is stuffed between it.
    fn read(
        &self,
        coded: &[u8],
        mut luma: impl FnMut(usize, &mut Codes, &mut i16) -> Result<(), JpegError>,
    ) -> Result<Vec<u8>, JpegFault> {
        let mut data = Vec::with_capacity(coded.len());
        let mut intervals = Intervals::new(coded, self.columns * self.rows, self.interval, Some(END));
        while let Some(units) = intervals.next()? {
            let start = data.len();
            unstuff(intervals.coded(), &mut data);
            let mut codes = Codes::at(&data, 8 * start);
            let mut mean = 0;
            for unit in units {
                let read = luma(unit, &mut codes, &mut mean).and_then(|()| self.pass_colour(&mut codes));
                read.map_err(|e| {
                    let row = unit / self.columns * self.down * BLOCK;
                    JpegFault::Damaged(format!("{e} near row {row}"))
                })?;
            }
            if codes.bits_left() > PADDING_BITS {
                return Err(damaged("data are missing or in the wrong place"));
            }
        }
        Ok(data)
    }

    fn pass_colour(&self, codes: &mut Codes) -> Result<(), JpegError> {
        for part in &self.colour {
            for _ in 0..part.blocks {
                codes.mean(&part.means)?;
                codes.pass_over(&part.others)?;
            }
        }
        if codes.bits_left() < 0 { Err(JpegError::UnexpectedEof) } else { Ok(()) }
    }

    /// Decodes the wanted blocks of a unit, told by their places in the picture, across and down.
    #[inline(always)]
    fn unit(
        &self,
        unit: usize,
        codes: &mut Codes,
        mean: &mut i16,
        mut wants: impl FnMut([usize; 2]) -> bool,
        luma: &mut [u8],
    ) -> Result<(), JpegError> {
        let (column, row) = (unit % self.columns, unit / self.columns);
        for down in 0..self.down {
            for across in 0..self.across {
                let at = [column * self.across + across, row * self.down + down];
                *mean = mean.wrapping_add(codes.mean(&self.luma.means)?);
                if wants(at) {
                    let (mut coefficients, mut pixels) = ([0; BLOCK * BLOCK], [0; BLOCK * BLOCK]);
                    coefficients[0] = *mean;
                    codes.coefficients(&self.luma.others, &mut coefficients)?;
                    (self.transform)(&coefficients, &self.steps, &mut pixels);
                    self.put(&pixels, at, luma);
                } else {
                    codes.pass_over(&self.luma.others)?;
                }
            }
        }
        Ok(())
    }

    /// A block's pixels to their places, as far as they lie in the picture.
    fn put(&self, pixels: &Pixels, [column, row]: [usize; 2], luma: &mut [u8]) {
        let (x, y) = (BLOCK * column, BLOCK * row);
        let wide = BLOCK.min(self.width.saturating_sub(x));
        let lines = luma.chunks_exact_mut(self.width).skip(y);
        for (to, from) in lines.zip(pixels.as_chunks::<BLOCK>().0) {
            match to.get_mut(x..x + wide) {
                Some(to) if wide == BLOCK => to.as_chunks_mut().0.iter_mut().for_each(|to| *to = *from),
                Some(to) => to.copy_from_slice(&from[..wide]),
                None => {}
            }
        }
    }

    /// Of each row of blocks those that hold some of some columns of each pixel row.
    fn blocks(&self, columns: &[Range<usize>]) -> Vec<Range<usize>> {
        let mut rows = columns.chunks(BLOCK);
        let blocks = |_| {
            let some = rows.next().unwrap_or_default().iter().filter(|c| c.start < c.end);
            let (from, to) = some.fold((usize::MAX, 0), |(f, t), c| (f.min(c.start), t.max(c.end)));
            let last = to.div_ceil(BLOCK).min(self.columns * self.across);
            (from / BLOCK).min(last)..last
        };
        (0..self.rows * self.down).map(blocks).collect()
    }
}

impl Passed {
    /// Decodes of each pixel row at least some columns, where they are not decoded yet.
    pub fn decode(&mut self, columns: &[Range<usize>], luma: &mut [u8]) {
        let Self { scan, data, places, is_done } = self;
        let blocks = scan.blocks(columns);
        let wide = scan.columns * scan.across;
        for (row, wanted) in blocks.chunks_exact(scan.down).enumerate() {
            let some = wanted.iter().filter(|w| !w.is_empty());
            let (from, to) = some.fold((usize::MAX, 0), |(f, t), w| (f.min(w.start), t.max(w.end)));
            for column in from.min(to) / scan.across..to.div_ceil(scan.across) {
                let missing = |[x, y]: [usize; 2], done: &[bool]| {
                    wanted[y % scan.down].contains(&x) && !done[y * wide + x]
                };
                let own =
                    |k: usize| [column * scan.across + k % scan.across, row * scan.down + k / scan.across];
                if !(0..scan.across * scan.down).any(|k| missing(own(k), is_done)) {
                    continue;
                }
                let unit = row * scan.columns + column;
                let Place { bit, mut mean } = places[unit];
                let wants = |at: [usize; 2]| {
                    let wants = missing(at, is_done);
                    is_done[at[1] * wide + at[0]] |= wants;
                    wants
                };
                // That its codes are sound was seen when it was read through.
                let _ = scan.unit(unit, &mut Codes::at(data, bit), &mut mean, wants, luma);
            }
        }
    }
}
