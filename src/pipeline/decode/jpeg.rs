//! The grey values of a sequential JPEG, as cameras write it: header, codes and transform from a library, no
//! colour, and no code of a missing stretch taken for picture.

use std::ops::Range;
use std::slice::ChunksExactMut;

use libjpeg_turbo_rs::JpegError;
use libjpeg_turbo_rs::decode::bitstream::BitReader;
use libjpeg_turbo_rs::decode::entropy::{McuComponentPlan, McuDecoder, resolve_mcu_plan};
use libjpeg_turbo_rs::decode::marker::{JpegMetadata, MarkerReader};
use libjpeg_turbo_rs::simd;

use super::{DecodeError, LARGEST_SIDE, Wanted};
use crate::measure::raster::Raster;

/// Side of a block, px.
const BLOCK: usize = 8;
/// Markers: the picture's end, and the first of the eight that follow intervals in turn.
const END: u8 = 0xd9;
const FIRST_RESTART: u8 = 0xd0;
/// What follows an interval's data instead of its marker: as many one bits as the reader reads ahead. No
/// Huffman code is all ones (ITU-T T.81, C), so that data which end early are an error and not grey blocks.
const ONES: [u8; 16] = [0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0];

/// The picture, or of its pixel rows at least those columns that `wanted` tells for its width and height, and black
/// elsewhere; `None` where the file is no sequential Huffman-coded picture in one scan, 8 bits, grey or luma with colour.
pub fn luma(bytes: &[u8], wanted: Option<&Wanted>) -> Option<Result<Raster, DecodeError>> {
    let header = MarkerReader::new(bytes).read_markers().ok()?;
    let mut layout = Layout::new(&header)?;
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
    let coding = Coding { plan, steps, transform: simd::detect().idct_islow };
    Some(layout.decode(scan, &coding, usize::from(header.restart_interval)))
}

/// How the blocks are coded: the Huffman tables of each component, luma's quantisation, and the inverse transform.
struct Coding<'a> {
    plan: Vec<McuComponentPlan<'a>>,
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
    fn new(header: &JpegMetadata) -> Option<Self> {
        let frame = &header.frame;
        let plain = frame.precision == 8
            && !frame.is_progressive
            && !frame.is_lossless
            && !header.is_arithmetic
            && header.scans.len() <= 1;
        let first = frame.components.first()?;
        let (across, down) = match frame.components.len() {
            // One component: its blocks row by row, whatever its sampling says (ITU-T T.81, A.2.2).
            1 => (1, 1),
            3 => (usize::from(first.horizontal_sampling), usize::from(first.vertical_sampling)),
            _ => return None,
        };
        let finest = |c: &libjpeg_turbo_rs::ComponentInfo| {
            usize::from(c.horizontal_sampling) <= across && usize::from(c.vertical_sampling) <= down
        };
        // Red, green and blue are named so, or Adobe's marker says that nothing was transformed.
        let ids: Vec<u8> = frame.components.iter().map(|c| c.id).collect();
        let rgb = ids == *b"RGB" || (header.saw_adobe_marker && header.adobe_transform == 0);
        let colour = frame.components.len() == 3;
        if !plain || (colour && (rgb || !frame.components.iter().all(finest))) || across == 0 || down == 0 {
            return None;
        }
        let (width, height) = (frame.width(), frame.height());
        let sound = (1..=LARGEST_SIDE).contains(&width) && (1..=LARGEST_SIDE).contains(&height);
        let (columns, rows) = (width.div_ceil(BLOCK * across), height.div_ceil(BLOCK * down));
        let wanted = || vec![0..columns * across; rows * down];
        sound.then(|| Self { width, height, across, down, columns, rows, wanted: wanted() })
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
    fn decode(&self, scan: &[u8], coding: &Coding, interval: usize) -> Result<Raster, DecodeError> {
        let mut luma = vec![0; self.width * self.height];
        let mut rows = luma.chunks_exact_mut(self.width);
        let mut line = vec![[0; BLOCK * BLOCK]; self.columns * self.across * self.down];
        let units = self.columns * self.rows;
        let length = if interval == 0 { units } else { interval };
        let mut data = Vec::new();
        let mut rest = scan;
        for (number, start) in (0..units).step_by(length).enumerate() {
            let end = (start + length).min(units);
            let (size, marker, next) = until_marker(rest).ok_or_else(|| damaged("its end is missing"))?;
            let after = if end == units { END } else { FIRST_RESTART + (number % 8) as u8 };
            if marker != after {
                return Err(damaged("data are missing or in the wrong place"));
            }
            data.clear();
            data.extend_from_slice(&rest[..size]);
            data.extend_from_slice(&ONES);
            rest = next;
            self.interval(&data, start..end, coding, &mut line, &mut rows)
                .map_err(|e| DecodeError::Jpeg(format!("{e} near row {}", self.height - rows.len())))?;
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
        let mut reader = BitReader::new(data);
        let mut decoder = McuDecoder::new(coding.plan.len());
        let mut coefficients = [0; BLOCK * BLOCK];
        let (mut column, mut row) = (units.start % self.columns, units.start / self.columns);
        for _ in units {
            for (k, part) in coding.plan.iter().enumerate() {
                let blocks = if k == 0 { self.across * self.down } else { part.num_blocks };
                for b in 0..blocks {
                    decoder.decode_block(
                        &mut reader,
                        part.comp_idx,
                        part.dc_table,
                        part.ac_table,
                        &mut coefficients,
                    )?;
                    if k > 0 {
                        continue;
                    }
                    let (down, across) = (b / self.across, column * self.across + b % self.across);
                    if self.wanted[row * self.down + down].contains(&across) {
                        let block = &mut line[down * wide + across];
                        (coding.transform)(&coefficients, coding.steps, block);
                    }
                }
            }
            if reader.is_eof() {
                return Err(JpegError::UnexpectedEof);
            }
            column += 1;
            if column == self.columns {
                let wanted = &self.wanted[row * self.down..];
                line.chunks_exact(wide).zip(wanted).for_each(|(blocks, wanted)| write(blocks, wanted, rows));
                (column, row) = (0, row + 1);
            }
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

/// Bytes until the next marker, its code, and what follows it.
fn until_marker(data: &[u8]) -> Option<(usize, u8, &[u8])> {
    let mut at = 0;
    loop {
        at += memchr::memchr(0xff, &data[at..])?;
        // Any number of fill bytes may stand before a marker.
        let fill = data[at..].iter().take_while(|&&b| b == 0xff).count();
        match *data.get(at + fill)? {
            0 => at += fill + 1,
            code => return Some((at, code, &data[at + fill + 1..])),
        }
    }
}

fn damaged(what: &str) -> DecodeError {
    DecodeError::Jpeg(what.into())
}
